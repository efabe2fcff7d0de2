"""Effects that are no larger than what the error of a re-estimated attitude makes of them: nobody can tell them apart.

The noise of the samples would know them well; the reference does not. They stay in the model, so that nothing else
takes their place, and are no gap.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator

from mavcal.calib.gap.model.hypotheses import Key
from mavcal.calib.gap.problem import ReferenceInfo, ReferenceKind
from mavcal.calib.gap.schema import ParameterEstimate
from mavcal.calib.gap.search.selection import ChosenModel
from mavcal.calib.gap.telling.estimates import estimates_of

_ERRORS = 2.0
"""Standard errors that one amplitude of an effect must exceed. Source: decision 32."""


def inseparable(chosen: ChosenModel, reference: ReferenceInfo) -> frozenset[Key]:
    """Named effects on the mean without an amplitude beyond two standard errors, the reference's tilt included."""
    if reference.kind is not ReferenceKind.ESTIMATOR:
        return frozenset()
    return frozenset(_within(chosen))


def _within(chosen: ChosenModel) -> Iterator[Key]:
    for term in chosen.model.terms:
        effect = term.effect
        if effect.nameless or effect.fixed or not effect.parameters:
            continue
        amplitudes = estimates_of(chosen, term)[: len(effect.parameters)]
        if not any(map(_undetermined, amplitudes)):
            yield term.hypothesis.key


def _undetermined(amplitude: ParameterEstimate) -> bool:
    """Whether it differs from zero; of one that by itself has no error nothing is known."""
    return not math.isfinite(amplitude.se) or abs(amplitude.value) > _ERRORS * amplitude.se


def inseparable_notice(ids: Collection[str]) -> tuple[str, ...]:
    """One sentence for the report; none where there are no such effects."""
    names = ", ".join(dict.fromkeys(ids))
    return (f"small, not separable from the reference's error: {names}",) if names else ()
