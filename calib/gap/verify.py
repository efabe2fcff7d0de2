"""The part of a gap that is left after the simulator was run again with the remedy.

The simulator's new flight is diagnosed like the real one, against the same simulated flight, so that effects common to
both simulated flights cancel. The parameters of both diagnoses are compared; effects that agree within their errors are
closed. The effects of the new flight are then added to the ideal readings of the real one. This problem is diagnosed
again, allowing for the usual difference of two flights. It finds what the simulator still lacks; if it finds nothing,
the gap is closed. The two flights need not be the same. If they are (the new log itself is a reference for the real
one), the real sensors are compared with the simulated ones directly.

An effect of the airframe is compared by its parameters alone: those of the real and of the new flight, both against the
same simulated flight. It is closed if they agree within their errors, so that real over new is 1. Effects of the day's
air are not compared.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from mavcal.calib.airframe.answer import Domain
from mavcal.calib.errors import InvalidInputError
from mavcal.calib.gap import run
from mavcal.calib.gap.companion.baselines import problem_of
from mavcal.calib.gap.diagnose import diagnose
from mavcal.calib.gap.effects.replay import with_effects
from mavcal.calib.gap.export.airframe import airframe_effects
from mavcal.calib.gap.export.sensor_errors import sensor_effects
from mavcal.calib.gap.problem import GapProblem, ReferenceKind
from mavcal.calib.gap.reference import build
from mavcal.calib.gap.reference.best_reference import is_another_flight
from mavcal.calib.gap.reference.ideal import recorded_reference
from mavcal.calib.gap.remembered import one_diagnosis
from mavcal.calib.gap.schema import (
    CONVERTER,
    EffectEstimate,
    GapReport,
    GapVerdict,
    ParameterEstimate,
    SeriesFit,
    as_json,
)
from mavcal.calib.recording import Recording

Array = NDArray[np.float64]
Json = dict[str, Any]

_BLOCKS = 20
"""Blocks of a series for the bootstrap. Chosen, not measured: each has seconds of a minute, longer than noise
remembers."""
_DRAWS = 400
"""Bootstrap draws for an interval. Chosen, not measured: ten lie beyond either end of 95 %."""
_SEED = 20
"""Seed of the draws, for reproducible intervals. Chosen, not measured: any number does."""
_UNSEEN = 12.0
"""Total gain, nats, that may be hidden below the contest's threshold. Chosen, not measured: a deviance of 24, about
where detection begins (GAP 4.2)."""
_CHANCE = 0.0455
"""Chance that one number of two flights that are alike differs by more than two standard errors. Source: two-sided
normal distribution."""
_ERRORS = 2.0
"""Standard errors within which a parameter is closed. Source: AIRFRAME 6, a rerun of the patched simulator."""


@dataclass(frozen=True)
class EffectAgreement:
    """An effect of one diagnosis and its counterpart in another.

    `other` is None where the other diagnosis has none on the same instances. `holds`: no parameter differs by more than
    two standard errors. For several parameters the limit is higher, since the largest of several differs more by
    chance.
    """

    effect: EffectEstimate
    other: EffectEstimate | None
    holds: bool


@dataclass(frozen=True)
class Remainder:
    """Remainder of a parameter: first over other minus 1 for a `ratio`, else first minus other.

    `se` is its standard error; `within` tells whether it is at most two of them.
    """

    value: float
    se: float
    ratio: bool
    within: bool


@dataclass(frozen=True)
class Size:
    """A gap in nats per number (one axis of one sample) against the diagnosis' final noise; 95 % interval."""

    nats: float
    ci95: tuple[float, float]


@dataclass(frozen=True)
class Left:
    """One effect before and after: the `share` of its evidence that is left, and its parameters.

    `again` are those of the new flight's own diagnosis; None without such an effect or diagnosis. `agrees`: whether
    they equal `before` within their errors. `remainders` are those of an airframe effect, with their standard errors.
    """

    id: str
    instances: tuple[int, ...]
    share: float
    before: Mapping[str, float]
    left: Mapping[str, float]
    again: Mapping[str, float] | None = None
    agrees: bool = False
    remainders: Mapping[str, Remainder] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Verified:
    """The gap before and with the remedy.

    `effects` are those of the first diagnosis, `added` those that only the remedied simulator has, and `rest` the
    report of the remaining gap.
    """

    same_flight: bool
    before: Size
    remaining: Size
    effects: tuple[Left, ...]
    added: tuple[EffectEstimate, ...]
    rest: GapReport
    warnings: tuple[str, ...]

    @property
    def closed(self) -> float | None:
        """Share of the gap that is closed; None where there was none."""
        return 1.0 - self.remaining.nats / self.before.nats if self.before.nats > 0.0 else None


@one_diagnosis()
def verify(
    report: GapReport,
    real: Recording,
    sim: Recording | None,
    again: Recording,
    nominal: Sequence[Recording] = (),
    *,
    alpha: float = 0.005,
) -> Verified:
    """The gap of `real` that is left beside `again`.

    Parameters
    ----------
    report
        The first diagnosis, of `real`, `sim` and `nominal`.
    real, sim, nominal
        As for :func:`calib.gap.run`.
    again
        A recording of the simulator with the remedy.
    alpha
        Probability of reporting a remainder where there is none.

    Raises
    ------
    InvalidInputError
        If `again` has nothing in common with `real`, or no reference of its own.
    """
    direct = build(real, again, nominal)
    same = _is_same_flight(direct, real, again)
    lost: tuple[str, ...] = ()
    said: tuple[str, ...] = ()
    sensors, flying = sensor_effects(report.effects), airframe_effects(report.effects)
    compared: tuple[EffectAgreement, ...] = tuple(EffectAgreement(e, None, holds=False) for e in sensors)
    anew = _anew(report, again, sim, nominal, alpha, same=same)
    if same:
        problem = direct
    else:
        new = sensor_effects(anew.effects)
        compared = agreements(sensors, new)
        problem, lost = with_effects(problem_of(real, sim, nominal, alpha), _remedied(compared, new))
        said = tuple(f"the new recording: {warning}" for warning in anew.warnings)
    flown = agreements(flying, airframe_effects(anew.effects))
    unseen = {(a.effect.id, a.effect.instances) for a in compared if a.holds and a.effect.id in lost}
    rest = _without(diagnose(problem, alpha=alpha, nested=False), unseen)
    known = {(e.id, n) for e in sensors for n in e.instances}
    added = tuple(e for e in rest.effects if not any((e.id, n) in known for n in e.instances))
    brought = _brought(flown, anew)
    rest = _with(rest, (*(a.effect for a in flown if not a.holds), *brought))
    closed = {name for name, _ in unseen}
    lost = tuple(name for name in lost if name not in closed)
    warnings = tuple(f"{name} of the new flight could not be replayed on the real one" for name in lost)
    return Verified(
        same,
        size_of(report),
        size_of(rest),
        (*(_left(a, rest) for a in compared), *map(_left_flying, flown)),
        (*added, *brought),
        rest,
        (*rest.warnings, *said, *warnings),
    )


def _is_same_flight(direct: GapProblem, real: Recording, again: Recording) -> bool:
    """Whether the new log is the reference of the real one, and no log holds a reference of its own."""
    if direct.reference.kind is not ReferenceKind.SIM or is_another_flight(real, again):
        return False  # a log may hold the truth of its own flight
    return recorded_reference(real) is None and recorded_reference(again) is None


def _anew(
    report: GapReport,
    again: Recording,
    sim: Recording | None,
    nominal: Sequence[Recording],
    alpha: float,
    *,
    same: bool,
) -> GapReport:
    """Diagnosis of the new flight against the companions of the real one; empty if nothing needs it."""
    if any(e.domain is not Domain.SENSOR for e in report.effects) or report.airframe is not None:
        found = run(again, sim, nominal, alpha=alpha, nested=False)
        if not found.tested:
            why = "; ".join(n.reason for n in found.not_testable) or "nothing could be tested"
            raise InvalidInputError(f"the new recording of the simulator cannot be diagnosed by itself: {why}")
        return found
    if same:
        return replace(report, effects=(), warnings=())
    return diagnose(_of_new(again, sim, nominal, alpha), alpha=alpha, nested=False)


def _brought(flown: Sequence[EffectAgreement], anew: GapReport) -> tuple[EffectEstimate, ...]:
    """Effects of the new flight's airframe that the real one does not have."""
    known = {id(a.other) for a in flown}
    return tuple(e for e in airframe_effects(anew.effects) if id(e) not in known)


def _with(rest: GapReport, effects: Sequence[EffectEstimate]) -> GapReport:
    """`rest` with further unclosed `effects`; its verdict is then a gap."""
    if not effects:
        return rest
    verdict = GapVerdict.EXPLAINED if rest.verdict is GapVerdict.NO_GAP else rest.verdict
    return replace(rest, effects=(*rest.effects, *effects), verdict=verdict)


def _of_new(again: Recording, sim: Recording | None, nominal: Sequence[Recording], alpha: float) -> GapProblem:
    """`again` against its own reference, like the real recording; an error states which recording it concerns."""
    try:
        return problem_of(again, sim, nominal, alpha)
    except InvalidInputError as error:
        raise InvalidInputError(f"the new recording of the simulator cannot be diagnosed by itself: {error}") from error


def _remedied(compared: Sequence[EffectAgreement], found: Sequence[EffectEstimate]) -> list[EffectEstimate]:
    """Effects of the remedied simulator; where all effects of a sensor agree, with the values of the first diagnosis.

    The parameters of one sensor depend on each other, so those of two diagnoses are not mixed.
    """
    apart = {a.effect.sensor for a in compared if not a.holds}
    as_before = {id(a.other): a.effect for a in compared if a.holds and a.effect.sensor not in apart}
    return [as_before.get(id(effect), effect) for effect in found]


def _without(rest: GapReport, agreed: Collection[tuple[str, tuple[int, ...]]]) -> GapReport:
    """`rest` without lattice effects that agree: they cannot be replayed, and so are found again."""
    effects = tuple(e for e in rest.effects if (e.id, e.instances) not in agreed)
    if len(effects) == len(rest.effects):
        return rest
    none = not effects and not rest.unknown.flag
    return replace(rest, effects=effects, verdict=GapVerdict.NO_GAP if none else rest.verdict)


def agreements(effects: Sequence[EffectEstimate], others: Iterable[EffectEstimate]) -> tuple[EffectAgreement, ...]:
    """Each of `effects` with its counterpart among `others`, each of which is used once.

    Of several of one kind (steps), the one with the nearest parameters is chosen.
    """
    left = list(others)
    found = []
    for effect in effects:
        like = [o for o in left if o.id == effect.id and o.instances == effect.instances]
        best = min(like, key=lambda o: distance(effect, o), default=None)
        if best is not None:
            left.remove(best)
        found.append(EffectAgreement(effect, best, best is not None and distance(effect, best) <= 1.0))
    return tuple(found)


def remainders(compared: EffectAgreement) -> Mapping[str, Remainder]:
    """Remainder of each parameter by name; all of it where the other diagnosis has no such effect."""
    theirs = {} if compared.other is None else {p.name: p for p in compared.other.params}
    return {p.name: _remainder(p, theirs.get(p.name)) for p in compared.effect.params}


def _remainder(one: ParameterEstimate, other: ParameterEstimate | None) -> Remainder:
    value, se = (0.0, 0.0) if other is None else (other.value, other.se)
    ratio = one.ratio is not None and value > -1.0
    if ratio:
        left = (1.0 + one.value) / (1.0 + value) - 1.0
        sd = math.hypot(one.se, (1.0 + left) * se) / (1.0 + value)
    else:
        left, sd = one.value - value, math.hypot(one.se, se)
    return Remainder(left, sd, ratio, abs(left) <= _ERRORS * sd)


def distance(one: EffectEstimate, other: EffectEstimate) -> float:
    """Largest difference of their parameters relative to the allowed one; infinite without a common parameter."""
    theirs = {p.name: p for p in other.params}
    apart = [
        abs(p.value - theirs[p.name].value) / max(math.hypot(p.se, theirs[p.name].se), 1e-300)
        for p in one.params
        if p.name in theirs and math.isfinite(p.se) and math.isfinite(theirs[p.name].se)
    ]
    if not apart:
        return math.inf
    return max(apart) / -float(ndtri(0.5 * _CHANCE / len(apart)))


def size_of(report: GapReport) -> Size:
    """Gap in nats per number explained by the effects of `report`, with a bootstrap interval over blocks.

    Where nothing was found, the interval ends at the largest gap that would have been missed.
    """
    losses = [_blocks(series) for series in report.series if len(series.t) >= 2 * _BLOCKS]
    if not losses:
        return Size(0.0, (0.0, 0.0))
    table = np.concatenate(losses, axis=1)  # (blocks, 2 per series): sums and counts
    rng = np.random.default_rng(_SEED)
    picks = rng.integers(0, _BLOCKS, (_DRAWS, _BLOCKS))
    sums, counts = table[:, 0::2], table[:, 1::2]
    drawn = sums[picks].sum(axis=(1, 2)) / counts[picks].sum(axis=(1, 2))
    low, high = np.quantile(drawn, (0.025, 0.975))
    unseen = _UNSEEN / float(counts.sum())
    return Size(float(sums.sum() / counts.sum()), (float(low), max(float(high), unseen)))


def _blocks(series: SeriesFit) -> Array:
    """By block: loss of log-likelihood without the reported effects, and the count of numbers."""
    left = series.residual - series.modelled
    without = left + sum(series.parts.values(), np.zeros_like(left))
    loss = 0.5 * ((without**2 - left**2) / np.maximum(series.sigma, 1e-30) ** 2).sum(axis=1)
    parts = np.array_split(loss, _BLOCKS)
    return np.array([[p.sum(), 3.0 * len(p)] for p in parts])


def _left(compared: EffectAgreement, rest: GapReport) -> Left:
    effect, other = compared.effect, compared.other
    same = [e for e in rest.effects if e.id == effect.id and set(e.instances) & set(effect.instances)]
    evidence = sum(e.evidence.two_delta_loglik for e in same)
    share = min(1.0, max(0.0, evidence / effect.evidence.two_delta_loglik)) if same else 0.0
    left = {p.name: p.value for p in same[0].params} if same else {p.name: 0.0 for p in effect.params}
    before = {p.name: p.value for p in effect.params}
    again = None if other is None else {p.name: p.value for p in other.params}
    return Left(effect.id, effect.instances, share, before, left, again, compared.holds)


def _left_flying(compared: EffectAgreement) -> Left:
    """Remainder of an airframe effect: real over new minus 1 for a ratio, else real minus new.

    The share is that of the squares in standard errors of the first diagnosis, in proportion to evidence; 0 where they
    agree.
    """
    effect, other = compared.effect, compared.other
    before = {p.name: p.value for p in effect.params}
    again = None if other is None else {p.name: p.value for p in other.params}
    remaining = remainders(compared)
    left = {name: r.value for name, r in remaining.items()}
    known = [p for p in effect.params if p.se > 0.0]
    all_of_it = sum((p.value / p.se) ** 2 for p in known)
    rest_of_it = sum((left[p.name] / p.se) ** 2 for p in known)
    share = 0.0 if compared.holds else min(1.0, rest_of_it / all_of_it) if all_of_it > 0.0 else 1.0
    return Left(effect.id, effect.instances, share, before, left, again, compared.holds, remaining)


def verified_json(verified: Verified) -> Json:
    """What ``mavcal gap --verify`` adds to the JSON, under ``verify``."""
    rest = as_json(verified.rest)
    return {
        "same_flight": verified.same_flight,
        "verdict": verified.rest.verdict.value,
        "before": CONVERTER.unstructure(verified.before),
        "remaining": CONVERTER.unstructure(verified.remaining),
        "closed": verified.closed,
        "effects": CONVERTER.unstructure(verified.effects),
        "added": [e.id for e in verified.added],
        "rest": {"effects": rest["effects"], "unknown": rest["unknown"], "where": rest["where"][:20]},
        "warnings": list(verified.warnings),
    }
