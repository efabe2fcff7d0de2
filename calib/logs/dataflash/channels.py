"""Inertial units and compasses of a DataFlash log as channels: instances sorted out, bins to their middles."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from calib.firmware.log_fields import COMPASS, INERTIAL, INSTANCE_COLUMNS, LogReading
from calib.logs.dataflash.clock import ordered
from calib.recording import Channel, Event, Rounding, Sensor

if TYPE_CHECKING:
    from calib.logs.dataflash.clock import Clock
    from calib.logs.dataflash.tables import Column, Log, Table

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Rows = slice | Mask

INSTANCES: Final = 8
"""No vehicle has more of a kind; a higher number is damage."""


class SensorChannels:
    """The channels of every accelerometer, gyroscope, thermometer and compass of `log`.

    `events` says how many samples were left out because the firmware itself distrusted them.
    """

    def __init__(self, log: Log, clock: Clock) -> None:
        self._clock = clock
        self.events: list[Event] = []
        self.channels: list[Channel] = []
        messages: dict[str, tuple[int, list[LogReading]]] = {}
        for reading in (*INERTIAL, COMPASS):
            for number, message in enumerate(reading.messages):
                messages.setdefault(message, (number, []))[1].append(reading)
        for message, (number, readings) in messages.items():
            table = log.get(message)
            if table is not None and len(table):
                self.channels += self._of_table(table, number, readings)
        order = list(Sensor)
        self.channels.sort(key=lambda c: (order.index(c.sensor), c.source[:3] != "IMU", c.instance))

    def _of_table(self, table: Table, number: int, readings: list[LogReading]) -> Iterator[Channel]:
        present = [(reading, columns) for reading in readings if (columns := _columns_of(table, reading))]
        wanted = {name for _, columns in present for name in columns}
        wanted |= {reading.healthy for reading, _ in present if reading.healthy in table}
        data = dict(zip(wanted, table.columns(*wanted), strict=True))
        written = self._clock.times(table)
        for instance, rows in instances(table, number):
            t = self._clock.sample_times(table, written[rows], rows)
            keep = ordered(t)
            for reading, columns in present:
                healthy = data[reading.healthy][rows] != 0 if reading.healthy in data else None
                channel = self._channel(table, reading, instance, t, [data[c][rows] for c in columns], keep, healthy)
                if channel is not None:
                    yield channel

    def _channel(
        self,
        table: Table,
        reading: LogReading,
        instance: int,
        t: Array,
        columns: list[Column],
        keep: Mask,
        healthy: Mask | None,
    ) -> Channel | None:
        if healthy is not None and not healthy.all() and healthy.any():
            self._say(reading, instance, t, ~healthy, "the vehicle itself calls unhealthy", table)
            keep = keep & healthy
        if reading.sensor == Sensor.MAG:
            zero = ~np.any(columns, axis=0)
            if zero.any() and not zero.all():
                self._say(reading, instance, t, zero, "are exactly 0, 0, 0, which no field is", table)
            keep = keep & ~zero & _read_anew(t, columns)
        if keep.all():
            values = np.empty((len(t), len(columns)))
            for k, column in enumerate(columns):
                values[:, k] = column
        else:
            t, values = t[keep], np.column_stack([column[keep] for column in columns]).astype(np.float64)
        if not len(t) or not values.any():
            return None
        return _made(table, reading, instance, t, values)

    def _say(self, reading: LogReading, instance: int, t: Array, bad: Mask, why: str, table: Table) -> None:
        first = float(t[np.argmax(bad)])
        text = f"{reading.sensor} {instance + 1}: {int(bad.sum())} of {len(t)} samples of {table.name} {why}"
        self.events.append(Event(first if np.isfinite(first) else 0.0, "damage", f"{text}; left out"))


def instances(table: Table, number: int) -> Iterator[tuple[int, Rows]]:
    """Instances of a message and their rows; `number` is the one that its name says."""
    column = next((name for name in INSTANCE_COLUMNS if name in table), None)
    if column is None:
        yield number, slice(None)
        return
    found = table[column]
    counts = np.bincount(found[(found >= 0) & (found < INSTANCES)].astype(np.intp), minlength=INSTANCES)
    for instance in np.flatnonzero(counts).tolist():
        yield instance, slice(None) if counts[instance] == len(found) else found == instance


def _columns_of(table: Table, reading: LogReading) -> tuple[str, ...]:
    """The columns that hold the sensor in this version of the message; none if it does not."""
    return next((columns for columns in reading.columns if all(name in table for name in columns)), ())


def _made(table: Table, reading: LogReading, instance: int, t: Array, values: Array) -> Channel:
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


def _read_anew(t: Array, columns: list[Column]) -> Mask:
    """Rows whose compass was read after the row before: its time went on, or the numbers changed."""
    keep = np.ones(len(t), dtype=bool)
    same = np.diff(t) <= 0.0
    for column in columns:
        same &= column[1:] == column[:-1]
    keep[1:] = ~same
    return keep
