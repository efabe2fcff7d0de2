"""Vibration of the inertial units: levels and clip counts, limits of the sampling, and rectification.

Rectification shifts the mean of an accelerometer, beyond any calibration. The sensor alone shows it: the length of its
force in calm seconds against that in shaken ones. A calibration error is in both; a shift that comes with the shaking
is due to the mount. Manoeuvres average out over many seconds.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from mavcal.calib import STANDARD_GRAVITY
from mavcal.calib.flight.flying import clipped_events, usable
from mavcal.calib.flight.item import FlightVerdict, JudgedItem
from mavcal.calib.flight.rest import TimeSpan
from mavcal.calib.health import limits
from mavcal.calib.health.channels import judged_channel
from mavcal.calib.health.finding import BAD, HealthFinding, HealthVerdict, judged_value, shown_sd
from mavcal.calib.health.limits import HealthLimit
from mavcal.calib.recording import Array, Channel, Recording, Sensor

DAMP: Final = "Damp the mount, and balance the propellers."
_WINDOW_S: Final = 1.0
_LEAST_SAMPLES: Final = 8
"""Least number of samples in a window."""
_CALM: Final = 1.5
_SHAKEN: Final = 2.0
"""Vibration, m/s2 rms over all axes: calm below `_CALM`, shaken above this."""
_CALM_WINDOWS: Final = 3
_SHAKEN_WINDOWS: Final = 10
_STRONG: Final = 0.5 * STANDARD_GRAVITY
"""Vibration, m/s2 rms, that may shift any mean; for logs without calm seconds."""
_SHIFTED: Final = 0.5
"""Shift of the mean, m/s2: twice the limit that makes a calm sensor suspicious."""
_CLIPS: Final = 0.005
"""Fraction of clipped samples above which they shift the mean."""
_HELD_S: Final = 5.0
"""Total time, s, for which a level must be reached to count as vibration; shorter ones are impacts."""
_LEAST: Final = 5
"""Least number of logged levels to judge vibration."""
_BLOW_S: Final = 5.0
"""Clipping confined to this time, s, of a longer flight is an impact."""
_NEAR: Final = 0.9
"""Fraction of the Nyquist frequency above which a line may be an alias of a faster one."""
_WIDE_HZ: Final = 200.0
"""Nyquist frequency, Hz, above the rotor and blade frequencies of most vehicles."""
_SEEN: Final = {
    FlightVerdict.PASS: HealthVerdict.OK,
    FlightVerdict.NOT_TESTABLE: HealthVerdict.CANNOT_SAY,
    FlightVerdict.WARN: HealthVerdict.SUSPICIOUS,
    FlightVerdict.FAIL: HealthVerdict.FAULTY,
}


@dataclass(frozen=True)
class Rectified:
    """Mean length of one accelerometer's force, m/s2, in calm and in shaken seconds."""

    instance: int
    calm: float | None
    """Mean in calm seconds; None: there were none."""
    calm_sd: float
    shaken: float
    rms: float
    """Root mean square of the vibration in shaken seconds, all axes."""

    @property
    def finding(self) -> HealthFinding:
        """Finding on the mount."""
        if self.calm is None:
            text = f"reads {self.shaken:.2f} m/s2 while it vibrates by {self.rms:.1f} m/s2 rms or more"
            text += ": vibration alone may shift its mean so, and it was never calm"
        else:
            text = f"its mean moves from {self.calm:.2f} m/s2 in calm seconds to {self.shaken:.2f} m/s2 where it "
            text += (
                f"vibrates by {self.rms:.1f} m/s2 rms or more: rectified or clipped vibration, no calibration cures it"
            )
        return HealthFinding(
            *("vibration", Sensor.ACCEL, self.instance, HealthVerdict.SUSPICIOUS, text, DAMP), self.rms, None
        )


def rectified(recording: Recording, shaking: Sequence[JudgedItem] = ()) -> dict[int, Rectified]:
    """The accelerometers whose mean moves with their vibration, by instance; `shaking` says which ones clip."""
    found: dict[int, Rectified] = {}
    for instance in recording.instances(Sensor.ACCEL):
        channel = judged_channel(recording, Sensor.ACCEL, instance)
        if channel is None:
            continue
        good = usable(channel)
        one = _of(instance, *_windows(good.t, good.values), least=_least_shift(shaking, instance, len(good)))
        if one is not None:
            found[instance] = one
    return found


def _least_shift(shaking: Sequence[JudgedItem], instance: int, count: int) -> float:
    """Least shift of the mean, m/s2; it is smaller with clipped samples, which shift the mean in any case."""
    subject = f"accel {instance + 1}"
    at_end = [item.value or 0.0 for item in shaking if (item.name, item.subject) == ("clipping", subject)]
    return limits.FORCE.suspicious if max(at_end, default=0.0) > _CLIPS * count else _SHIFTED


def explained(findings: Sequence[HealthFinding], shifted: Mapping[int, Rectified]) -> Iterator[HealthFinding]:
    """`findings`, where those that blame a calibration for the effect of vibration are judged by the calm seconds."""
    yield from (one.finding for one in shifted.values())
    for finding in findings:
        one = shifted.get(finding.instance) if finding.sensor == Sensor.ACCEL else None
        if one is None or finding.verdict not in BAD or finding.check not in ("gravity", "units"):
            yield finding
        elif finding.check == "units" or one.calm is None:
            text = f"{finding.text}; while it vibrates so, that says nothing of its calibration"
            yield dataclasses.replace(finding, verdict=HealthVerdict.CANNOT_SAY, text=text, action="")
        else:
            yield _by_calm(finding, one, one.calm)


def _by_calm(finding: HealthFinding, one: Rectified, calm: float) -> HealthFinding:
    """The finding by the calm seconds, at worst suspicious: these may be slightly shifted too."""
    off = abs(calm - STANDARD_GRAVITY)
    verdict = judged_value(off, one.calm_sd, dataclasses.replace(limits.FORCE, faulty=None))
    text = f"reads {calm:.2f} ± {shown_sd(one.calm_sd)} m/s2 in calm seconds; gravity is {STANDARD_GRAVITY:.2f}"
    action = finding.action.partition(" Do not fly")[0] if verdict != HealthVerdict.OK else ""
    return dataclasses.replace(finding, verdict=verdict, text=text, action=action, value=off, sd=one.calm_sd)


def _windows(t: Array, values: Array) -> tuple[Array, Array]:
    """Length of the mean force (M,) and rms vibration (M,), m/s2, of every second with enough samples."""
    if len(t) < _LEAST_SAMPLES:
        return np.zeros(0), np.zeros(0)
    second = np.floor((t - t[0]) / _WINDOW_S).astype(np.intp)
    row = np.unique(second, return_inverse=True)[1]
    count = np.bincount(row)
    used = count >= _LEAST_SAMPLES
    means = np.array([np.bincount(row, column) / count for column in values.T])
    squares = np.array([np.bincount(row, column**2) / count for column in values.T])
    vibration = np.sqrt(np.maximum(squares - means**2, 0.0).sum(axis=0))
    return np.linalg.norm(means, axis=0)[used], vibration[used]


def _of(instance: int, force: Array, vibration: Array, least: float = _SHIFTED) -> Rectified | None:
    """Shift of the mean force by vibration; None: no shift, or too little calm or vibration to tell."""
    shaken, calm = force[vibration > _SHAKEN], force[vibration < _CALM]
    if len(shaken) < _SHAKEN_WINDOWS:
        return None
    level, rms = float(np.median(shaken)), float(np.median(vibration[vibration > _SHAKEN]))
    sd = _sd(shaken)
    if len(calm) < _CALM_WINDOWS:
        off = abs(level - STANDARD_GRAVITY) - 2.0 * sd
        return Rectified(instance, None, 0.0, level, rms) if rms > _STRONG and off > least else None
    usual, usual_sd = float(np.median(calm)), float(np.hypot(_sd(calm), 0.02))
    moved = abs(level - usual) - 2.0 * float(np.hypot(sd, usual_sd))
    return Rectified(instance, usual, usual_sd, level, rms) if moved > least else None


def _sd(values: Array) -> float:
    """Standard error of the median, from the median deviation."""
    return float(1.2533 * 1.4826 * np.median(np.abs(values - np.median(values))) / np.sqrt(len(values)))


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
            yield _of_item(seen, limits.VIBRATION)
        yield _clipping(recording, items["clipping", instance])
        if seen.numbers:
            yield _aliasing(recording, instance, seen.numbers, how_to_log)
    for instance in recording.instances(Sensor.GYRO):
        yield from _of_gyro(recording, instance, flown)


def _instance(item: JudgedItem) -> int:
    return int(item.subject.rpartition(" ")[2]) - 1


def _of_item(item: JudgedItem, limit: HealthLimit) -> HealthFinding:
    """Finding from an item of the flight checks."""
    verdict = _SEEN[item.verdict]
    shown = "" if verdict in (HealthVerdict.OK, HealthVerdict.CANNOT_SAY) else DAMP
    text = f"vibrates by {item.text}" if item.name == "vibration" and item.value is not None else item.text
    limit = limit if item.limit is None else HealthLimit.of(item.limit)
    return HealthFinding(item.name, Sensor.ACCEL, _instance(item), verdict, text, shown, item.value, item.sd, limit)


def _in_flight(channel: Channel, flown: Sequence[TimeSpan]) -> Channel:
    """The samples with the motors on; all of them where nothing says when they were."""
    if not flown:
        return usable(channel)
    inside = np.zeros(len(channel), dtype=np.bool_)
    for span in flown:
        inside |= (channel.t >= span.start) & (channel.t <= span.end)
    return usable(channel.take(inside))


def _held(t: Array, level: Array) -> float:
    """The level that was reached for `_HELD_S` in total, or throughout a shorter series."""
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
    """Clip counts with their time; clipping of a moment is an impact, which is not the mount's fault."""
    instance = _instance(item)
    made = _of_item(item, limits.CLIPS)
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
    """Finding on a line near the Nyquist frequency, or on what a slow stream cannot show."""
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
