"""Finds the compass at fault where headings disagree, by a third reference; else names all candidates.

Witnesses are the majority of three compasses, the dip of the field, a heading that the operator gives, and the
vehicle's own heading. The last is a witness against the compass that it follows, and never for it.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass

from mavcal.calib.preflight.check import Measure, Verdict

_VEHICLE = "the vehicle's own heading"
_GIVE = "Check again and give the true heading of the nose: it tells which of them is off."
_DECLINED = "The declination that is set by hand explains it."


@dataclass(frozen=True)
class Headings:
    """Every number on the direction of the field, by compass."""

    dips: Mapping[int, Measure]
    pairs: Mapping[tuple[int, int], Measure]
    own: Mapping[int, Measure]
    given: Mapping[int, Measure]
    declination: Measure | None


def blamed(found: Headings, *, followed: int) -> list[Measure]:
    """All measures, each with what is off if it is; `followed`: the compass that the vehicle's heading follows."""
    together = not any(map(_off, found.pairs.values()))
    measures = [_dip(i, m, found, together=together) for i, m in found.dips.items()]
    measures += [_pair(i, k, m, found, followed) for (i, k), m in found.pairs.items()]
    measures += [_own(i, m, found, followed, together=together) for i, m in found.own.items()]
    measures += [_by_stated_heading(i, m, found, together=together) for i, m in found.given.items()]
    return measures + ([] if found.declination is None else [found.declination])


def _off(measure: Measure) -> bool:
    return measure.verdict in (Verdict.FAIL, Verdict.WARN)


def _dip(i: int, measure: Measure, found: Headings, *, together: bool) -> Measure:
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
