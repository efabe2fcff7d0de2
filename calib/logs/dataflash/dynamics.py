"""Flight data of a DataFlash log: mixer inputs, battery, height, the estimator's trajectory.

========  ============================================================================================================
RATE      ROut POut YOut: inputs of the mixer with feed-forward, -1..1; AOut: throttle 0..1 (loop rate with bit 0)
MOTB      LiftMax, BatVolt (filtered voltage by ``MOT_BAT_VOLT_MAX``), ThLimit (bit 17)
XKF1 XKQ  velocity, place and attitude of each core of the estimator; EKF1, NKF1 in old firmwares
RFND      height above the ground
========  ============================================================================================================

Source: AIRFRAME 3.1 (``Copter.cpp``, ``Log.cpp``, ``LogStructure.h``).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.firmware.ardupilot.log_fields import INSTANCE_COLUMNS
from mavcal.calib.logs.dataflash.channels import instances
from mavcal.calib.logs.dataflash.state import channel_of, unit_quaternions
from mavcal.calib.recording import Channel, Sensor

if TYPE_CHECKING:
    from collections.abc import Iterator

    from mavcal.calib.logs.dataflash.clock import Clock
    from mavcal.calib.logs.dataflash.tables import Log, Table

ESTIMATORS: Final = ("XKF1", "NKF1", "EKF1")
QUATERNIONS: Final = ("XKQ", "NKQ", "XKQ1", "NKQ1")
_ESTIMATED: Final = (
    (Sensor.VELOCITY, ("VN", "VE", "VD"), "m/s"),
    (Sensor.PLACE, ("PN", "PE", "PD"), "m"),
)


def dynamics_channels(log: Log, clock: Clock) -> tuple[Channel, ...]:
    """CONTROL, MIXER, VOLTAGE, HEIGHT, and the estimator's VELOCITY, PLACE and ATTITUDE, as far as the log has them."""
    found = [*_plain(log, clock), *_estimates(log, clock), *_attitudes(log, clock)]
    return tuple(channel for channel in found if len(channel))


def _plain(log: Log, clock: Clock) -> Iterator[Channel]:
    for name, sensor, columns, unit in (
        ("RATE", Sensor.CONTROL, ("ROut", "POut", "YOut", "AOut"), "1"),
        ("MOTB", Sensor.MIXER, ("LiftMax", "BatVolt", "ThLimit"), "1"),
    ):
        table = log.get(name)
        if table is not None and all(column in table for column in columns):
            yield channel_of(sensor, table, clock.times(table), table.arrays(columns)[0], unit)
    battery = log.get("BAT") or log.get("CURR")
    if battery is not None and "Volt" in battery:
        first = battery.where(_first(battery))
        scale = 0.01 if battery.format.letter("Volt") in {"h", "H"} else 1.0
        yield channel_of(Sensor.VOLTAGE, first, clock.times(first), scale * first["Volt"], "V")
    finder = log.get("RFND")
    column = None if finder is None else next((c for c in ("Dist", "Dist1") if c in finder), None)
    if finder is not None and column is not None:
        yield channel_of(Sensor.HEIGHT, finder, clock.times(finder), finder[column], "m")


def _first(table: Table) -> NDArray[np.bool_]:
    """Which rows are of the first instance."""
    column = next((c for c in INSTANCE_COLUMNS if c in table), None)
    return np.ones(len(table), dtype=bool) if column is None else np.asarray(table[column] == table[column].min())


def _estimates(log: Log, clock: Clock) -> Iterator[Channel]:
    table = next((log[name] for name in ESTIMATORS if name in log), None)
    if table is None:
        return
    for core, rows in _cores(table):
        for sensor, columns, unit in _ESTIMATED:
            if all(column in rows for column in columns):
                yield channel_of(sensor, rows, clock.times(rows), rows.arrays(columns)[0], unit, instance=core)


def _attitudes(log: Log, clock: Clock) -> Iterator[Channel]:
    table = next((log[name] for name in QUATERNIONS if name in log), None)
    columns = ("Q1", "Q2", "Q3", "Q4")
    if table is None or any(column not in table for column in columns):
        return
    for core, rows in _cores(table):
        q = unit_quaternions(np.column_stack(rows.columns(*columns)).astype(np.float64))
        yield channel_of(Sensor.ATTITUDE, rows, clock.times(rows), q, "1", instance=core)


def _cores(table: Table) -> Iterator[tuple[int, Table]]:
    """The rows of each core of the estimator."""
    if "C" not in table:
        yield from instances(table, 0)
        return
    cores = table["C"]
    for core in np.unique(cores).tolist():
        yield int(core), table.where(cores == core)
