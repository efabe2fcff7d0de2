"""Vibration of the inertial units: levels and clip counts of the autopilot, and limits of the sampling."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.flight.flying import clipped_events
from mavcal.calib.flight.item import FlightVerdict, JudgedItem
from mavcal.calib.flight.rest import TimeSpan
from mavcal.calib.health import limits, motion
from mavcal.calib.health.finding import HealthFinding, HealthVerdict, judged_value
from mavcal.calib.health.limits import HealthLimit
from mavcal.calib.health.rectified import DAMP
from mavcal.calib.recording import Channel, Recording, Sensor

Array = NDArray[np.float64]

_HELD_S: Final = 5.0
"""A level counts as vibration where it was reached for so long in all; shorter ones are blows."""
_LEAST: Final = 5
"""Levels that a vibration is told from."""
_BLOW_S: Final = 5.0
"""Clips that lie within so many seconds, in a flight that is longer, are a blow."""
_NEAR: Final = 0.9
"""Share of half the sampling rate: a line beyond it may be a faster one, folded back."""
_WIDE_HZ: Final = 200.0
"""Half a sampling rate beyond which the rotors of most vehicles do not turn, blades included."""
_SEEN: Final = {
    FlightVerdict.PASS: HealthVerdict.OK,
    FlightVerdict.NOT_TESTABLE: HealthVerdict.CANNOT_SAY,
    FlightVerdict.WARN: HealthVerdict.SUSPICIOUS,
    FlightVerdict.FAIL: HealthVerdict.FAULTY,
}


def vibration_findings(
    recording: Recording, flown: Sequence[TimeSpan], shaking: Sequence[JudgedItem], how_to_log: str
) -> Iterator[HealthFinding]:
    """Vibration, clipping and aliasing of every accelerometer, and the vibration of gyroscopes.

    `flown` are the spans with the motors on, and `shaking` is what :func:`calib.flight.flying.shaking_items` found
    there. `how_to_log` is the action that has every sample of the sensor logged.
    """
    items = {(item.name, _instance(item)): item for item in shaking}
    for instance in recording.instances(Sensor.ACCEL):
        seen = items["vibration", instance]
        level = _level(recording, instance, flown)
        if level is not None:
            yield level
        if level is None or seen.verdict in (FlightVerdict.WARN, FlightVerdict.FAIL):
            yield _of_item(seen, limits.VIBRATION, DAMP)
        yield _clipping(recording, items["clipping", instance])
        if seen.numbers:
            yield _aliasing(recording, instance, seen.numbers, how_to_log)
    for instance in recording.instances(Sensor.GYRO):
        yield from _of_gyro(recording, instance, flown)


def _instance(item: JudgedItem) -> int:
    return int(item.subject.rpartition(" ")[2]) - 1


def _of_item(item: JudgedItem, limit: HealthLimit, action: str) -> HealthFinding:
    """A check that the sanity of a flight makes already."""
    verdict = _SEEN[item.verdict]
    shown = "" if verdict in (HealthVerdict.OK, HealthVerdict.CANNOT_SAY) else action
    text = f"vibrates by {item.text}" if item.name == "vibration" and item.value is not None else item.text
    limit = limit if item.limit is None else HealthLimit.of(item.limit)
    return HealthFinding(item.name, Sensor.ACCEL, _instance(item), verdict, text, shown, item.value, item.sd, limit)


def _in_flight(channel: Channel, flown: Sequence[TimeSpan]) -> Channel:
    """The samples with the motors on; all of them where nothing says when they were."""
    if not flown:
        return motion.usable(channel)
    inside = np.zeros(len(channel), dtype=np.bool_)
    for span in flown:
        inside |= (channel.t >= span.start) & (channel.t <= span.end)
    return motion.usable(channel.take(inside))


def _held(t: Array, level: Array) -> float:
    """The level that was reached for `_HELD_S` in all, or throughout what is shorter."""
    step = np.diff(t, prepend=t[0] - (t[1] - t[0]))
    step = np.minimum(step, 5.0 * float(np.median(step)))
    order = np.argsort(-level)
    reached = np.cumsum(step[order])
    return float(level[order][min(int(np.searchsorted(reached, min(_HELD_S, reached[-1]))), len(level) - 1)])


def _level(recording: Recording, instance: int, flown: Sequence[TimeSpan]) -> HealthFinding | None:
    """The autopilot's own level; None: it was not logged in flight."""
    logged = next(iter(recording.find(Sensor.VIBRATION, instance)), None)
    channel = None if logged is None else _in_flight(logged, flown)
    if channel is None or len(channel) < _LEAST:
        return None
    single = channel.values.shape[1] == 1
    limit = limits.PX4_VIBRATION if single else limits.VIBRATION
    helds = [_held(channel.t, column) for column in channel.values.T]
    axis = int(np.argmax(helds))
    held, column = helds[axis], channel.values[:, axis]
    verdict = judged_value(held, 0.0, limit)
    peak = int(np.argmax(column))
    where = "" if single else f" along {'xyz'[axis]}"
    text = f"vibrates by {held:.3g} m/s2 or more{where} for {_HELD_S:.0f} s in all"
    text += f", at most {column[peak]:.3g} m/s2 at {channel.t[peak]:.1f} s"
    start = end = float(channel.t[peak])
    if verdict != HealthVerdict.OK:
        above = channel.t[column > limit.suspicious]
        start, end = float(above[0]), float(above[-1])
        text += f", and more than {limit.suspicious:.3g} between {start:.0f} and {end:.0f} s"
    elif column[peak] > limit.suspicious:
        text += ": a blow, no vibration"
    action = "" if verdict == HealthVerdict.OK else DAMP
    return HealthFinding(
        *("vibration", Sensor.ACCEL, instance, verdict, text, action), held, None, limit, start=start, end=end
    )


def _clipping(recording: Recording, item: JudgedItem) -> HealthFinding:
    """Counts with their time; those of a moment are a blow, whose cause is not the mount."""
    instance = _instance(item)
    made = _of_item(item, limits.CLIPS, DAMP)
    odd = [(event.t, event.odd) for event in clipped_events(recording, instance) if event.odd is not None]
    counted = [(t, found) for t, found in odd if found.count and found.until is not None]
    if not counted:
        return made
    start = min(t for t, _ in counted)
    end = max(found.until for _, found in counted if found.until is not None)
    text = f"{made.text}, at {start:.1f} s" if end - start < 0.05 else f"{made.text}, from {start:.1f} to {end:.1f} s"
    action = made.action
    first, last = recording.span
    if end - start <= _BLOW_S < last - first:
        text += ": a blow rather than vibration"
        action = f"Look for what struck the vehicle at {start:.0f} s, and check the mount of the flight controller."
    return HealthFinding(
        *("clipping", Sensor.ACCEL, instance, made.verdict, text, action, made.value, made.sd, limits.CLIPS),
        start=start,
        end=end,
    )


def _aliasing(recording: Recording, instance: int, numbers: Mapping[str, object], how_to_log: str) -> HealthFinding:
    """A line near half the sampling rate, or what a slow stream cannot show."""
    half, tones, source = float(str(numbers["nyquist_hz"])), numbers["tones"], numbers["source"]
    found = [t for t in tones if t["hz"] >= _NEAR * half] if isinstance(tones, list) else []
    line = max(found, key=lambda tone: float(tone["amplitude"]), default=None)
    if numbers["filtered"] or half < _WIDE_HZ:
        why = "is low-passed and " if numbers["filtered"] else ""
        text = f"{source} {why}shows nothing above {half:.0f} Hz: what shakes faster is missing or at a false frequency"
        rotors = next(iter(recording.find(Sensor.ROTOR_SPEED)), None)
        if rotors is not None and np.isfinite(rotors.values).any() and float(np.nanmax(rotors.values)) > half:
            text += f"; the rotors turn at up to {float(np.nanmax(rotors.values)):.0f} Hz"
        return HealthFinding("aliasing", Sensor.ACCEL, instance, HealthVerdict.CANNOT_SAY, text, how_to_log)
    if line is None:
        text = f"no line between {_NEAR * half:.0f} Hz and half the sampling rate, {half:.0f} Hz"
        return HealthFinding(
            *("aliasing", Sensor.ACCEL, instance, HealthVerdict.OK, text), value=0.0, limit=limits.NEAR_NYQUIST
        )
    size = float(line["amplitude"])
    verdict = judged_value(size, 0.0, limits.NEAR_NYQUIST)
    text = f"has a line of {size:.2g} m/s2 at {line['hz']:.0f} Hz, near half the sampling rate of {2.0 * half:.0f} Hz"
    action = ""
    if verdict != HealthVerdict.OK:
        text += ": it may be a faster vibration, folded back"
        action = "Damp the mount; sample the sensor faster to see the true frequency."
    return HealthFinding(
        *("aliasing", Sensor.ACCEL, instance, verdict, text, action), value=size, limit=limits.NEAR_NYQUIST
    )


def _of_gyro(recording: Recording, instance: int, flown: Sequence[TimeSpan]) -> Iterator[HealthFinding]:
    """The vibration level of PX4, without a stated limit: for comparison between flights."""
    logged = next(iter(recording.find(Sensor.GYRO_VIBRATION, instance)), None)
    channel = None if logged is None else _in_flight(logged, flown)
    if channel is None or len(channel) < _LEAST:
        return
    held = _held(channel.t, channel.values[:, 0])
    text = f"vibrates by {held:.2g} rad/s or more for {_HELD_S:.0f} s in all; nobody states a limit"
    yield HealthFinding("vibration", Sensor.GYRO, instance, HealthVerdict.CANNOT_SAY, text, value=held)
