"""Inertial units and compasses of a DataFlash log as channels: instances sorted out, bins to their middles."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from calib.firmware.log_fields import COMPASS, INERTIAL, INSTANCE_COLUMNS, LogReading
from calib.recording import Channel, Rounding, Sensor

if TYPE_CHECKING:
    from calib.logs.dataflash.clock import Clock
    from calib.logs.dataflash.log import Log, Table

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

INSTANCES: Final = 8
"""No vehicle has more of a kind; a higher number is damage."""


def inertial_channels(log: Log, clock: Clock) -> list[Channel]:
    """Every accelerometer, gyroscope and thermometer of the log, the firmware's own rates kept."""
    return [channel for reading in INERTIAL for channel in _channels(log, clock, reading)]


def compass_channels(log: Log, clock: Clock) -> list[Channel]:
    """Every compass; a sample that is logged again unchanged, before the compass was read anew, is left out."""
    return list(_channels(log, clock, COMPASS))


def instances(table: Table, number: int) -> Iterator[tuple[int, slice | Mask]]:
    """Instances of a message and their rows; `number` is the one that its name says."""
    column = next((name for name in INSTANCE_COLUMNS if name in table), None)
    if column is None:
        yield number, slice(None)
        return
    found = table[column]
    counts = np.bincount(found[found < INSTANCES].astype(np.intp), minlength=INSTANCES)
    for instance in np.flatnonzero(counts).tolist():
        yield instance, slice(None) if counts[instance] == len(found) else found == instance


def _channels(log: Log, clock: Clock, reading: LogReading) -> Iterator[Channel]:
    for number, message in enumerate(reading.messages):
        table = log.get(message)
        if table is None or not len(table):
            continue
        columns = next((c for c in reading.columns if all(name in table for name in c)), None)
        if columns is None:
            continue
        for instance, rows in instances(table, number):
            channel = _channel(table, clock, reading, columns, instance, rows)
            if channel is not None:
                yield channel


def _channel(
    table: Table, clock: Clock, reading: LogReading, columns: tuple[str, ...], instance: int, rows: slice | Mask
) -> Channel | None:
    t, keep = clock.sample_times(table, rows)
    found = [column[rows] for column in table.columns(*columns)]
    if reading.healthy in table:
        keep = keep & (table[reading.healthy][rows] != 0)
    if reading.sensor == Sensor.MAG:
        keep = keep & _read_anew(t, found)
    values = np.empty((len(t), len(columns)))
    for k, column in enumerate(found):
        values[:, k] = column
    if not keep.all():
        t, values = t[keep], values[keep]
    if not len(t) or not values.any():
        return None
    zero_bin = None
    if reading.rounding == Rounding.TOWARD_ZERO:
        zero_bin = values == 0.0
        values += 0.5 * np.sign(values)  # bins are (k, k + 1) for k > 0 and (-1, 1) for 0
    if reading.factor != 1.0:
        values *= reading.factor
    return Channel(
        sensor=reading.sensor,
        instance=instance,
        t=t,
        values=values,
        unit=reading.unit,
        stage=reading.stage,
        source=table.name,
        quantum=reading.quantum,
        rounding=reading.rounding,
        zero_bin=zero_bin,
    )


def _read_anew(t: Array, columns: list[NDArray[np.generic]]) -> Mask:
    """Rows whose compass was read after the row before: its time went on, or the numbers changed."""
    keep = np.ones(len(t), dtype=bool)
    same = np.diff(t) <= 0.0
    for column in columns:
        same &= column[1:] == column[:-1]
    keep[1:] = ~same
    return keep
