"""Warnings at the start of a warm-up: results that this vehicle cannot store, and its own recalibrations.

A plan is composed as if the drift of every sensor had been measured well. Its warnings are then those of the real plan.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np

from mavcal.calib.errors import FirmwareError
from mavcal.calib.firmware.compose.draft import Subject
from mavcal.calib.firmware.compose.plan import unwritable
from mavcal.calib.firmware.in_force.fingerprint import SENSOR_IDS, fingerprint
from mavcal.calib.firmware.options import ComposeOptions, unknown_keys
from mavcal.calib.firmware.plan import Value
from mavcal.calib.fit import OFFSETS, FitBuilder, FitResult, parameter_names
from mavcal.calib.recording import Identity, Sensor
from mavcal.calib.triad import ThermalPolynomial, TriadModel

STREAMED_INSTANCES: Final = 3
"""MAVLink carries RAW_IMU or SCALED_IMU, SCALED_IMU2 and SCALED_IMU3."""

OWN_OFFSETS: Final = (
    "PX4 rewrites the offsets of its gyros by itself while it lies still (IMU_GYRO_CAL_EN = 1), whenever they have "
    "drifted by more than 0.01 rad/s. Each such change is taken out of the samples; nothing needs to be done"
)
"""``GyroCalibration::Run`` (PX4 src/modules/gyro_calibration); IMU_GYRO_CAL_EN is read by the start script only."""

_MEASURED: Final = ThermalPolynomial(35.0, 10.0, 60.0, np.full((3, 3), [1e-2, 1e-4, 1e-6]))
"""Assumed drift, far above any noise."""


def unknown_sensors(identity: Identity, parameters: Mapping[str, Value], options: ComposeOptions) -> str:
    """Refusal of an option `only` that names sensors this vehicle lacks; empty: it does not, or none is known."""
    known = _ids(identity, parameters)
    return unknown_keys(options.only, known) if known else ""


def foreseen(identity: Identity, parameters: Mapping[str, Value], options: ComposeOptions) -> tuple[str, ...]:
    """Warnings before a warm-up: drifts that this vehicle cannot store, and recalibrations of its own meanwhile."""
    known = [key for key in sorted(_ids(identity, parameters)) if key[0] != Sensor.MAG]
    asked = [key for key in known if not options.only or key in options.only]
    announced = [
        f"{Subject(*key)} does not stream, since MAVLink carries {STREAMED_INSTANCES} inertial units: its drift is "
        "not measured"
        for key in asked
        if key[1] >= STREAMED_INSTANCES
    ]
    drifts = [_drift(*key) for key in asked if key[1] < STREAMED_INSTANCES]
    if identity.autopilot == "px4" and int(parameters.get("IMU_GYRO_CAL_EN", 0)) != 0:
        announced.append(OWN_OFFSETS)
    try:
        announced += (
            unwritable(drifts, parameters, fingerprint(identity, parameters), options=options) if drifts else ()
        )
    except FirmwareError as error:
        announced.append(str(error))
    return tuple(announced)


def _ids(identity: Identity, parameters: Mapping[str, Value]) -> dict[tuple[Sensor, int], int]:
    found: dict[tuple[Sensor, int], int] = SENSOR_IDS.get(identity.autopilot or "", lambda _: {})(parameters)
    return found


def _drift(sensor: Sensor, instance: int) -> FitResult:
    names = parameter_names(3)
    shape_only = dict.fromkeys(OFFSETS, "") if sensor == Sensor.ACCEL else {}
    sd = np.zeros(len(names))
    sd[12:] = 1e-9
    unit = "m/s2" if sensor == Sensor.ACCEL else "rad/s"
    return FitBuilder("foreseen", sensor, instance, unit, 1, temperature=_MEASURED.t_ref).fitted(
        TriadModel(polynomial=_MEASURED),
        np.diag(sd**2),
        message="",
        n_used=1,
        residual_rms=0.0,
        condition_number=1.0,
        undetermined=shape_only,
    )
