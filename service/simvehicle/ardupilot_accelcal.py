"""ArduPilot's six-position accelerometer calibration: the dialogue of COMMAND_LONG 42429 and the fit behind it.

Six means of |SCAL ∘ (m − OFFS)| = g for six unknowns: no residual is left that could reveal a bad pose.
"""

from __future__ import annotations

import math

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.service.simvehicle import ardupilot_parameters as names
from mavcal.service.simvehicle.ardupilot_sensors import ArduPilotSensors
from mavcal.service.simvehicle.ardupilot_stored import StoredCalibrations
from mavcal.service.simvehicle.parameters import Value
from mavcal.service.simvehicle.rotation import Array
from mavcal.service.simvehicle.vehicle import FlightController

POSES = ("level", "on its LEFT side", "on its RIGHT side", "nose DOWN", "nose UP", "on its BACK")
SUCCESS, FAILURE = 16777215.0, 16777216.0
ASK_AGAIN_S = 1.0
SAMPLE_S, SAMPLES = 0.5, 50
G = 9.80665
LEAST_APART = 0.765 * G
MAX_MEAN_SQUARE = 0.1  # (m/s²)²
SCALE_LIMITS = (0.8, 1.2)
ITERATIONS = 50


class AccelCalibration:
    """Asks for six poses in a fixed order, takes a mean of each, and stores what fits."""

    def __init__(self, vehicle: FlightController, sensors: ArduPilotSensors, stored: StoredCalibrations) -> None:
        self._vehicle, self._sensors, self._stored = vehicle, sensors, stored
        self._means: list[list[Array]] = []
        self._sampling = False
        self.running = False

    def start(self) -> None:
        """Begin with the first pose: from now on the streams carry uncorrected accelerations."""
        self.running, self._sampling, self._means = True, False, []
        self._sensors.accel_calibrating = True
        self._vehicle.say(f"Place vehicle {POSES[0]} and press any key.", dialect.MAV_SEVERITY_CRITICAL)
        self._ask()

    def cancel(self) -> None:
        """A reboot ends it."""
        self.running = self._sensors.accel_calibrating = False

    def answer(self, pose: float) -> None:
        """The ground station says that the vehicle is in a pose: only the one that was asked for counts."""
        if not self.running or self._sampling or pose != len(self._means) + 1:
            return
        self._sampling = True
        vehicle, sensors = self._vehicle, self._sensors
        state = vehicle.world.state(vehicle.time + np.arange(1, SAMPLES + 1) * (SAMPLE_S / SAMPLES))
        means = [sensors.raw(k, state)[0].mean(axis=0) for k in range(len(sensors.chips))]
        vehicle.at(SAMPLE_S, lambda: self._taken(means))

    def _taken(self, means: list[Array]) -> None:
        if not self.running:
            return
        self._sampling = False
        first = means[0]
        if any(np.linalg.norm(first - earlier[0]) < LEAST_APART for earlier in self._means):
            self._finish(None)
            return
        self._means.append(means)
        if len(self._means) == len(POSES):
            self._finish(self._fit())
            return
        self._vehicle.say(f"Place vehicle {POSES[len(self._means)]} and press any key.", dialect.MAV_SEVERITY_CRITICAL)

    def _ask(self) -> None:
        if not self.running:
            return
        if not self._sampling:
            self._command(float(len(self._means) + 1))
        self._vehicle.at(ASK_AGAIN_S, self._ask)

    def _command(self, value: float) -> None:
        self._vehicle.broadcast(
            dialect.MAVLink_command_long_message(
                0, 0, dialect.MAV_CMD_ACCELCAL_VEHICLE_POS, 0, value, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            )
        )

    def _fit(self) -> list[tuple[Array, Array]] | None:
        solutions = [solve([pose[k] for pose in self._means]) for k in range(len(self._means[0]))]
        return None if any(s is None for s in solutions) else [s for s in solutions if s is not None]

    def _finish(self, solutions: list[tuple[Array, Array]] | None) -> None:
        vehicle, count = self._vehicle, len(self._sensors.chips)
        self.cancel()
        if solutions is None:
            vehicle.say("Calibration FAILED", dialect.MAV_SEVERITY_CRITICAL)
            self._command(FAILURE)
            # In memory only: the stored values come back with a reboot.
            for name, value in self._values([(np.zeros(3), np.ones(3))] * count).items():
                vehicle.table.store(name, value)
            return
        self._stored.write(self._values(solutions))
        self._stored.mark_accels(count)
        self._stored.require_reboot("Accels calibrated requires reboot")
        vehicle.say("Calibration successful", dialect.MAV_SEVERITY_CRITICAL)
        self._command(SUCCESS)

    def _values(self, solutions: list[tuple[Array, Array]]) -> dict[str, Value]:
        values: dict[str, Value] = {}
        now = np.array([self._vehicle.time])
        for k, (offset, scale) in enumerate(solutions):
            for axis, o, s in zip("XYZ", offset, scale, strict=True):
                values[f"{names.accel_offset_name(k)}_{axis}"] = float(o)
                values[f"{names.accel_scale_name(k)}_{axis}"] = float(s)
            chip = self._sensors.chips[k]
            values[names.caltemp_name("ACC", k)] = float(self._vehicle.world.temperature_read(chip, now)[0])
        return values


def solve(means: list[Array]) -> tuple[Array, Array] | None:
    """Offset and scale of six pose means (m/s²) by Gauss-Newton; None where the firmware would not accept them."""
    m = np.array(means)
    x = np.array([0.0, 0.0, 0.0, 1.0, 1.0, 1.0])
    for _ in range(ITERATIONS):
        scaled = (m - x[:3]) * x[3:]
        residual = np.sum(scaled**2, axis=1) - G * G
        jacobian = np.hstack([-2 * scaled * x[3:], 2 * scaled * (m - x[:3])])
        step, *_ = np.linalg.lstsq(jacobian, residual, rcond=None)
        x = x - step
        if np.abs(step).max() < 1e-10:
            break
    offset, scale = x[:3], x[3:]
    length = np.linalg.norm((m - offset) * scale, axis=1)
    accepted = (
        math.isfinite(float(x.sum()))
        and float(np.mean((length - G) ** 2)) < MAX_MEAN_SQUARE
        and (np.abs(offset) <= G).all()
        and (scale >= SCALE_LIMITS[0]).all()
        and (scale <= SCALE_LIMITS[1]).all()
    )
    return (offset, scale) if accepted else None
