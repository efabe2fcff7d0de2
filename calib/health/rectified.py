"""Vibration rectification: the mean of an accelerometer shifts with vibration, beyond any calibration.

Told by the sensor alone: the length of its force in calm seconds against that in shaken ones. A calibration error is in
both; a shift that comes with the shaking is the mount's. Manoeuvres of a second average out over many.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mavcal.calib import STANDARD_GRAVITY
from mavcal.calib.flight.item import JudgedItem
from mavcal.calib.health import limits, motion
from mavcal.calib.health.channels import judged_channel
from mavcal.calib.health.finding import BAD, HealthFinding, HealthVerdict, judged_value, shown_sd
from mavcal.calib.recording import Recording, Sensor

Array = NDArray[np.float64]

DAMP: Final = "Damp the mount, and balance the propellers."
_WINDOW_S: Final = 1.0
_LEAST: Final = 8
"""Samples of a window."""
_CALM: Final = 1.5
_SHAKEN: Final = 2.0
"""m/s2 rms of all axes: below it is calm, and above it is shaken."""
_CALM_WINDOWS: Final = 3
_SHAKEN_WINDOWS: Final = 10
_STRONG: Final = 0.5 * STANDARD_GRAVITY
"""m/s2 rms that may shift any mean, as far as a log without calm seconds can tell."""
_SHIFTED: Final = 0.5
"""m/s2: twice of what calls a calm sensor suspicious."""
_CLIPS: Final = 0.005
"""Part of the samples at the end of the range from which on they shift the mean."""


@dataclass(frozen=True)
class Rectified:
    """The mean length of the force of one accelerometer, calm and shaken, m/s2."""

    instance: int
    calm: float | None
    """None: it was never calm."""
    calm_sd: float
    shaken: float
    rms: float
    """Root mean square of the vibration in shaken seconds, all axes."""

    @property
    def finding(self) -> HealthFinding:
        """What it says of the mount."""
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
        good = motion.usable(channel)
        one = _of(instance, *_windows(good.t, good.values), least=_least_shift(shaking, instance, len(good)))
        if one is not None:
            found[instance] = one
    return found


def _least_shift(shaking: Sequence[JudgedItem], instance: int, count: int) -> float:
    """m/s2 by which a mean has to move: samples at the end of the range shift it in any case."""
    subject = f"accel {instance + 1}"
    at_end = [item.value or 0.0 for item in shaking if (item.name, item.subject) == ("clipping", subject)]
    return limits.FORCE.suspicious if max(at_end, default=0.0) > _CLIPS * count else _SHIFTED


def explained(findings: Sequence[HealthFinding], shifted: Mapping[int, Rectified]) -> Iterator[HealthFinding]:
    """`findings` with those that accuse a calibration of what the vibration did judged by the calm seconds."""
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
    """At worst suspicious: seconds that are calm enough to count may be shifted a little as well."""
    off = abs(calm - STANDARD_GRAVITY)
    verdict = judged_value(off, one.calm_sd, dataclasses.replace(limits.FORCE, faulty=None))
    text = f"reads {calm:.2f} ± {shown_sd(one.calm_sd)} m/s2 in calm seconds; gravity is {STANDARD_GRAVITY:.2f}"
    action = finding.action.partition(" Do not fly")[0] if verdict != HealthVerdict.OK else ""
    return dataclasses.replace(finding, verdict=verdict, text=text, action=action, value=off, sd=one.calm_sd)


def _windows(t: Array, values: Array) -> tuple[Array, Array]:
    """Length of the mean force (M,) and rms of the vibration (M,), m/s2, in every second with samples enough."""
    if len(t) < _LEAST:
        return np.zeros(0), np.zeros(0)
    second = np.floor((t - t[0]) / _WINDOW_S).astype(np.intp)
    row = np.unique(second, return_inverse=True)[1]
    count = np.bincount(row)
    used = count >= _LEAST
    means = np.array([np.bincount(row, column) / count for column in values.T])
    squares = np.array([np.bincount(row, column**2) / count for column in values.T])
    vibration = np.sqrt(np.maximum(squares - means**2, 0.0).sum(axis=0))
    return np.linalg.norm(means, axis=0)[used], vibration[used]


def _of(instance: int, force: Array, vibration: Array, least: float = _SHIFTED) -> Rectified | None:
    """None: the mean does not move with the vibration, or too little of either is there."""
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
