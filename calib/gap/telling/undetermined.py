"""Effects with a number that the data do not bound: nobody is told a name whose size or frequency may be anything."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator

from mavcal.calib.gap.model.hypotheses import Key
from mavcal.calib.gap.schema import ParameterEstimate
from mavcal.calib.gap.search.selection import ChosenModel
from mavcal.calib.gap.telling.estimates import estimates_of
from mavcal.calib.gap.unknown.verdict import UnnamedCause


def bounded(params: Iterable[ParameterEstimate]) -> bool:
    """Whether all of them have an error."""
    return all(math.isfinite(p.value) and math.isfinite(p.se) for p in params)


def undetermined(chosen: ChosenModel) -> dict[Key, str]:
    """Named effects of a model with a parameter that has no finite error, and the names of these."""
    found = {}
    for term in chosen.model.members:
        if term.hypothesis.effect.nameless:
            continue
        loose = [p.name for p in estimates_of(chosen, term) if not bounded([p])]
        if loose:
            found[term.hypothesis.key] = ", ".join(loose)
    return found


def without_a_name(chosen: ChosenModel, loose: dict[Key, str]) -> Iterator[UnnamedCause]:
    """What is said in their place."""
    for term in chosen.model.members:
        effect = term.hypothesis.effect
        if (names := loose.get(term.hypothesis.key)) is not None:
            like = f"a difference on {effect.sensor.value} like {effect.plain}"
            yield UnnamedCause((term.hypothesis.key,), f"{like}, whose {names} these data do not bound")
