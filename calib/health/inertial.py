"""Checks accelerometers and gyroscopes: gravity, drift at rest, offset from the attitude, agreement of units."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Final

import numpy as np

from mavcal.calib import STANDARD_GRAVITY
from mavcal.calib.errors import InvalidInputError
from mavcal.calib.flight.craft import craft_of
from mavcal.calib.flight.flying import usable
from mavcal.calib.flight.rest import TimeSpan, too_slow
from mavcal.calib.flight.resting import gravity_of_place
from mavcal.calib.health import limits, motion
from mavcal.calib.health.channels import judged_channel, never_calibrated, why_unjudged
from mavcal.calib.health.finding import BAD, Compared, HealthFinding, HealthVerdict, judged_value, shown_sd
from mavcal.calib.health.support import Support, support_of
from mavcal.calib.recording import Channel, Recording, Sensor
from mavcal.calib.stats.still_limits import RESTING, StillnessLimits
from mavcal.calib.stats.stillness import Still, find_still

_LAID: Final = dataclasses.replace(RESTING, rate=3.0, accel_drift=0.04, gyro_drift=0.05)
"""Limits of stillness with any gyroscope offset: a sensor 100 deg/s off must not hide that nothing moved."""
_ENOUGH_HZ: Final = 100.0
_LEAST_OF_WINDOW: Final = 6.0
"""Least number of samples in a window in which stillness is judged."""
_SLOWEST_WINDOW_S: Final = 5.0
"""Longest window, s, in which stillness is judged: a longer one hides faster movement."""
_MOSTLY: Final = 0.5
"""Fraction of the samples: a vehicle motionless for more of a log lay on the ground and needs no attitude."""
_SPAN_S: Final = 5.0
"""Shortest span, s, whose mean is compared."""
_DRIFT_S: Final = 60.0
"""Least motionless time, s, that shows a drift."""
_FLOOR_FORCE: Final = 0.02
"""Error of the vertical force, m/s2, from an attitude error of 4 deg."""
_FLOOR_LENGTH: Final = 0.1
"""Difference, m/s2, of the length of a mean force in flight from gravity."""
_BEYOND: Final = "beyond the turn of the attitude"
_LEVEL: Final = "beyond the tilting of the attitude"
_ACROSS: Final = "while the direction of the force stood still"
_NO_JUDGE: Final = ". The logged attitude is no judge: "
_CLEARLY: Final = 2.0
"""Ratio of the errors of two units above which the first is clearly worse."""
_TOO_LITTLE: Final = "too few samples beside an attitude, and no motionless second"
_LOG_MORE: Final = "Log the attitude and faster samples, or a rest."
_APART: Final = {Sensor.ACCEL: limits.FORCES_APART, Sensor.GYRO: limits.RATES_APART}
_CALIBRATE: Final = {
    Sensor.ACCEL: "Calibrate the accelerometer: six faces and four oblique poses.",
    Sensor.GYRO: "Calibrate the gyroscope: ten seconds at rest.",
}


def motionless(recording: Recording, instance: int) -> tuple[Still, ...]:
    """Spans in which that unit did not move, motors on or off."""
    try:
        watched = [
            _thinned(recording.channel(sensor, instance))
            for sensor in (Sensor.ACCEL, Sensor.GYRO)
            if instance in recording.instances(sensor)
        ]
        return find_still(recording.with_channels(watched), instance=instance, limits=_for_rate(watched))
    except InvalidInputError:
        return ()


def _for_rate(watched: Sequence[Channel]) -> StillnessLimits:
    """`_LAID` with longer windows for a slow stream such as telemetry, so that each has enough samples."""
    periods = [float(np.median(np.diff(c.t))) for c in watched if len(c) > 1]
    window = max((_LEAST_OF_WINDOW * period for period in periods), default=0.0)
    if not _LAID.window < window <= _SLOWEST_WINDOW_S:
        return _LAID
    return dataclasses.replace(_LAID, window=window, shortest=2.0 * window)


def _thinned(channel: Channel) -> Channel:
    """`channel` thinned to at most `_ENOUGH_HZ`: a higher rate does not make stillness more certain."""
    period = float(np.median(np.diff(channel.t))) if len(channel) > 1 else 0.0
    every = int(1.0 / (_ENOUGH_HZ * period)) if period > 0.0 else 1
    return channel.take(slice(None, None, every)) if every > 1 else channel


def inertial_findings(
    recording: Recording, off: Sequence[TimeSpan], support: Support | None = None
) -> Iterator[HealthFinding]:
    """Readings of every accelerometer and gyroscope; `off` are the spans with the motors off.

    `support` contradicts the logged attitude; None: it is computed from `recording`.
    """
    attitude = next(iter(recording.find(Sensor.ATTITUDE)), None)
    support = support_of(recording, attitude) if support is None else support
    spans: dict[int, tuple[Still, ...]] = {}
    slow = too_slow(recording) is not None
    for sensor in (Sensor.ACCEL, Sensor.GYRO):
        found: dict[int, Channel] = {}
        own: dict[int, HealthFinding] = {}
        for instance in recording.instances(sensor):
            channel = judged_channel(recording, sensor, instance)
            if channel is None:
                yield HealthFinding(
                    "offset", sensor, instance, HealthVerdict.CANNOT_SAY, why_unjudged(recording, sensor, instance)
                )
                continue
            found[instance] = channel
            if instance not in spans:
                spans[instance] = motionless(recording, instance)
            laid = spans[instance]
            if sensor == Sensor.ACCEL:
                own[instance] = _gravity(recording, channel, attitude, support, laid)
                yield _drift(channel, laid if _lay(channel, laid) else _within(laid, off))
            else:
                accel = _accel_of_unit(recording, instance)
                resting = () if slow else _within(laid, off)
                own[instance] = _rate(channel, _MotionReference(attitude, support, accel), laid, resting)
        yield from _against_others(found, own)


def _within(laid: Sequence[Still], spans: Sequence[TimeSpan]) -> tuple[Still, ...]:
    """The still spans that lie entirely within one of `spans`."""
    return tuple(s for s in laid if any(span.start <= s.start and s.end <= span.end for span in spans))


def _still_means(channel: Channel, laid: Sequence[Still]) -> motion.WindowMeans:
    """One mean for each motionless span."""
    parts = [usable(channel.between(span.start, span.end)) for span in laid]
    kept = [part for part in parts if len(part) > 3]
    if not kept:
        return motion.WindowMeans(np.zeros(0), np.zeros((0, 3)))
    return motion.WindowMeans(
        np.array([0.5 * (p.t[0] + p.t[-1]) for p in kept]), np.array([p.values.mean(axis=0) for p in kept])
    )


def _lay(channel: Channel, laid: Sequence[Still]) -> bool:
    """Whether the unit was motionless for most of its samples."""
    still = sum(len(channel.between(span.start, span.end)) for span in laid)
    return still > _MOSTLY * len(channel)


def _gravity(
    recording: Recording, channel: Channel, attitude: Channel | None, support: Support, laid: Sequence[Still]
) -> HealthFinding:
    """The vertical force in flight, else the length of the force while motionless, against gravity."""
    gravity, known = gravity_of_place(recording)
    low, high = sorted((gravity, STANDARD_GRAVITY)) if known else (9.78, 9.83)
    windows = motion.WindowMeans(np.zeros(0), np.zeros((0, 1)))
    how = f"along the vertical {craft_of(recording.identity).moving}"
    against, unsure = "", _FLOOR_FORCE
    if attitude is not None and not _lay(channel, laid):
        if support.tilt:
            windows, how, unsure = motion.mean_lengths(channel, laid), "on average", _FLOOR_LENGTH
            against = f"{_NO_JUDGE}{support.tilt}"
        else:
            windows = motion.vertical_force(channel, attitude)
    if not windows.enough:
        still = _still_means(channel, laid)
        windows, how = (
            dataclasses.replace(still, values=np.linalg.norm(still.values, axis=1)[:, None]),
            "while motionless",
        )
        if not len(windows.t):
            text = f"{_TOO_LITTLE}: gravity cannot be told from motion"
            return _unknown("gravity", Sensor.ACCEL, channel.instance, text, _LOG_MORE)
    force = float(windows.median[0])
    sd = float(np.hypot(windows.sd[0], unsure))
    off = max(force - high, low - force, 0.0)
    verdict = judged_value(off, sd, limits.FORCE)
    text = f"reads {force:.2f} ± {shown_sd(sd)} m/s2 {how}; gravity is {gravity:.2f}{against}"
    if verdict in BAD and never_calibrated(recording, Sensor.ACCEL, channel.instance):
        text += ". It was never calibrated: its offsets are 0 and its scales 1"
    return _finding("gravity", channel, verdict, text, Compared(off, sd, limits.FORCE))


def _drift(channel: Channel, laid: Sequence[Still]) -> HealthFinding:
    """Change of the specific force's length while the vehicle was still."""
    long = [span for span in laid if span.duration >= _SPAN_S]  # in a shorter one a climb begins or ends
    means = _still_means(channel, long)
    total = sum(span.duration for span in long)
    if total < _DRIFT_S or len(means.t) < motion.LEAST_WINDOWS:
        text = f"motionless for {total:.0f} s in all: {_DRIFT_S:.0f} s in {motion.LEAST_WINDOWS} spans tell of a drift"
        return _unknown("drift", Sensor.ACCEL, channel.instance, text, "")
    length = np.linalg.norm(means.values, axis=1)
    third = max(len(length) // 3, 1)
    first, last = float(np.median(length[:third])), float(np.median(length[-third:]))
    least, most = np.percentile(length, (5.0, 95.0)).tolist()
    noise = float(np.median(np.abs(np.diff(length)))) if len(length) > 1 else 0.0
    moved = max(most - least, abs(last - first))
    verdict = judged_value(moved, noise, limits.FORCE_DRIFT)
    minutes = (float(means.t[-1]) - float(means.t[0])) / 60.0
    text = f"its reading of gravity wandered by {moved:.2f} m/s2 in {minutes:.0f} min while motionless"
    if verdict in BAD:
        text += f", between {min(least, first, last):.2f} and {max(most, first, last):.2f} m/s2"
    made = _finding("drift", channel, verdict, text, Compared(moved, noise, limits.FORCE_DRIFT))
    return dataclasses.replace(made, start=long[0].start, end=long[-1].end)


@dataclass(frozen=True, eq=False)
class _MotionReference:
    """References for a gyroscope while its vehicle moves."""

    attitude: Channel | None
    support: Support
    accel: Channel | None


def _accel_of_unit(recording: Recording, instance: int) -> Channel | None:
    """The accelerometer of that unit, else the first there is."""
    own = [i for i in recording.instances(Sensor.ACCEL) if i == instance] or recording.instances(Sensor.ACCEL)[:1]
    return judged_channel(recording, Sensor.ACCEL, own[0]) if own else None


def _rate(
    channel: Channel, reference: _MotionReference, laid: Sequence[Still], rested: Sequence[Still]
) -> HealthFinding:
    """Mean rate at rest, or the excess over a reference's rate, whichever has the smaller error.

    `laid` are motionless spans, which may include a calm, slowly turning hover; `rested` are those with the motors off.
    """
    still = [s for s in rested if s.duration >= _SPAN_S] or (laid if _lay(channel, laid) else ())
    windows, how = _still_means(channel, still), "at rest" if still and still is not laid else "while motionless"
    unsure = len(windows.t) < 1 or 2.0 * float(np.linalg.norm(windows.sd)) > limits.RATE.suspicious
    if unsure or not _lay(channel, laid):
        seen, by = _moving(channel, reference, laid)
        if len(seen.t) and (unsure or np.linalg.norm(seen.median) > np.linalg.norm(windows.median)):
            windows, how = seen, by
    if not len(windows.t):
        windows, how = _still_means(channel, laid), "while motionless"
        if not len(windows.t):
            text = f"{_TOO_LITTLE}: an offset cannot be told from a turn"
            return _unknown("offset", Sensor.GYRO, channel.instance, text, _LOG_MORE)
    rate, sd = float(np.linalg.norm(windows.median)), float(np.linalg.norm(windows.sd))
    verdict = judged_value(rate, sd, limits.RATE)
    axes = ", ".join(f"{np.degrees(v):+.2f}" for v in windows.median)
    text = f"reads {np.degrees(rate):.2f} ± {shown_sd(float(np.degrees(sd)))} deg/s {how}: ({axes}) deg/s"
    if how == _ACROSS:
        text += f"{_NO_JUDGE}{reference.support.tilt}"
    if verdict == HealthVerdict.OK and how == _LEVEL:
        verdict, more = _heading_open(channel, reference)
        text += more
    return _finding("offset", channel, verdict, text, Compared(rate, sd, limits.RATE))


def _moving(channel: Channel, reference: _MotionReference, laid: Sequence[Still]) -> tuple[motion.WindowMeans, str]:
    """Excess of the rate over the best reference of a movement, and which that is; no window: there is none."""
    if reference.attitude is None:
        return motion.no_windows(3), ""
    if reference.support.tilt:
        if reference.accel is None:
            return motion.no_windows(3), ""
        return motion.rates_across(channel, reference.accel, laid), _ACROSS
    part, how = (motion.RatePart.LEVEL, _LEVEL) if reference.support.heading else (motion.RatePart.ALL, _BEYOND)
    seen = motion.rate_error(channel, reference.attitude, part)
    return (seen, how) if seen.enough else (motion.no_windows(3), "")


def _heading_open(channel: Channel, reference: _MotionReference) -> tuple[HealthVerdict, str]:
    """Verdict and text about the vertical axis alone, where nothing confirms the heading of the attitude."""
    assert reference.attitude is not None
    turn = motion.rate_error(channel, reference.attitude, motion.RatePart.VERTICAL)
    rate, sd = float(np.linalg.norm(turn.median)), float(np.linalg.norm(turn.sd))
    if judged_value(rate, sd, limits.RATE) == HealthVerdict.OK:
        return HealthVerdict.OK, ""
    return HealthVerdict.CANNOT_SAY, (
        f". About the vertical it turns by {np.degrees(rate):.2f} ± {shown_sd(float(np.degrees(sd)))} deg/s beyond "
        f"the attitude, whose heading is not to be believed ({reference.support.heading}): "
        "ten seconds at rest would decide"
    )


def _doubted(one: HealthFinding, others: Sequence[int]) -> HealthFinding:
    """Finding on an offset that only the attitude shows; suspicious at most where `others` agree with the gyroscope."""
    if one.verdict not in BAD or not others or _BEYOND not in one.text:
        return one
    listed = " and ".join(str(other + 1) for other in others)
    text = (
        f"{one.text}. Gyroscope{'s' if len(others) > 1 else ''} {listed} agree{'' if len(others) > 1 else 's'} with "
        "it: either all are off, or the attitude is. Ten seconds at rest decide"
    )
    action = "Log ten seconds at rest, motors off; then calibrate the gyroscope, or look at the compass."
    return dataclasses.replace(one, verdict=HealthVerdict.SUSPICIOUS, text=text, action=action)


def _against_others(found: Mapping[int, Channel], own: Mapping[int, HealthFinding]) -> Iterator[HealthFinding]:
    """Findings on every unit alone, and on every unit against the others.

    The own check of each unit, or a third unit, decides which of two is wrong.
    """
    apart: dict[tuple[int, int], tuple[float, float, HealthVerdict]] = {}
    for a, b in combinations(found, 2):
        windows = motion.difference(found[a], found[b])
        if windows.enough:
            value, sd = float(np.linalg.norm(windows.median)), float(np.linalg.norm(windows.sd))
            apart[a, b] = value, sd, judged_value(value, sd, _APART[found[a].sensor])
    for instance, channel in found.items():
        pairs = {sum(pair) - instance: judged for pair, judged in apart.items() if instance in pair}
        yield _doubted(own[instance], [other for other, one in pairs.items() if one[2] == HealthVerdict.OK])
        if pairs:
            yield _of_pairs(channel, pairs, own)


def _of_pairs(
    channel: Channel, pairs: Mapping[int, tuple[float, float, HealthVerdict]], own: Mapping[int, HealthFinding]
) -> HealthFinding:
    """Finding on one unit against the others; `pairs` are keyed by the other's instance."""
    limit, instance = _APART[channel.sensor], channel.instance
    agreeing = [other for other, (_, _, verdict) in pairs.items() if verdict == HealthVerdict.OK]
    if agreeing:
        text = f"agrees with unit {', '.join(str(other + 1) for other in agreeing)}"
        return _finding("units", channel, HealthVerdict.OK, text, Compared(None, None, limit))
    other, (value, sd, verdict) = max(pairs.items(), key=lambda pair: pair[1][0])
    factor, unit = (1.0, "m/s2") if channel.sensor == Sensor.ACCEL else (float(np.degrees(1.0)), "deg/s")
    text = f"differs from unit {other + 1} by {factor * value:.2f} ± {shown_sd(factor * sd)} {unit}"
    if verdict == HealthVerdict.CANNOT_SAY:
        return _finding("units", channel, verdict, text, Compared(value, sd, limit))
    if own[instance].verdict == HealthVerdict.OK and (own[other].verdict in BAD or _clearly(own[other], own[instance])):
        return _finding(
            "units",
            channel,
            HealthVerdict.OK,
            f"{text}; by its own check unit {other + 1} is off",
            Compared(value, sd, limit),
        )
    if own[instance].verdict == HealthVerdict.OK and _clearly(own[instance], own[other]):
        text = f"{text}; by their own checks unit {other + 1} is the better one"
    elif len(pairs) == 1 and own[instance].verdict in (HealthVerdict.OK, HealthVerdict.CANNOT_SAY):
        text, verdict = f"{text}; which of them is off, this comparison cannot say", HealthVerdict.SUSPICIOUS
    return _finding("units", channel, verdict, text, Compared(value, sd, limit))


def _clearly(one: HealthFinding, other: HealthFinding) -> bool:
    """Whether the error of `one` clearly exceeds that of `other`, which is in order."""
    if one.value is None or other.value is None or other.verdict != HealthVerdict.OK:
        return False
    return one.value > _CLEARLY * other.value + 2.0 * float(np.hypot(one.sd or 0.0, other.sd or 0.0))


def _finding(check: str, channel: Channel, verdict: HealthVerdict, text: str, measured: Compared) -> HealthFinding:
    action = _CALIBRATE[channel.sensor] if verdict in BAD else ""
    if verdict == HealthVerdict.FAULTY:
        action += " Do not fly with it. If it comes back, replace the sensor."
    value, sd, limit = measured.value, measured.sd, measured.limit
    return HealthFinding(check, channel.sensor, channel.instance, verdict, text, action, value, sd, limit)


def _unknown(check: str, sensor: Sensor, instance: int, text: str, action: str) -> HealthFinding:
    return HealthFinding(check, sensor, instance, HealthVerdict.CANNOT_SAY, text, action)
