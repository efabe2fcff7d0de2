"""Compasses at rest: strength, dip and heading of the field against the magnetic model, the others and the vehicle.

A compass whose field has the wrong strength is disturbed; what its direction is then says nothing more, so the
direction is judged of the others only.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.earth import EarthField
from mavcal.calib.preflight import limits
from mavcal.calib.preflight.check import Check, CheckId, Measure, Verdict, judged, unknown
from mavcal.calib.preflight.rest import Mean, looked

Array = NDArray[np.float64]

_MAGNET = "Move the vehicle away from iron, magnets and cars and check again; if it persists, calibrate the compass."
_MOUNT = "Look whether the mast or the mount of the compass is bent or turned; then calibrate the compass."
_LEVEL_NOSE = math.cos(math.radians(60.0))
"""Nose within 60 deg of the horizon: beyond, it has no heading."""


@dataclass(frozen=True, eq=False)
class Upright:
    """What the other sensors say of the vehicle's attitude."""

    down: Array
    """Unit vector in the body frame, by the accelerometers."""
    north: Array | None
    """Where the vehicle itself has true north, a unit vector in the body frame; None: it did not say."""
    heading: float | None
    """True heading that the operator knows, rad."""


def compass_field(compasses: Mapping[int, Mean], silent: tuple[str, ...], field: EarthField | None) -> Check:
    """Strength of the field."""
    if not compasses:
        why = f"No compass could be seen: {'; '.join(silent)}." if silent else "No compass was heard."
        return unknown(CheckId.COMPASS_FIELD, why, "Look at the compass, or fly without one on purpose.")
    measures = [_strength(i, mean, field) for i, mean in sorted(compasses.items())]
    notes = (*looked(compasses, "compass"), *silent)
    if field is None:
        worst = judged(CheckId.COMPASS_FIELD, measures, good="", remedy=_MAGNET, notes=notes)
        if worst.verdict == Verdict.FAIL:
            return worst
        why = "The strength is possible on Earth, but where the vehicle is was not heard, so it cannot be compared."
        remedy = "Wait until the vehicle knows its position, then check again."
        return unknown(CheckId.COMPASS_FIELD, why, remedy, worst.evidence)
    good = f"The field has the strength of the model, {field.norm:.1f} uT ({field.model})."
    return judged(CheckId.COMPASS_FIELD, measures, good=good, remedy=_MAGNET, notes=notes)


def disturbed(compasses: Mapping[int, Mean], field: EarthField | None) -> frozenset[int]:
    """The compasses whose strength surely is wrong."""
    return frozenset(i for i, mean in compasses.items() if _strength(i, mean, field).verdict == Verdict.FAIL)


def _strength(i: int, mean: Mean, field: EarthField | None) -> Measure:
    limit = limits.COMPASS_FIELD
    if field is None:
        off = max(limits.WEAKEST_FIELD - mean.norm, mean.norm - limits.STRONGEST_FIELD, 0.0)
        name, of_model = f"strength of compass {i + 1} from any on Earth", 0.0
    else:
        off = abs(mean.norm - field.norm)
        name, of_model = f"strength of compass {i + 1} ({mean.norm:.1f} uT) from the model", field.norm_sd
    sd = math.hypot(mean.norm_sd, of_model, limits.SURROUNDINGS_SD)
    return Measure(name, off, sd, limit.value, limit.unit)


def compass_direction(
    compasses: Mapping[int, Mean], upright: Upright | None, field: EarthField | None, motion: str | None
) -> Check:
    """Dip against the model; heading between compasses, against the vehicle's own and a known one."""
    of = CheckId.COMPASS_DIRECTION
    if not compasses:
        return unknown(of, "No compass could be seen.", "Look at the compass, or fly without one on purpose.")
    if upright is None or motion is not None:
        why = motion or "no accelerometer shows where down is"
        return unknown(of, f"Dip and heading cannot be seen: {why}.", "Put the vehicle down and check again.")
    left_out = disturbed(compasses, field)
    judgeable = {i: mean for i, mean in compasses.items() if i not in left_out}
    notes = [*looked(compasses, "compass")]
    notes += [f"compass {i + 1} is left out: its strength is wrong already" for i in sorted(left_out)]
    measures: list[Measure] = []
    if field is not None:
        measures += [_dip(i, mean, upright, field) for i, mean in sorted(judgeable.items())]
    else:
        notes.append("dip is not compared: where the vehicle is was not heard")
    for (i, one), (k, other) in itertools.combinations(sorted(judgeable.items()), 2):
        measures.append(_between(i, one, k, other, upright))
    if field is not None and upright.north is not None:
        for i, mean in sorted(judgeable.items()):
            measures.append(
                _against(f"heading of compass {i + 1} from the vehicle's own", mean, upright.north, field, upright)
            )
    known = None if field is None else _known_north(upright)
    if field is not None and known is not None:
        for i, mean in sorted(judgeable.items()):
            measures.append(_against(f"heading of compass {i + 1} from the one given", mean, known, field, upright))
    elif upright.heading is None:
        notes.append("the true heading is not known: give --heading to check what all compasses may share")
    if not measures:
        why = "Nothing is left to compare with." if judgeable else "Every compass is left out."
        said = notes[len(compasses) :]
        return unknown(of, f"{why} {'; '.join(said)}.", _MAGNET, notes)
    in_what = "dip and heading" if field is not None else "heading"
    return judged(of, measures, good=f"All compasses agree in {in_what}.", remedy=_MOUNT, notes=notes)


def _dip(i: int, mean: Mean, upright: Upright, field: EarthField) -> Measure:
    limit = limits.COMPASS_ANGLE
    dip = math.asin(float(np.clip(mean.value @ upright.down / mean.norm, -1.0, 1.0)))
    noise = math.hypot(float(np.linalg.norm(mean.sd)), limits.SURROUNDINGS_SD, field.norm_sd) / mean.norm
    off = abs(dip - field.inclination)
    sd = math.hypot(noise, limits.TILT_SD)
    name = f"dip of compass {i + 1} ({math.degrees(dip):.1f} deg) from the model"
    return Measure(name, math.degrees(off), math.degrees(sd), limit.value, limit.unit)


def _between(i: int, one: Mean, k: int, other: Mean, upright: Upright) -> Measure:
    """The tilt is the same for both, so its error counts only by their difference, which is small."""
    limit = limits.COMPASS_ANGLE
    off = abs(_turn(upright.down, one.value, other.value))
    sd = math.hypot(_heading_sd(one, upright, tilt=0.0), _heading_sd(other, upright, tilt=0.0))
    name = f"heading between compasses {i + 1} and {k + 1}"
    return Measure(name, math.degrees(off), math.degrees(sd), limit.value, limit.unit)


def _against(name: str, mean: Mean, north: Array, field: EarthField, upright: Upright) -> Measure:
    limit = limits.COMPASS_ANGLE
    magnetic_north = _rotated(north, upright.down, field.declination)
    off = abs(_turn(upright.down, magnetic_north, mean.value))
    sd = _heading_sd(mean, upright, tilt=limits.TILT_SD)
    return Measure(name, math.degrees(off), math.degrees(sd), limit.value, limit.unit)


def _known_north(upright: Upright) -> Array | None:
    """True north in the body frame, from the known heading of the nose; None: there is no such."""
    nose = _level(upright.down, np.array([1.0, 0.0, 0.0]))
    if upright.heading is None or np.linalg.norm(nose) < _LEVEL_NOSE:
        return None
    return _rotated(nose / np.linalg.norm(nose), upright.down, -upright.heading)


def _heading_sd(mean: Mean, upright: Upright, tilt: float) -> float:
    """Standard deviation of a compass's heading, rad: noise and surroundings over its level part, tilt times dip."""
    level = max(float(np.linalg.norm(_level(upright.down, mean.value))), 1e-6)
    vertical = abs(float(mean.value @ upright.down))
    across = math.hypot(float(mean.sd.max()), limits.SURROUNDINGS_SD)
    return min(math.hypot(across, tilt * vertical) / level, math.pi)


def _level(down: Array, vector: Array) -> Array:
    return np.asarray(vector - (vector @ down) * down)


def _turn(down: Array, start: Array, end: Array) -> float:
    """Angle from `start` to `end` about down, clockwise seen from above, rad."""
    a, b = _level(down, start), _level(down, end)
    return math.atan2(float(down @ np.cross(a, b)), float(a @ b))


def _rotated(vector: Array, axis: Array, angle: float) -> Array:
    """`vector`, which lies across `axis`, turned by `angle` about it."""
    return np.asarray(math.cos(angle) * vector + math.sin(angle) * np.cross(axis, vector))
