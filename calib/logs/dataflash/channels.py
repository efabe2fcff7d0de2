"""Inertial units and compasses of a DataFlash log as channels: instances sorted out, bins to their middles."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Final

import numpy as np

from mavcal.calib.firmware.ardupilot.log_fields import COMPASS, INERTIAL, INSTANCE_COLUMNS, LogReading
from mavcal.calib.logs.damaged import moving
from mavcal.calib.logs.dataflash.clock import Mask, ordered
from mavcal.calib.recording import Array, Channel, Event, Oddity, OddSamples, Rounding, Sensor

if TYPE_CHECKING:
    from mavcal.calib.logs.dataflash.clock import Clock
    from mavcal.calib.logs.dataflash.tables import Log, Table


INSTANCES: Final = 8
"""Most instances of a kind; a higher number is damage."""
WORDS: Final = {
    Oddity.UNREADABLE: "are no numbers that such a sensor can read",
    Oddity.UNHEALTHY: "the vehicle itself calls unhealthy",
    Oddity.ZERO: "are exactly 0, 0, 0, which such a sensor never reads",
}
_NEVER_ZERO: Final = (Sensor.ACCEL, Sensor.GYRO, Sensor.MAG)
"""Sensors that count as dead if they read only zeros."""


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
        health = [reading.healthy for reading, _ in present if reading.healthy in table]
        for instance, rows in instances(table, number):
            t = self._clock.sample_times(rows)
            keep = self._in_time(rows, instance, t)
            healthy = {name: column != 0 for name, column in zip(health, rows.columns(*health), strict=True)}
            data = rows.arrays(*(columns for _, columns in present))
            for reading, _ in present:
                values = data.pop(0)  # what becomes of it is the only copy
                good = keep & self._good(rows, reading, instance, t, values, healthy.get(reading.healthy))
                channel = _channel(rows, reading, instance, t, values, good)
                if channel is not None:
                    yield channel

    def _in_time(self, rows: Table, instance: int, t: Array) -> Mask:
        """The rows in order of time; the others are counted in an event."""
        keep = ordered(t)
        back = int((np.isfinite(t) & ~keep).sum())
        stood = np.flatnonzero(keep)[~moving(t[keep])]
        keep[stood] = False
        for count, why in ((back, "times that go back"), (len(stood), "one time all over: the clock stood still")):
            if count:
                text = f"{count} of {len(t)} samples of {rows.name}, instance {instance + 1}, carry {why}; left out"
                first = t[np.isfinite(t)]
                self.events.append(Event(float(first[0]) if len(first) else 0.0, "damage", text))
        return keep

    def _good(
        self, table: Table, reading: LogReading, instance: int, t: Array, values: Array, healthy: Mask | None
    ) -> Mask:
        good = _readable(values, reading.most)
        if not good.all():
            self._note(reading, instance, t, ~good, Oddity.UNREADABLE, table)
        if healthy is not None and not healthy.all():
            self._note(reading, instance, t, ~healthy, Oddity.UNHEALTHY, table)
            if healthy.any():  # else they are all that there is, and whoever judges them knows of it
                good &= healthy
        if reading.sensor in _NEVER_ZERO:
            zero: Mask = ~np.asarray(values.any(axis=1))
            if zero.all() and len(zero):
                text = f"{reading.sensor} {instance + 1}: all {len(zero)} samples of {table.name} are exactly 0, 0, 0"
                first, odd = _odd_samples(Oddity.ZERO, reading, instance, t, zero)
                self.events.append(Event(first, "dead", text, odd))
            elif zero.any() and reading.sensor != Sensor.GYRO:  # at rest a gyroscope of whole numbers may read 0
                self._note(reading, instance, t, zero, Oddity.ZERO, table)
                good &= ~zero
        if reading.sensor == Sensor.MAG:
            good &= _new_readings(t, values)
        return good

    def _note(self, reading: LogReading, instance: int, t: Array, bad: Mask, what: Oddity, table: Table) -> None:
        text = f"{reading.sensor} {instance + 1}: {int(bad.sum())} of {len(t)} samples of {table.name} {WORDS[what]}"
        first, odd = _odd_samples(what, reading, instance, t, bad)
        kept = what == Oddity.UNHEALTHY and bad.all()
        self.events.append(
            Event(first, "damage", f"{text}; {'kept, for there are no others' if kept else 'left out'}", odd)
        )


def _odd_samples(what: Oddity, reading: LogReading, instance: int, t: Array, bad: Mask) -> tuple[float, OddSamples]:
    """When the samples `bad` of `t` began, and how many they are."""
    when = t[bad][np.isfinite(t[bad])]
    first, last = (float(when[0]), float(when[-1])) if len(when) else (0.0, None)
    return first, OddSamples(what, reading.sensor, instance, int(bad.sum()), len(t), last)


def instances(table: Table, number: int) -> Iterator[tuple[int, Table]]:
    """The messages of each instance; `number` is the one that their name says."""
    column = next((name for name in INSTANCE_COLUMNS if name in table), None)
    if column is None:
        yield number, table
        return
    found = table[column]
    counts = np.bincount(found[(found >= 0) & (found < INSTANCES)].astype(np.intp), minlength=INSTANCES)
    for instance in np.flatnonzero(counts).tolist():
        yield instance, table if counts[instance] == len(found) else table.where(found == instance)


def _columns_of(table: Table, reading: LogReading) -> tuple[str, ...]:
    """The columns that hold the sensor in this version of the message; none if it does not."""
    return next((columns for columns in reading.columns if all(name in table for name in columns)), ())


def _channel(table: Table, reading: LogReading, instance: int, t: Array, values: Array, good: Mask) -> Channel | None:
    """Channel of the good rows; None if there are none, or only zeros: the sensor is absent."""
    if not good.all():
        t, values = t[good], values[good]
    if not len(t) or not values.any():  # a thermometer that is not there reads 0 as well
        return None
    zero_bin = None
    if reading.rounding == Rounding.TOWARD_ZERO:
        zero_bin = values == 0.0
        values = values + 0.5 * np.sign(values)  # bins are (k, k + 1) for k > 0 and (-1, 1) for 0
    if reading.factor != 1.0:
        values = values * reading.factor
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


def _readable(values: Array, most: float) -> Mask:
    """Rows whose numbers all lie within +-`most`."""
    with np.errstate(invalid="ignore"):
        if len(values) and values.min() >= -most and values.max() <= most:  # never true of a NaN
            return np.ones(len(values), dtype=bool)
        return np.asarray((np.abs(values) <= most).all(axis=1))


def _new_readings(t: Array, values: Array) -> Mask:
    """Rows with a new compass reading: its time advanced, or its values changed."""
    keep = np.ones(len(t), dtype=bool)
    keep[1:] = (np.diff(t) > 0.0) | (np.diff(values, axis=0) != 0.0).any(axis=1)
    return keep
