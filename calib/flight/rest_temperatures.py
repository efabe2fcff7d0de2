"""The samples of one sensor in every rest of one vehicle's logs, each with its temperature, its log and its pose."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.firmware.in_force.fingerprint import SENSOR_IDS
from mavcal.calib.flight.rest import Known, Rest, rests
from mavcal.calib.procedures.drift_fit import SHORTEST, DriftPool
from mavcal.calib.recording import Array, Channel, Recording, Sensor
from mavcal.calib.stats.windows import finite_rows
from mavcal.calib.thermal.drift import DriftData

_TICK = 0.25
"""Length of the averaging cells, s: within one, temperature and drift are linear."""
_PAUSE = 60.0
"""Pause, s, inserted between two logs on the common clock, so that they are not taken as continuous."""


@dataclass(frozen=True, eq=False)
class Log:
    """One log with the known calibration in force undone, and the rests of the vehicle in it."""

    name: str
    recording: Recording
    start: float  # on the common clock
    shift: float

    @property
    def temperature_of(self) -> Mapping[int, Channel]:
        """Thermometers by instance."""
        have = self.recording.instances(Sensor.TEMPERATURE)
        return {i: self.recording.channel(Sensor.TEMPERATURE, i) for i in have}


@dataclass(frozen=True, eq=False)
class RestTemperatures:
    """Samples of one sensor in the rests of every log, each row with its rest and its log."""

    channel: Channel
    """Without samples; states the sensor, its unit and its resolution."""
    data: DriftData
    rest: NDArray[np.intp]  # (N,)
    log: NDArray[np.intp]  # (N,)
    rests: tuple[Rest, ...]  # over all logs, on the clock of each
    logs: int

    @property
    def duration(self) -> float:
        """Duration of the rests, s."""
        return sum(rest.duration for rest in self.rests)

    @property
    def only_still(self) -> bool:
        """Whether stillness is the only evidence that the motors were off."""
        return any(rest.known == Known.STILLNESS for rest in self.rests)

    def covered(self, number: NDArray[np.intp]) -> float:
        """Temperature range, degC, that the rows of each `number` (N,) cover, united over all numbers."""
        ends = []
        for k in np.unique(number):
            t = self.data.t[number == k]
            if np.ptp(self.data.time[number == k]) >= SHORTEST:
                ends.append((float(t.min()), float(t.max())))
        total, reached = 0.0, -np.inf
        for low, high in sorted(ends):
            total += max(0.0, high - max(low, reached))
            reached = max(reached, high)
        return total


def logs_of(recordings: Sequence[Recording]) -> tuple[Log, ...]:
    """The logs one after the other on one clock.

    Raises
    ------
    InvalidInputError
        If they are not of one vehicle with the same sensors.
    """
    _check_one_vehicle(recordings)
    logs, clock = [], 0.0
    for recording in recordings:
        begin, end = recording.span
        if not np.isfinite(begin):
            raise InvalidInputError(f"{recording.source or 'the recording'} has no sample")
        logs.append(Log(recording.source, recording, begin, clock - begin))
        clock += end - begin + _PAUSE
    return tuple(logs)


def no_temperature(recording: Recording) -> str:
    """Advice for a recording without a temperature: log it on the vehicle, or name the column of a table."""
    if recording.identity.autopilot is None:
        return "the table has no temperature: name its column, --map temperature=COLUMN"
    return (
        f"{recording.source or 'the log'} has no temperature of this sensor: log it from the vehicle "
        "(DataFlash IMU.T; telemetry SCALED_IMU with its temperature or HIGHRES_IMU)"
    )


def rest_temperatures(
    logs: Sequence[Log], sensor: Sensor, instance: int, *, other: int | None = None
) -> RestTemperatures | None:
    """Samples of that sensor in the rests of every log; None: there is no row.

    With `other`, its samples minus those of that instance: motion and gravity cancel.

    Raises
    ------
    InvalidInputError
        If a log has the sensor and no thermometer.
    """
    pool = DriftPool()
    found: list[Rest] = []
    log_of: list[int] = []
    for number, log in enumerate(logs):
        channel = _channel(log, sensor, instance, other)
        if channel is None:
            continue
        thermometer = log.temperature_of.get(instance, log.temperature_of.get(0))
        if thermometer is None:
            raise InvalidInputError(no_temperature(log.recording))
        for rest in rests(log.recording, instance):
            if _add(pool, channel, thermometer, rest, log.shift, len(found)):
                found.append(rest)
                log_of.append(number)
    if (sensor, instance) not in pool or (Sensor.TEMPERATURE, instance) not in pool:
        return None
    data, rest_of = pool.data(sensor, instance)
    kept = pool[sensor, instance].channel
    assert kept is not None
    return RestTemperatures(
        kept, data, rest_of, np.asarray(log_of, dtype=np.intp)[rest_of], tuple(found), len(set(log_of))
    )


def _channel(log: Log, sensor: Sensor, instance: int, other: int | None) -> Channel | None:
    have = log.recording.instances(sensor)
    if instance not in have or (other is not None and other not in have):
        return None
    channel = log.recording.channel(sensor, instance)
    return channel if other is None else difference(channel, log.recording.channel(sensor, other))


def difference(channel: Channel, other: Channel) -> Channel | None:
    """`channel` minus `other` at the times of the first; None: no overlap, or incompatible bins or units."""
    if channel.unit != other.unit or channel.quantum > 0.0 or other.quantum > 0.0 or len(other) < 2:
        return None
    if len(channel) == len(other) and np.array_equal(channel.t, other.t):
        return dataclasses.replace(channel, values=channel.values - other.values)
    inside = (channel.t >= other.t[0]) & (channel.t <= other.t[-1])
    channel = channel.take(inside)
    if not len(channel):
        return None
    at = np.column_stack([np.interp(channel.t, other.t, column) for column in other.values.T])
    return dataclasses.replace(channel, values=channel.values - at)


def _add(pool: DriftPool, channel: Channel, thermometer: Channel, rest: Rest, shift: float, number: int) -> bool:
    """Add the cells of one rest; returns whether it has any."""
    part = _finite(channel.between(rest.start, rest.end))
    warm = _finite(thermometer.between(rest.start - 1.5, rest.end + 1.5))  # read once a second, or less often
    if not len(part) or not len(warm):
        return False
    warm = dataclasses.replace(warm, t=warm.t + shift, instance=channel.instance)
    part = dataclasses.replace(part, t=part.t + shift)
    pool.add({(Sensor.TEMPERATURE, channel.instance): warm.take(slice(0, 1))}, number)
    edges = np.arange(part.t[0], part.t[-1] + _TICK, _TICK)
    for piece, thermal in zip(_cut(part, edges), _cut(warm, edges), strict=True):
        frame = {(c.sensor, c.instance): c for c in (piece, thermal) if len(c)}
        pool.add(frame, number)
    return True


def _cut(channel: Channel, edges: Array) -> list[Channel]:
    """The samples between consecutive edges; later ones belong to the last piece."""
    at = np.searchsorted(channel.t, edges)
    bounds = [*at[:-1], len(channel)] if len(at) > 1 else [at[0], len(channel)]
    return [channel.take(slice(int(i), int(j))) for i, j in pairwise(bounds)]


def _finite(channel: Channel) -> Channel:
    good = finite_rows(channel.values)
    return channel if good.all() else channel.take(good)


def _check_one_vehicle(recordings: Sequence[Recording]) -> None:
    uids = {r.identity.uid for r in recordings if r.identity.uid is not None}
    if len(uids) > 1:
        raise InvalidInputError(f"the logs are of {len(uids)} different vehicles: calibrate one at a time")
    kinds = {r.identity.autopilot for r in recordings}
    if len(kinds) > 1:
        raise InvalidInputError("the logs are of different autopilots: calibrate one vehicle at a time")
    seen: dict[tuple[Sensor, int], int] = {}
    for recording in recordings:
        ids = SENSOR_IDS.get(recording.identity.autopilot or "")
        if ids is None or not recording.parameters:
            continue
        for key, value in ids(recording.parameters.final()).items():
            if key[0] != Sensor.MAG and seen.setdefault(key, value) != value:
                raise InvalidInputError(
                    f"{key[0]} {key[1] + 1} has the device id {seen[key]} in one log and {value} in "
                    f"{recording.source}: it is another sensor, pool only logs of the same one"
                )
