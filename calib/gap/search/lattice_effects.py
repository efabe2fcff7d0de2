"""Effects of the sample lattice of each trace, and the rows that they exclude from the likelihood."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.gap.effects import by_id
from mavcal.calib.gap.effects.base import CatalogueEffect, LatticeEffect, LatticeEvidence
from mavcal.calib.gap.effects.traits import Trait
from mavcal.calib.gap.problem import GapProblem, Trace
from mavcal.calib.gap.schema import FIRST, EffectEstimate, EffectEvidence, ParameterEstimate
from mavcal.calib.gap.search import prices


@dataclass(frozen=True, eq=False)
class Lattice:
    """Lattice effects of a problem; by index of the trace, the rows that are `masked` and the added `variance`."""

    effects: tuple[EffectEstimate, ...]
    masked: Mapping[int, NDArray[np.bool_]]
    variance: Mapping[int, float]


def lattice_of(problem: GapProblem, effects: Iterable[CatalogueEffect]) -> Lattice:
    """Lattice effects of every trace that no nominal recording shows as well."""
    found: list[EffectEstimate] = []
    masked: dict[int, NDArray[np.bool_]] = {}
    variance: dict[int, float] = {}
    lattices = [effect for effect in effects if isinstance(effect, LatticeEffect)]
    for i, trace in _each_instance(problem.traces):
        for effect in lattices:
            evidence = effect.detect(trace) if effect.sensor is trace.sensor else None
            if evidence is None or nominal_has_samples(effect, evidence, problem.nominal):
                continue
            if evidence.two_delta_loglik < problem.minimum_gain.steady_report.get(trace.sensor, 0.0):
                continue  # two recordings differ by as much
            found.append(_estimate(effect, trace.instances, evidence))
            if evidence.masked.any():
                masked[i] = masked[i] | evidence.masked if i in masked else evidence.masked
            if Trait.COARSE in effect.traits:
                variance[i] = max(float(np.mean(np.square(evidence.values[:3]))) - trace.quantum**2, 0.0) / 12.0
    return Lattice(tuple(found), masked, variance)


def nominal_has_samples(effect: LatticeEffect, evidence: LatticeEvidence, nominal: Iterable[Trace]) -> bool:
    """Whether a nominal recording shows the same lattice effect."""
    for trace in nominal:
        other = effect.detect(trace) if trace.sensor is effect.sensor else None
        if other is not None and len(other.values) == len(evidence.values):
            mine, its = np.array(evidence.values), np.array(other.values)
            if (np.abs(mine - its) <= prices.SAMPLE_DIFFERENCE * np.maximum(np.abs(mine), np.abs(its))).all():
                return True
    return False


def covered_by(lattice: Lattice, effect: EffectEstimate) -> bool:
    """Whether a lattice effect already describes an effect, itself or by coarse levels around zero."""
    return any(_explains(e, effect) and set(effect.instances) <= set(e.instances) for e in lattice.effects)


def _explains(shown: EffectEstimate, effect: EffectEstimate) -> bool:
    """Whether a lattice effect is `effect` itself, or causes its dead band."""
    if shown.id == effect.id:
        return True
    coarse, dead = Trait.COARSE in by_id()[shown.id].traits, Trait.DEAD_BAND in by_id()[effect.id].traits
    return coarse and dead and shown.sensor is effect.sensor


def _each_instance(traces: Sequence[Trace]) -> Iterator[tuple[int, Trace]]:
    """Index and trace of every instance: against the reference or, without one, against another instance."""
    single = {(t.sensor, i) for t in traces if t.against is None for i in t.instances}
    for index, trace in enumerate(traces):
        if trace.against is None:
            yield index, trace
            continue
        swapped = replace(
            trace, measured=trace.ideal, ideal=trace.measured, instances=(trace.against,), against=trace.instances[0]
        )
        for one in (trace, swapped):
            if (one.sensor, one.instances[0]) not in single:
                single.add((one.sensor, one.instances[0]))
                yield index, one


def _estimate(effect: LatticeEffect, instances: tuple[int, ...], evidence: LatticeEvidence) -> EffectEstimate:
    params = tuple(
        ParameterEstimate(p.name, value, se, (value - 1.96 * se, value + 1.96 * se), p.unit)
        for p, value, se in zip(effect.parameters, evidence.values, evidence.se, strict=True)
    )
    sure = EffectEvidence(evidence.two_delta_loglik, len(params), 0.0, 0.999, 0.0)
    return EffectEstimate(effect.id, effect.sensor, tuple(i + FIRST for i in instances), params, sure)
