"""The sensors of a recording beside their references, less what a companion on another trajectory shows of its own."""

from __future__ import annotations

from collections.abc import Sequence

from mavcal.calib.gap.companion.nominal_baseline import beside_nominal, nominal_baseline_of
from mavcal.calib.gap.companion.simulated_baseline import baseline_of, beside
from mavcal.calib.gap.problem import GapProblem
from mavcal.calib.gap.progress import GapPace
from mavcal.calib.gap.reference import build, flew_another, posed, posed_apart, prepared, with_common_channels
from mavcal.calib.gap.remembered import one_diagnosis
from mavcal.calib.recording import Recording


@one_diagnosis()
def problem_of(
    real: Recording, sim: Recording | None, nominal: Sequence[Recording], alpha: float, pace: GapPace | None = None
) -> GapProblem:
    """What is diagnosed of `real` beside `sim` and `nominal`; errors are those of :func:`calib.gap.reference.build`.

    `pace` bounds the search for what `sim` or `nominal` shows of its own.
    """
    if sim is not None and flew_another(real, sim):
        real, sim = with_common_channels(real, sim)
        baseline = baseline_of(build(sim, sim, nominal), alpha, pace)
        return beside(build(real, sim, nominal, nuisance=baseline.in_ideal, companion=sim), baseline)
    apart = sim is not None and posed_apart(real, sim)
    companions = (sim, *nominal) if sim is not None and apart else tuple(nominal)
    if (sim is None or apart) and (other := posed(real, companions)) is not None:
        its = prepared(other, None, companions)
        nuisance = nominal_baseline_of(lambda known: its.problem(known, other), alpha, pace, simulated=apart)
        return beside_nominal(build(real, None, companions, nuisance=nuisance.in_ideal, companion=other), nuisance)
    return build(real, sim, nominal)
