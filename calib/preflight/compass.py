"""Checks compasses at rest: strength, dip and heading against the magnetic model, the others and the vehicle.

A compass whose field has the wrong strength is disturbed and its direction meaningless, so the direction is judged for
the others only. If headings disagree, a third reference identifies the faulty compass, or all candidates are named.
References are the majority of three compasses, the dip of the field, a heading from the operator, and the vehicle's own
heading. The last can only contradict the compass that it follows, never confirm it. The motor compensation is judged by
its size at full power.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np

from mavcal.calib.earth import EarthField, decimal_year, earth_field
from mavcal.calib.errors import FirmwareError, InvalidInputError
from mavcal.calib.firmware import calibration_names
from mavcal.calib.firmware.names import MOTOR, Role
from mavcal.calib.firmware.plan import Value
from mavcal.calib.preflight import limits
from mavcal.calib.preflight.check import Check, CheckId, Measure, Snapshot, Subject, Verdict, counted, judged, unknown
from mavcal.calib.preflight.rest import Mean, evidence_lines
from mavcal.calib.recording import Array, Recording, Sensor

_VEHICLE = "the vehicle's own heading"
_GIVE = "Check again and give the true heading of the nose: it tells which of them is off."
_DECLINED = "The declination that is set by hand explains it."

_MAGNET = "Move the vehicle away from iron, magnets and cars and check again; if it persists, calibrate the compass."
_MOUNT = "Look whether the mast or the mount of the compass is bent or turned; then calibrate the compass."
_PLACE = "Look whether the vehicle's position is right; if it is, move the vehicle ten metres away and check again."
_LEVEL_NOSE = math.cos(math.radians(60.0))
"""Nose within 60 deg of the horizon: beyond, it has no heading."""
_UT = {"ardupilot": 0.1, "px4": 100.0}
_PX4_PER_KA = 1e-3
_BY_CURRENT = {"ardupilot": (2,), "px4": (2, 3)}
_TYPES = {"ardupilot": "COMPASS_MOTCT", "px4": "CAL_MAG_COMP_TYP"}
_PER_MOTOR = 3
_TYPICAL_FIELD = 50.0
"""Strength of the field, uT, where the place is not known."""
_REMEDY = "Measure the motor compensation again, or switch it off."


@dataclass(frozen=True)
class Headings:
    """All measures of the field's direction, by compass."""

    dips: Mapping[int, Measure]
    pairs: Mapping[tuple[int, int], Measure]
    own: Mapping[int, Measure]
    given: Mapping[int, Measure]
    declination: Measure | None


def blamed(found: Headings, *, followed: int) -> list[Measure]:
    """All measures with their suspects; `followed` is the compass that the vehicle's heading follows."""
    together = not any(map(_off, found.pairs.values()))
    measures = [_dip_witness(i, m, found, together=together) for i, m in found.dips.items()]
    measures += [_pair(i, k, m, found, followed) for (i, k), m in found.pairs.items()]
    measures += [_own(i, m, found, followed, together=together) for i, m in found.own.items()]
    measures += [_by_stated_heading(i, m, found, together=together) for i, m in found.given.items()]
    return measures + ([] if found.declination is None else [found.declination])


def _off(measure: Measure) -> bool:
    return measure.verdict in (Verdict.FAIL, Verdict.WARN)


def _dip_witness(i: int, measure: Measure, found: Headings, *, together: bool) -> Measure:
    count = len(found.dips)
    if count > 1 and together and all(map(_off, found.dips.values())):
        explanation = (
            f"All {count} compasses agree with each other: the position is wrong, or iron is near the whole vehicle."
        )
        remedy = "Look whether the vehicle's position is right; if it is, move it ten metres away and check again."
        return _with(measure, ("position", "surroundings"), explanation, remedy)
    if count == 1:
        return _with(measure, (_compass(i), "position"), "No second compass tells whether the position is wrong.")
    return _with(measure, (_compass(i),))


def _pair(i: int, k: int, measure: Measure, found: Headings, followed: int) -> Measure:
    odd = _outlier_of_pair(i, k, found)
    if odd is not None:
        return _with(measure, (_compass(odd),), f"The other compasses agree: it is compass {odd + 1}.")
    for what, witness in (("its dip is not the model's", found.dips), ("by the heading given", found.given)):
        bad = [n for n in (i, k) if n in witness and _off(witness[n])]
        if len(bad) == 1:
            return _with(measure, (_compass(bad[0]),), f"Compass {bad[0] + 1} is the one that is off: {what}.")
    other = k if followed == i else i
    if followed in (i, k) and found.own and _off(found.own[followed]) and not _off(found.own[other]):
        explanation = f"Compass {followed + 1} is the one that is off: the vehicle's own heading agrees with compass "
        return _with(measure, (_compass(followed),), f"{explanation}{other + 1}.")
    explanation = "Nothing that was looked at tells which of both is off"
    if found.own:
        explanation += f"; the vehicle's own heading follows compass {followed + 1}, and is no witness for it"
    remedy = f"{_GIVE} Else look at both mounts."
    return _with(measure, (_compass(i), _compass(k)), f"{explanation}.", remedy)


def _own(i: int, measure: Measure, found: Headings, followed: int, *, together: bool) -> Measure:
    if found.declination is not None and _off(found.declination) and together:
        return _with(measure, ("declination",), _DECLINED, found.declination.remedy)
    if not together:
        pairs = [_pair(*key, m, found, followed) for key, m in found.pairs.items() if i in key and _off(m)]
        worst = max(pairs, key=lambda m: m.value, default=None)
        return measure if worst is None else _with(measure, worst.suspects, worst.witness, worst.remedy)
    if i in found.given:
        who = _compass(i) if _off(found.given[i]) else _VEHICLE
        return _with(measure, (who,), "The heading that was given tells.")
    if len(found.own) == 1:
        explanation = "Nothing that was looked at tells whether the compass or the vehicle's own heading is off."
        return _with(measure, (_compass(i), _VEHICLE), explanation, _OWN)
    explanation = f"All {len(found.own)} compasses agree with each other, so none of them is off by itself."
    return _with(measure, (_VEHICLE, "how the autopilot is mounted"), explanation, _OWN)


def _by_stated_heading(i: int, measure: Measure, found: Headings, *, together: bool) -> Measure:
    if len(found.given) > 1 and together and all(map(_off, found.given.values())):
        explanation = f"All {len(found.given)} compasses agree with each other."
        return _with(measure, ("what all compasses share", "the heading given"), explanation, _SHARED)
    return _with(measure, (_compass(i),))


_OWN = "Wait until the vehicle's estimate has settled, and check again; the true heading tells which is off."
_SHARED = "Look at the orientation that is set for the autopilot, and whether the heading given is a true one."


def _outlier_of_pair(i: int, k: int, found: Headings) -> int | None:
    """The one of two compasses that disagrees with all others, which agree with each other."""
    compasses = {n for pair in found.pairs for n in pair}
    if len(compasses) < 3:
        return None
    for n in (i, k):
        with_it = [m for pair, m in found.pairs.items() if n in pair]
        without = [m for pair, m in found.pairs.items() if n not in pair]
        if all(map(_off, with_it)) and not any(map(_off, without)):
            return n
    return None


def _compass(i: int) -> str:
    return f"compass {i + 1}"


def _with(measure: Measure, suspects: tuple[str, ...], witness: str = "", remedy: str = "") -> Measure:
    return dataclasses.replace(measure, suspects=suspects, witness=witness, remedy=remedy)


@dataclass(frozen=True, eq=False)
class Upright:
    """Attitude of the vehicle by the other sensors."""

    down: Array
    """Unit vector in the body frame, by the accelerometers."""
    north: Array | None
    """True north from the vehicle's own attitude, a unit vector in the body frame; None: not reported."""
    heading: float | None
    """True heading that the operator knows, rad."""


def compass_field(
    compasses: Mapping[int, Mean], silent: tuple[str, ...], field: EarthField | None, *, installed: int = 0
) -> Check:
    """Check of the field strength; `installed`: number of compasses, 0 for as many as streamed."""
    if not compasses:
        why = f"No compass could be seen: {'; '.join(silent)}." if silent else "No compass was heard."
        return unknown(CheckId.COMPASS_FIELD, why, "Look at the compass, or fly without one on purpose.")
    measures = [_strength(i, mean, field) for i, mean in sorted(compasses.items())]
    notes = (*evidence_lines(compasses, "compass"), *silent)
    if field is None:
        worst = judged(CheckId.COMPASS_FIELD, measures, good="", remedy=_MAGNET, notes=notes)
        if worst.verdict == Verdict.FAIL:
            return worst
        why = "The strength is possible on Earth, but where the vehicle is was not heard, so it cannot be compared."
        remedy = "Wait until the vehicle knows its position, then check again."
        return unknown(CheckId.COMPASS_FIELD, why, remedy, worst.evidence)
    measures = _placed(measures, compasses, field)
    fewer = f" in {counted(len(compasses), installed, '', 'compasses')}" if len(compasses) < installed else ""
    good = f"The field has the strength of the model{fewer}, {field.norm:.1f} uT ({field.model})."
    return judged(CheckId.COMPASS_FIELD, measures, good=good, remedy=_MAGNET, notes=notes)


def _placed(measures: list[Measure], compasses: Mapping[int, Mean], field: EarthField) -> list[Measure]:
    """The measures with suspects.

    A deviation common to all compasses is not a compass's fault; a deviation of one alone may be that of the place.
    """
    if not all(m.value > m.limit for m in measures):
        return measures
    strengths = [mean.norm for mean in compasses.values()]
    on_earth = min(strengths) > limits.WEAKEST_FIELD and max(strengths) < limits.STRONGEST_FIELD
    if len(measures) == 1 and on_earth:
        explanation = (
            "It is possible on Earth, but not at this position, and no second compass tells which of both is wrong."
        )
        suspects = (*measures[0].suspects, "position")
        return [dataclasses.replace(measures[0], suspects=suspects, witness=explanation, remedy=f"{_PLACE} {_MAGNET}")]
    if len(measures) == 1 or max(strengths) - min(strengths) > limits.COMPASS_FIELD.value:
        return measures
    suspects = ("position", "surroundings") if on_earth else ("surroundings",)
    explanation = f"All {len(measures)} compasses agree with each other, so none of them is off by itself: "
    explanation += (
        "either the position is wrong, or iron is near the whole vehicle." if on_earth else "iron is near them all."
    )
    remedy = _PLACE if on_earth else _MAGNET
    return [dataclasses.replace(m, suspects=suspects, witness=explanation, remedy=remedy) for m in measures]


def disturbed(compasses: Mapping[int, Mean], field: EarthField | None) -> frozenset[int]:
    """The compasses whose field strength is certainly wrong."""
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
    return Measure(name, off, sd, limit.value, limit.unit, (f"compass {i + 1}",))


def compass_direction(
    compasses: Mapping[int, Mean],
    upright: Upright | None,
    field: EarthField | None,
    motion: str | None,
    *,
    installed: int = 0,
    declination: Measure | None = None,
    followed: int = 0,
) -> Check:
    """Dip against the model; heading between compasses, against the vehicle's own and a known one.

    `installed`: how many compasses there are, 0 for as many as were heard. `declination`: the manual setting against
    the model. `followed`: the compass behind the vehicle's own heading, which therefore cannot confirm that compass.
    """
    of = CheckId.COMPASS_DIRECTION
    if not compasses:
        return unknown(of, "No compass could be seen.", "Look at the compass, or fly without one on purpose.")
    if upright is None or motion is not None:
        why = motion or "no accelerometer shows where down is"
        return unknown(of, f"Dip and heading cannot be seen: {why}.", "Put the vehicle down and check again.")
    left_out = disturbed(compasses, field)
    judgeable = {i: mean for i, mean in sorted(compasses.items()) if i not in left_out}
    notes = [*evidence_lines(compasses, "compass")]
    notes += [f"compass {i + 1} is left out: its strength is wrong already" for i in sorted(left_out)]
    headings = _headings(judgeable, upright, field, declination)
    if field is None:
        notes.append("dip is not compared: where the vehicle is was not heard")
    if upright.heading is None:
        notes.append("the true heading is not known: give it to check what all compasses may share")
    measures = blamed(headings, followed=followed)
    if not measures:
        why = "Nothing is left to compare with." if judgeable else "Every compass is left out."
        texts = notes[len(compasses) :]
        return unknown(of, f"{why} {'; '.join(texts)}.", _MAGNET, notes)
    good = _agreed(len(judgeable), max(installed, len(compasses)), field, upright)
    return judged(of, measures, good=good, remedy=_MOUNT, notes=notes)


def _agreed(judged_: int, installed: int, field: EarthField | None, upright: Upright) -> str:
    """Text of a pass, which names only what was compared."""
    with_ = ["the model"] if field is not None else []
    with_ += ["each other"] if judged_ > 1 else []
    with_ += ["the vehicle's own heading"] if field is not None and upright.north is not None else []
    who = counted(judged_, installed, "compass", "compasses")
    in_what = "dip and heading" if field is not None else "heading"
    listed = with_[0] if len(with_) == 1 else f"{', '.join(with_[:-1])} and {with_[-1]}"
    return f"{who} agree{'s' if who.startswith('The only') else ''} in {in_what} with {listed}."


def _headings(
    judgeable: Mapping[int, Mean], upright: Upright, field: EarthField | None, declination: Measure | None
) -> Headings:
    items = list(judgeable.items())
    pairs = {
        (i, k): _between(i, one, k, other, upright) for n, (i, one) in enumerate(items) for k, other in items[n + 1 :]
    }
    if field is None:
        return Headings({}, pairs, {}, {}, None)
    own, given = {}, {}
    if upright.north is not None:
        own = {
            i: _against(f"heading of compass {i + 1} from the vehicle's own", mean, upright.north, field, upright)
            for i, mean in items
        }
    known = _known_north(upright)
    if known is not None:
        given = {
            i: _against(f"heading of compass {i + 1} from the one given", mean, known, field, upright)
            for i, mean in items
        }
    dips = {i: _dip(i, mean, upright, field) for i, mean in items}
    return Headings(dips, pairs, own, given, declination)


def set_declination(autopilot: str, parameters: Mapping[str, Value], field: EarthField | None) -> Measure | None:
    """Manually set declination against the model's; None: the vehicle looks it up, or it is not known.

    ArduPilot: COMPASS_AUTODEC and COMPASS_DEC (rad); PX4: bit 0 of EKF2_DECL_TYPE and EKF2_MAG_DECL (deg).
    """
    if field is None:
        return None
    if autopilot == "ardupilot":
        name, remedy = "COMPASS_DEC", "Set COMPASS_AUTODEC to 1"
        by_hand, value = parameters.get("COMPASS_AUTODEC", 1) == 0, math.degrees(float(parameters.get(name, 0.0)))
        right = f"{field.declination:.3f} rad"
    else:
        name, remedy = "EKF2_MAG_DECL", "Set bit 0 of EKF2_DECL_TYPE"
        by_hand = not int(parameters.get("EKF2_DECL_TYPE", 1)) & 1
        value, right = float(parameters.get(name, 0.0)), f"{math.degrees(field.declination):.1f} deg"
    if not by_hand or name not in parameters:
        return None
    limit = limits.COMPASS_ANGLE
    off = abs((value - math.degrees(field.declination) + 180.0) % 360.0 - 180.0)
    explanation = "It is set by hand, and every heading of the vehicle is off by as much after its next start."
    of = f"declination in {name} ({value:.1f} deg) from the model's"
    remedy = f"{remedy}, or {name} to {right}, and restart the vehicle."
    return Measure(of, off, limits.DECLINATION_SD_DEG, limit.value, limit.unit, ("declination",), explanation, remedy)


def _dip(i: int, mean: Mean, upright: Upright, field: EarthField) -> Measure:
    limit = limits.COMPASS_ANGLE
    dip = math.asin(float(np.clip(mean.value @ upright.down / mean.norm, -1.0, 1.0)))
    noise = math.hypot(float(np.linalg.norm(mean.sd)), limits.SURROUNDINGS_SD, field.norm_sd) / mean.norm
    off = abs(dip - field.inclination)
    sd = math.hypot(noise, limits.TILT_SD)
    name = f"dip of compass {i + 1} ({math.degrees(dip):.1f} deg) from the model"
    return Measure(name, math.degrees(off), math.degrees(sd), limit.value, limit.unit)


def _between(i: int, one: Mean, k: int, other: Mean, upright: Upright) -> Measure:
    """Difference of two headings; the tilt is common, so its error matters only through their small difference."""
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
    """True north in the body frame, from the known heading of the nose; None: not known."""
    nose = _level(upright.down, np.array([1.0, 0.0, 0.0]))
    if upright.heading is None or np.linalg.norm(nose) < _LEVEL_NOSE:
        return None
    return _rotated(nose / np.linalg.norm(nose), upright.down, -upright.heading)


def _heading_sd(mean: Mean, upright: Upright, tilt: float) -> float:
    """Standard deviation of a heading, rad: noise and disturbance over the horizontal field, and tilt times dip."""
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
    """`vector`, perpendicular to `axis`, rotated by `angle` about it."""
    return np.asarray(math.cos(angle) * vector + math.sin(angle) * np.cross(axis, vector))


def place_of(recording: Recording) -> tuple[float, float, float] | None:
    """Last reported latitude, longitude (deg) and altitude (m)."""
    for channel in recording.find(Sensor.POSITION):
        for latitude, longitude, altitude in channel.values[::-1].tolist():
            if latitude or longitude:  # (0, 0) is "no fix"
                return latitude, longitude, altitude
    return None


def field_of(snapshot: Snapshot) -> EarthField | None:
    """The Earth's field where the vehicle is; None: the place is not known, or outside the model."""
    place = place_of(snapshot.recording)
    if place is None:
        return None
    when = datetime.fromtimestamp(snapshot.now, UTC)
    try:
        return earth_field(*place, decimal_year(when))
    except InvalidInputError:
        return None


def motor_compensation(snapshot: Snapshot) -> Check:
    """Motor compensation in force at full power, as a share of the Earth's field."""
    of = CheckId.MOTOR_COMPENSATION
    autopilot, parameters = snapshot.identity.autopilot or "", snapshot.parameters
    name = _TYPES.get(autopilot, "")
    kind = int(parameters.get(name, 0))
    read = (f"{name} = {kind}" if name in parameters else f"the vehicle has no {name or 'such parameter'}",)
    if name not in parameters and not snapshot.complete:
        return unknown(of, f"{name} could not be read in time.", "Check again on a faster link.")
    if kind == 0:
        return Check(of, Verdict.PASS, None, None, None, "", "No motor compensation is in force.", evidence=read)
    if autopilot == "ardupilot" and kind == _PER_MOTOR:
        return unknown(of, "Compensation by single motors is not judged.", evidence=read)
    by_current = kind in _BY_CURRENT[autopilot]
    if by_current and snapshot.current_known is False:
        reason = "The compensation goes by battery current, and the vehicle measures none."
        return Check(
            of, Verdict.FAIL, None, None, None, "", reason, "Set up the current sensor, or switch it off.", read
        )
    limit, field = limits.MOTOR_SHARE, field_of(snapshot)
    strength = _TYPICAL_FIELD if field is None else field.norm
    measures = []
    for instance in snapshot.recording.instances(Sensor.MAG):
        taken = _compensation_length(autopilot, parameters, instance, by_current=by_current)
        if taken:
            name = f"compensation of compass {instance + 1} at full power, of the field"
            measures.append(Measure(name, taken / strength, 0.0, limit.value, limit.unit))
    if not measures:
        reason = "Motor compensation is switched on, and its vectors are all zero."
        return Check(of, Verdict.WARN, 0.0, 0.0, limit.value, "", reason, _REMEDY, read)
    full = f"{limits.FULL_CURRENT_A:.0f} A" if by_current else "full throttle"
    good = f"The compensation is small beside the field at {full}."
    return judged(of, measures, good=good, remedy=_REMEDY, notes=read)


def _compensation_length(autopilot: str, parameters: Mapping[str, Value], instance: int, *, by_current: bool) -> float:
    """Length of the compensation at full power, uT."""
    try:
        names = calibration_names(autopilot, parameters, Sensor.MAG, instance)
    except FirmwareError:
        return 0.0
    vector = np.array([float(parameters.get(names.get(role, Role.ID), 0.0)) for role in MOTOR])
    full = 1.0
    if by_current:
        full = limits.FULL_CURRENT_A * (_PX4_PER_KA if autopilot == "px4" else 1.0)
    return float(np.linalg.norm(vector)) * _UT[autopilot] * full


SUBJECT = Subject(
    (motor_compensation,),
    {
        "ardupilot": ("COMPASS_AUTODEC", "COMPASS_DEC"),
        "px4": ("EKF2_DECL_TYPE", "EKF2_MAG_DECL"),
    },
)
