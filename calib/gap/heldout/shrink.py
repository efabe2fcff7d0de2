"""Shrink of the gap on data that the effects have not seen, in nats a sample.

Blocks are held out in turn; effects are selected and fitted on the others. The loss is the negative log predictive
density, a proper score of mean and noise. The floor is the loss of a model with the exact effects. It is the loss of
the fit to all data plus half a nat for each fitted number, since the fit follows its own noise (Akaike 1974). Any
significant excess over the declared noise is subtracted.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

from mavcal.calib.gap.heldout.folds import (
    GUARD_S,
    Fold,
    applied_to,
    blocks_of,
    contest_of,
    folds_of,
    is_predictable,
    log_loss,
    power_ratio,
    predictive_loss,
    with_joined_term,
    with_weight,
    without_hypothesis,
)
from mavcal.calib.gap.heldout.gates import Gate, gate_of
from mavcal.calib.gap.model.hypotheses import Key
from mavcal.calib.gap.model.joint import Model, NoiseTerm, Setting, Term, jacobian, normal_equations, setting_of
from mavcal.calib.gap.model.noise_fit import is_declared, noise_fitted
from mavcal.calib.gap.model.normal_equations import solved
from mavcal.calib.gap.progress import GapStage
from mavcal.calib.gap.remembered import remembered
from mavcal.calib.gap.schema import SequenceStep, Shrink
from mavcal.calib.gap.search.contest import Contest
from mavcal.calib.gap.search.selection import ChosenModel, select
from mavcal.calib.gap.search.terms import Gains, marginal_gains

Array = NDArray[np.float64]

_BLOCKS = 8
"""Blocks of a recording; each is held out once. Source: decision 4."""
_LONG_SAMPLES = 40_000
"""Samples of a series above which a recording is long. Chosen, not measured: it bounds the time of a selection in every
block."""
_FEW_BLOCKS = 4
"""Blocks where a series is longer than `_LONG_SAMPLES` samples: each repeats the selection. Source: decision 4."""
_LEAST_HELD_OUT = 2
"""Blocks that are held out even if time is over. Chosen, not measured: two may contradict each other."""
_RESAMPLED = 2000
"""Bootstrap draws for an interval. Chosen, not measured: fifty lie beyond either end of 95 %."""
_CANDIDATE_CHANCE = 0.01
"""Uncorrected p-value below which a hypothesis competes in the folds; the level remains that of all tests. Chosen, not
measured: others cannot become significant at that level."""
_REPEATED_TIME_SHARE = 0.5
"""Expected time of a selection in a block, relative to the first selection: fewer effects compete. Chosen, not
measured: half as many compete."""
_SIGNIFICANT = 3.0
"""Standard errors above which excess power is significant. Chosen, not measured: one in 740 is as loud by chance."""
_ROUNDING = 1e-9
"""Fraction of a gap below which the rest is rounding. Source: rounding of a sum of some 1e6 numbers, with a margin."""
_DISAGREE = 1e-3
"""P-value below which blocks disagree on the size of an effect. Chosen, not measured: one effect in a thousand is
rejected by chance."""


@dataclass(frozen=True, eq=False)
class Heldout:
    """Losses of B held-out blocks, and the gates of the effects.

    `losses` (B, 2) are nats without and with the effects, `floor` (B,) those of a model with the exact effects.
    `samples` (B,) are the counts, and `steps` (B, K) the gains of the effects `order`, added in turn. `has_event` marks
    blocks with an event, whose time the others cannot predict.
    """

    folds: tuple[Fold, ...]
    losses: Array
    floor: Array
    samples: Array
    has_event: tuple[bool, ...]
    order: tuple[str, ...]
    steps: Array
    gates: tuple[Gate, ...]

    @property
    def before(self) -> Array:
        """Nats (B,) above the floor without the effects."""
        return self.losses[:, 0] - self._lowest

    @property
    def after(self) -> Array:
        """Nats (B,) above the floor with them."""
        return self.losses[:, 1] - self._lowest

    @property
    def _lowest(self) -> Array:
        """The floor by block, lowered so that no model is below it over all blocks."""
        below = max(float((self.floor - self.losses[:, 1]).sum()), 0.0)
        return self.floor - below / float(self.samples.sum()) * self.samples

    @property
    def sequence(self) -> tuple[SequenceStep, ...]:
        """Share of the gap that each effect closes, added in turn."""
        whole = float(self.before.sum())
        if whole <= 0.0:
            return ()
        parts = self.steps.sum(axis=0) / whole
        return tuple(SequenceStep(name, float(part)) for name, part in zip(self.order, parts, strict=True))


def held_out(
    chosen: ChosenModel, contest: Contest, tolerated: Collection[Key] = (), known: Collection[Gate] | None = None
) -> Heldout | None:
    """Every block held out in turn; None if the recording is too short, or nothing is reported.

    Once time is over, shapes are held at their values for all data.

    Parameters
    ----------
    chosen, contest
        The model, and what competed for it.
    tolerated
        Keys of effects that are in every model, since two recordings always differ by them.
    known
        Known gates of a model with at least these effects; None: they are computed.
    """
    setting, pace = chosen.model.setting, contest.pace
    given, order = _in_order_of_entry(chosen, tolerated)
    if not order:
        return None
    jumps = any(term.hypothesis.effect.jumps for term in order)  # long blocks do not know what was before or after it
    long = max(view.whole.n for view in setting.views) > _LONG_SAMPLES and not jumps
    folds = folds_of(without_reference_error(chosen.model), _FEW_BLOCKS if long else _BLOCKS)
    if not folds:
        return None
    floor_ratio = _unexplained_per_number(chosen.model)
    losses: list[tuple[float, float]] = []
    lowest, gains, steps, determined = [], [], [], []
    began = pace.now
    for k, fold in enumerate(folds):
        if k >= _LEAST_HELD_OUT and pace.ends((pace.now - began) / k):
            break
        base = noise_fitted(fold.train).model
        for term in given:
            foreseen = is_predictable(term, chosen.model, fold.train.setting)
            base = with_joined_term(base, term, hold=pace.ends()) if foreseen else base
        chain = [base]
        seen = [is_predictable(term, chosen.model, fold.train.setting) for term in order]
        for term, foreseen in zip(order, seen, strict=True):
            chain.append(with_joined_term(chain[-1], term, hold=pace.ends()) if foreseen else chain[-1])
        nats = [predictive_loss(model, fold.test) for model in chain]
        losses.append((nats[0], nats[-1]))
        lowest.append(_floor(chosen, order, chain[-1], fold) - floor_ratio * fold.test.setting.samples)
        steps.append([nats[0] - loss for loss in nats[1:]])
        if known is not None:
            continue
        less = (
            without_hypothesis(chain[-1], term.hypothesis, hold=pace.ends()) if foreseen else chain[-1]
            for term, foreseen in zip(order, seen, strict=True)
        )
        determined.append(seen)
        gains.append([predictive_loss(model, fold.test) - nats[-1] for model in less])
    folds = folds[: len(losses)]
    if known is None:
        beside = _gains_beside_noise(chosen, contest)
        gates = tuple(
            gate_of(term, np.array([g[i] for g in gains]), [k[i] for k in determined], folds, chosen, beside)
            for i, term in enumerate(order)
        )
    else:
        tested = {term.hypothesis.key for term in order}
        gates = tuple(gate for gate in known if gate.key in tested)
    return Heldout(
        folds,
        np.array(losses, dtype=np.float64),
        np.array(lowest, dtype=np.float64),
        np.array([fold.test.setting.samples for fold in folds], dtype=np.float64),
        tuple(any(_is_event_of(term, fold.test) for term in order) for fold in folds),
        tuple(term.hypothesis.effect.id for term in order),
        np.array(steps, dtype=np.float64),
        gates,
    )


def _gains_beside_noise(chosen: ChosenModel, contest: Contest) -> Gains:
    """Marginal gain of each effect; beside undeclared noise, at most the gain over a refit of that noise.

    Such noise absorbs much of a slow effect, on held-out blocks as well.
    """
    gains = dict(marginal_gains(chosen.model, contest))
    unknown = {view.sensor for view in chosen.model.setting.views if not is_declared(view)}
    level = sum(chosen.noise.deviance.values())
    for term in chosen.model.terms:
        key = term.hypothesis.key
        if term.effect.sensor in unknown and key in gains:
            bare = without_hypothesis(chosen.model, term.hypothesis, hold=contest.pace.ends())
            refit = sum(noise_fitted(bare).deviance.values())
            gains[key] = (max(min(gains[key][0], refit - level), 0.0), *gains[key][1:])
    return gains


def with_nested_selection(found: Heldout, chosen: ChosenModel, contest: Contest, alpha: float) -> Heldout:
    """The losses with effects selected again for each block from the others.

    Not for blocks with an event, nor once time is over.
    """
    pace, losses = contest.pace, []
    took = _REPEATED_TIME_SHARE * pace.duration_of(GapStage.SELECTION) if GapStage.SELECTION in pace.began else 0.0
    for k, (fold, fixed, happens) in enumerate(zip(found.folds, found.losses[:, 1], found.has_event, strict=True)):
        pace.begin(GapStage.BLOCKS, k / len(found.folds))
        if happens or pace.ends(took):
            losses.append(float(fixed))
            continue
        began = pace.now
        loss = _loss_of_selection_without(fold, chosen, contest, alpha)
        losses.append(float(fixed) if pace.ends() else loss)  # a search that was cut short selects too little
        took = pace.now - began
    return replace(found, losses=np.column_stack([found.losses[:, 0], losses]))


def _floor(chosen: ChosenModel, order: Sequence[Term | NoiseTerm], fitted: Model, fold: Fold) -> float:
    """Loss of a held-out block under the effects of all data.

    Any model has to learn the noise level from the other blocks, so it is not part of the gap. Unless noise is the
    effect, the floor therefore uses the noise, and the tolerated terms, of the model `fitted` there.
    """
    noise = chosen.model if any(isinstance(term, NoiseTerm) for term in order) else fitted
    tested = {term.hypothesis.key for term in order}
    given = tuple(t for t in fitted.terms if t.hypothesis.key not in tested)
    known = replace(noise, terms=(*(term for term in order if isinstance(term, Term)), *given))
    fitted_numbers = len(chosen.joint.covariance) if chosen.model.ridge is None else 0
    share = fold.test.setting.samples / max(fold.train.setting.samples + fold.test.setting.samples, 1)
    return log_loss(applied_to(known, fold.test)) + 0.5 * fitted_numbers * share


@remembered(2)
def without_reference_error(model: Model) -> Setting:
    """The setting with the reference's attitude error subtracted, which does not predict another block."""
    if model.ridge is None:
        return model.setting
    ridge, seen = model.ridge, model.ridge.columns.parts
    views = [
        replace(view, residual=view.residual - ridge.predicted(view)) if 3 * v in seen or 3 * v + 1 in seen else view
        for v, view in enumerate(model.setting.views)
    ]
    return setting_of(tuple(views))


def _is_event_of(term: Term | NoiseTerm, block: Model) -> bool:
    """Whether a term is an event of the held-out block, which the others cannot predict."""
    if not isinstance(term, Term) or not term.hypothesis.effect.jumps:
        return False
    own = [view for view in block.setting.views if term.hypothesis.touches(view)]
    return any(view.t[0] - 2.0 * GUARD_S <= term.theta <= view.t[-1] + 2.0 * GUARD_S for view in own)


def _in_order_of_entry(
    chosen: ChosenModel, tolerated: Collection[Key]
) -> tuple[list[Term | NoiseTerm], list[Term | NoiseTerm]]:
    """Tolerated terms and the others, each in order of entry."""
    members = {t.hypothesis.key: t for t in chosen.model.members}
    terms = [members[s.hypothesis.key] for s in chosen.scores if s.hypothesis.key in members]
    given = [term for term in terms if term.hypothesis.key in tolerated]
    return given, [term for term in terms if term.hypothesis.key not in tolerated]


def _unexplained_per_number(model: Model) -> float:
    """Significant excess of the residual over the model's noise, in nats a number."""
    ratio, count = power_ratio(model)
    excess = 0.5 * (ratio - 1.0)
    return excess if excess > _SIGNIFICANT / math.sqrt(2.0 * count) else 0.0


def _loss_of_selection_without(fold: Fold, chosen: ChosenModel, contest: Contest, alpha: float) -> float:
    """Loss of the held-out block under a selection on the others, restricted to sensors with an effect."""
    sensors = {term.hypothesis.effect.sensor for term in chosen.model.members}
    promising = {
        s.hypothesis.key
        for s in (*chosen.first, *chosen.scores)
        if s.p < _CANDIDATE_CHANCE and (s.hypothesis.effect.sensor in sensors or s.hypothesis.effect.shared)
    }
    few = [h for h in contest.hypotheses if h.key in promising or (h.before is not None and h.before in promising)]
    level = alpha * sum(not h.again for h in few) / max(chosen.tests, 1)
    if not few:
        return predictive_loss(noise_fitted(fold.train).model, fold.test)
    found = select(noise_fitted(fold.train).model, contest_of(few, contest.thresholds, contest.pace), level)
    return predictive_loss(found.model, fold.test)


def bootstrap_interval(part: Array, whole: Array) -> tuple[float, float]:
    """95 % interval of ``sum(part) / sum(whole)`` by resampling blocks."""
    rng = np.random.default_rng(0)
    drawn = rng.integers(0, len(part), (_RESAMPLED, len(part)))
    total = whole[drawn].sum(axis=1)
    ratio = part[drawn].sum(axis=1) / np.where(total == 0.0, np.nan, total)
    ratio = ratio[np.isfinite(ratio)]
    if not len(ratio):
        return -math.inf, math.inf
    low, high = np.quantile(ratio, [0.025, 0.975])
    return float(low), float(high)


def shrink_of(chosen: ChosenModel, found: Heldout, *, nested: bool) -> Shrink:
    """The shrink for the report."""
    samples = float(found.samples.sum())
    gap = float(found.before.sum())
    closed, ci = None, None
    if chosen.model.members and gap > 0.0:
        closed = float((found.before - found.after).sum()) / gap
        ci = bootstrap_interval(found.before - found.after, found.before)
    known = any(is_declared(view) for view in chosen.model.setting.views)
    source = "declared_noise" if known else "fit_to_all_data"
    if any(view.density is not None or math.isfinite(view.dof) for view in chosen.model.setting.views):
        source = "nominal_log"
    left = float(found.after.sum())
    after = left / samples if abs(left) > _ROUNDING * gap else 0.0  # a floor that was lowered is met exactly
    return Shrink(gap / samples, after, 0.0, source, closed, ci, nested, found.sequence, rms_of(chosen.model))


def rms_of(model: Model) -> dict[str, tuple[float, float, str]]:
    """Rms of the residual of one axis before and after, by sensor.

    Each band counts at the rate of the whole series.
    """
    energy: dict[str, list[float]] = {}
    units: dict[str, str] = {}
    for view, residual in zip(model.setting.views, model.residual, strict=True):
        units[view.sensor.value] = view.any_trace.unit
        entry = energy.setdefault(view.sensor.value, [0.0, 0.0, 0.0])
        for k, series in enumerate((view.residual, residual)):
            entry[k] += float((view.spectra(series) ** 2).sum()) / view.gain
        entry[2] += 0.0 if view.first else 3.0 * view.whole.n
    return {
        sensor: (math.sqrt(before / count), math.sqrt(after / count), units[sensor])
        for sensor, (before, after, count) in energy.items()
    }


@dataclass(frozen=True)
class BlockAgreement:
    """Whether single blocks agree on an effect's amplitudes, the dose-response gate.

    `agrees` is None for noise and if fewer than two blocks show the effect. If they disagree, standard errors are too
    small by `widening` (Birge's ratio), because an unmodelled effect changes the amplitudes.
    """

    agrees: bool | None = None
    widening: float = 1.0


def block_agreement(chosen: ChosenModel, key: Key) -> BlockAgreement:
    """Agreement of the blocks on the effect `key`."""
    model = chosen.model
    term = next((t for t in model.terms if t.hypothesis.key == key), None)
    if term is None:
        return BlockAgreement()
    total, count = 0.0, 0
    for part in blocks_of(without_reference_error(model), _BLOCKS):
        block = with_weight(applied_to(model, part))
        normal = normal_equations([jacobian(term, block.setting)], block.y, block.weight)
        step, _, rank = solved(normal.gram, normal.right)
        total += float(step @ normal.right)
        count += rank
    freedom = count - len(term.values)
    if freedom < 1:
        return BlockAgreement()
    agrees = bool(chdtrc(freedom, total) > _DISAGREE)
    return BlockAgreement(agrees, 1.0 if agrees else math.sqrt(total / freedom))
