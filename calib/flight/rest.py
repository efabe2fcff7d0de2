"""Finds when a vehicle stood still on the ground with its motors off.

Stillness alone is not enough: a good multicopter hovering in calm air looks still. The autopilot's arming state or its
motor outputs decide. Where neither was recorded, only stillness is left, and every rest says so.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from itertools import pairwise

import numpy as np

from mavcal.calib.firmware.log_options import how_to_log_disarmed
from mavcal.calib.firmware.stream.auxiliary import telemetry
from mavcal.calib.logs.inspection import pauses
from mavcal.calib.recording import Channel, Recording, Sensor, Stage
from mavcal.calib.stats.still_limits import RESTING
from mavcal.calib.stats.stillness import Still, find_still

UNARMED, ARMED = "disarmed", "armed"
"""Event kinds that state whether the motors are off or on."""

LIMITS = dataclasses.replace(RESTING, accel_drift=0.04, gyro_drift=0.05)
"""Limits of rest through a warm-up. The means may drift by 0.4 m/s2 and 3 deg/s, as they do over fifty degrees. A
vehicle that is moved by as much shakes or tilts."""

SUBMARINE = 12
"""MAV_TYPE_SUBMARINE."""
_NEUTRAL = 0.5  # throttle of a sub at rest (ArduSub ``get_throttle``; VFR_HUD and CTUN carry it)
SHORTEST = 2.0  # s of a rest that is told from
LEAST_RATE = 8.0  # Hz of inertial samples from which on a window of half a second has enough of them
_OFF = 0.03  # of the range of a motor output
_SETTLED = 0.5  # s after the motors stopped: rotors run down
_FIRST_STATE = 3.0  # s after the start until which a first state is told: heartbeats come once a second


class Phase(StrEnum):
    """Position of a rest in the recording."""

    BEFORE = "before"  # the first flight, or there is none
    BETWEEN = "between"  # two flights
    AFTER = "after"  # the last flight


class Known(StrEnum):
    """Evidence that the motors were off."""

    ARMING = "arming"
    MOTORS = "motors"
    STILLNESS = "stillness"  # nothing tells: it was only still


@dataclass(frozen=True)
class TimeSpan:
    """A stretch of time, s."""

    start: float
    end: float

    @property
    def duration(self) -> float:
        """Length, s."""
        return self.end - self.start


@dataclass(frozen=True)
class Rest(TimeSpan):
    """A still span with the motors off."""

    phase: Phase
    known: Known


@dataclass(frozen=True)
class Ground:
    """Times with the motors off and on, with the evidence."""

    off: tuple[TimeSpan, ...]
    running: tuple[TimeSpan, ...]
    known: Known


def too_slow(recording: Recording) -> float | None:
    """Rate of the slowest inertial stream, Hz, where it cannot show a rest; None: it can, or there is none."""
    periods = [
        float(np.median(np.diff(c.t)))
        for c in recording.channels
        if c.sensor in (Sensor.ACCEL, Sensor.GYRO) and c.stage != Stage.DEBIASED and len(c) > 1
    ]
    slowest = 1.0 / max(periods) if periods and max(periods) > 0.0 else np.inf
    return slowest if slowest < LEAST_RATE else None


def why_no_rest(recording: Recording) -> str:
    """What a log without a rest lacks: samples of the sensors themselves, fast enough to see one, or the rest."""
    inertial = [c.stage for c in recording.channels if c.sensor in (Sensor.ACCEL, Sensor.GYRO)]
    if inertial and all(stage == Stage.DEBIASED for stage in inertial):
        return "an estimator's bias is taken out of all inertial samples: no rest is told from them"
    rate = too_slow(recording)
    if rate is not None:
        return f"{rate:.2g} Hz are too slow to tell a rest: {LEAST_RATE:.0f} Hz are needed"
    return f"no rest of {SHORTEST:.0f} s with the motors off"


def how_to_rest(recording: Recording) -> str:
    """Instruction for recording a rest, without a full stop."""
    if telemetry(recording):
        return "Record the telemetry while the vehicle is disarmed as well"
    return f"Set {how_to_log_disarmed(recording.identity.autopilot)}"


def ground(recording: Recording) -> Ground:
    """The spans in which the motors were off; pauses of the recording are in neither kind."""
    begin, end = recording.span
    if not np.isfinite(begin):
        return Ground((), (), Known.STILLNESS)
    paused = tuple(TimeSpan(p.start, p.start + p.length) for p in pauses(recording))
    armed = _armed(recording, begin, end)
    if armed is not None:
        return Ground(_between(armed, begin, end, _SETTLED), _without(armed, paused), Known.ARMING)
    spun = _spun(recording)
    if spun is not None:
        return Ground(_between(spun, begin, end, _SETTLED), _without(spun, paused), Known.MOTORS)
    return Ground((TimeSpan(begin, end),), (), Known.STILLNESS)


def rests(recording: Recording, instance: int = 0) -> tuple[Rest, ...]:
    """Every rest of `recording` as the inertial unit `instance` saw it, in order of time.

    Raises
    ------
    InvalidInputError
        If it has neither accelerometer nor gyroscope of that instance.
    """
    stood = ground(recording)
    found = []
    for span in stood.off:
        part = recording.between(span.start, np.nextafter(span.end, np.inf))
        if not any(len(c) > 1 for s in (Sensor.ACCEL, Sensor.GYRO) for c in part.find(s, instance)):
            continue
        for still in find_still(part, instance=instance, limits=LIMITS):
            found.append(Rest(still.start, still.end, _phase(still.start, stood.running), stood.known))
    if not stood.off and not stood.running:
        find_still(recording, instance=instance, limits=LIMITS)  # says what is missing
    return tuple(found)


def grounded(recording: Recording, stills: Sequence[Still], shortest: float) -> tuple[Still, ...]:
    """Parts of `stills` within spans with the motors off, of `shortest` seconds or more."""
    off = ground(recording).off
    parts = [
        dataclasses.replace(still, start=max(still.start, span.start), end=min(still.end, span.end))
        for still in stills
        for span in off
        if still.start < span.end and span.start < still.end
    ]
    return tuple(part for part in parts if part.duration >= shortest)


def _phase(start: float, running: tuple[TimeSpan, ...]) -> Phase:
    before = [span for span in running if span.end <= start]
    if not before:
        return Phase.BEFORE
    return Phase.AFTER if len(before) == len(running) else Phase.BETWEEN


def _armed(recording: Recording, begin: float, end: float) -> tuple[TimeSpan, ...] | None:
    """Armed spans; None where the recording never mentions arming."""
    events = sorted((e.t, e.kind == ARMED) for e in recording.events if e.kind in (ARMED, UNARMED))
    if not events:
        return None
    # PX4's logs and telemetry begin with a state, soon after the first sample; events on board are changes
    states_first = recording.identity.autopilot == "px4" or telemetry(recording)
    before = events[0][1] if states_first and events[0][0] - begin < _FIRST_STATE else not events[0][1]
    states = [(begin, before), *events, (end, events[-1][1])]
    return _merged([TimeSpan(a, max(a, b)) for (a, on), (b, _) in pairwise(states) if on])


def _spun(recording: Recording) -> tuple[TimeSpan, ...] | None:
    """Spans in which a motor was driven; None: not logged."""
    channels = recording.find(Sensor.MOTOR) or recording.find(Sensor.THROTTLE)
    channel = max(channels, key=len, default=None)
    if channel is None or not np.isfinite(channel.values).any():
        return None
    # a sub's throttle is half of its range where it neither climbs nor dives
    neutral = channel.sensor == Sensor.THROTTLE and recording.identity.vehicle_type == SUBMARINE
    return _merged(_high(channel, _NEUTRAL if neutral else 0.0))


def _high(channel: Channel, idle: float) -> list[TimeSpan]:
    """Spans with an output that leaves `idle`, from the last sample at it to the next one."""
    values = channel.values - idle
    highest = np.abs(np.where(np.isfinite(values), values, 0.0)).max(axis=1)
    rising = np.diff((highest > _OFF).astype(np.int8), prepend=0, append=0)
    first, last = np.flatnonzero(rising > 0) - 1, np.flatnonzero(rising < 0)
    t, end = channel.t, len(channel) - 1
    return [TimeSpan(float(t[max(int(i), 0)]), float(t[min(int(j), end)])) for i, j in zip(first, last, strict=True)]


def _merged(spans: list[TimeSpan]) -> tuple[TimeSpan, ...]:
    merged: list[TimeSpan] = []
    for span in spans:
        if merged and span.start <= merged[-1].end:
            merged[-1] = TimeSpan(merged[-1].start, max(merged[-1].end, span.end))
        elif span.duration > 0.0:
            merged.append(span)
    return tuple(merged)


def _without(spans: tuple[TimeSpan, ...], holes: tuple[TimeSpan, ...]) -> tuple[TimeSpan, ...]:
    """The parts of `spans` outside `holes`."""
    for hole in holes:
        cut = [
            TimeSpan(a, b)
            for s in spans
            for a, b in ((s.start, min(s.end, hole.start)), (max(s.start, hole.end), s.end))
        ]
        spans = tuple(span for span in cut if span.duration > 0.0)
    return spans


def _between(spans: tuple[TimeSpan, ...], begin: float, end: float, settle: float) -> tuple[TimeSpan, ...]:
    """What `spans` leave of the recording, each gap shortened by `settle` where it follows a span."""
    edges = [begin, *(t for span in spans for t in (span.start, span.end + settle)), end]
    gaps = [TimeSpan(a, b) for a, b in zip(edges[::2], edges[1::2], strict=True)]
    return tuple(gap for gap in gaps if gap.duration > 0.0)
