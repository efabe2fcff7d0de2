"""Search for likely sets of blocks: add, drop and swap until nothing helps; answers are sums over visited models.

Every visited model within :data:`KEPT_NATS` of the best is kept with its weight. Probabilities, rivals and the set of
confusable blocks are sums over the kept models: there is no second formula.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from mavcal.calib.inference.model import Block, Evidence, Model, Posterior

KEPT_NATS = 12.0
"""A model this much less likely than the best has a weight below 1e-5 and is dropped. Source: the issue's engine."""
_MOST_REFINED = 12
"""Times that the data are expanded about a new best point. Measured: two are usual, ten in the slowest case seen."""
_MOST_CHANGE = 0.25
"""Largest change of a block between two expansions at which the search ends, in standard errors. Measured: when it
stopped at the first repeated model, a drag of 0.07 +- 0.05 was reported as 0.32 +- 0.04."""
_MOST_BLOCKS = 8
"""Most blocks of one model. Source: mixtures have two to four (AIRFRAME 6); twice as many leave room."""
_MOST_MODELS = 3000
"""Number of models after which no further neighbours are visited. Chosen, not measured: it bounds the time."""
CLOSED_NATS = 4.0
"""Every neighbour of a model within so many nats of the best is visited. Measured: probabilities then agree with the
sum over all sets of six blocks to 0.002."""


@dataclass(frozen=True, eq=False)
class Visited:
    """A visited model: log of its posterior weight, and its posterior."""

    model: Model
    log_weight: float
    posterior: Posterior


@dataclass(frozen=True, eq=False)
class Answer:
    """All kept models, the likeliest first, and the last expansion of the data."""

    kept: tuple[Visited, ...]
    blocks: tuple[Block, ...]
    evidence: Evidence
    visited: int

    @property
    def best(self) -> Visited:
        """The likeliest model."""
        return self.kept[0]

    @cached_property
    def weights(self) -> tuple[float, ...]:
        """Probability of each kept model."""
        logs = np.array([v.log_weight for v in self.kept])
        raw = np.exp(logs - logs.max())
        return tuple((raw / raw.sum()).tolist())

    def probability(self, *names: str) -> float:
        """Probability that the model has at least one of these blocks."""
        return math.fsum(w for w, v in zip(self.weights, self.kept, strict=True) if v.model.intersection(names))

    def rivals(self, name: str) -> dict[str, tuple[float, float]]:
        """Blocks that replace `name` in kept models: probability, and by how many nats `name` is preferred."""
        own = max((v.log_weight for v in self.kept if name in v.model), default=-math.inf)
        found: dict[str, tuple[float, float]] = {}
        for weight, one in zip(self.weights, self.kept, strict=True):
            if name in one.model:
                continue
            for other in one.model - self.best.model:
                before, least = found.get(other, (0.0, math.inf))
                found[other] = before + weight, min(least, own - one.log_weight)
        return found

    def confusable(self, name: str, least: float) -> tuple[str, ...]:
        """Blocks that replace `name` with a probability of `least` or more, likeliest first."""
        found = {k: p for k, (p, _) in self.rivals(name).items() if p >= least}
        return tuple(sorted(found, key=lambda k: -found[k]))

    def amplitudes(self, name: str) -> tuple[np.ndarray, np.ndarray]:
        """Mean (k,) and covariance (k, k) of a block over the kept models that have it."""
        chosen = [(w, *v.posterior.of(name)) for w, v in zip(self.weights, self.kept, strict=True) if name in v.model]
        total = math.fsum(w for w, _, _ in chosen)
        mean = sum(w * m for w, m, _ in chosen) / total
        spread = sum(w * (c + np.outer(m - mean, m - mean)) for w, m, c in chosen) / total
        return np.asarray(mean), np.asarray(spread)


@dataclass(eq=False)
class _Search:
    """The models that were visited with one expansion of the data."""

    evidence: Evidence
    seen: dict[Model, Visited] = field(default_factory=dict)

    def visit(self, model: Model) -> Visited:
        found = self.seen.get(model)
        if found is None:
            posterior = self.evidence.posterior(model)
            prior = sum(
                math.log(b.prior_odds / (1.0 + b.prior_odds)) if b.name in model else -math.log1p(b.prior_odds)
                for b in self.evidence.blocks
            )
            found = self.seen[model] = Visited(model, posterior.log_evidence + prior, posterior)
        return found

    def climb(self, start: Model, ended: Callable[[], bool]) -> Visited:
        """The model reached from `start` that no move makes likelier."""
        best = self.visit(start)
        while not ended():
            better = max((self.visit(m) for m in _moves(best.model, self.evidence.blocks)), key=lambda v: v.log_weight)
            if better.log_weight <= best.log_weight:
                return best
            best = better
        return best

    def close(self, ended: Callable[[], bool]) -> None:
        """Visit the neighbours of every likely model, until none is new: probabilities are sums over all of them."""
        done: set[Model] = set()
        while not ended():
            least = max(v.log_weight for v in self.seen.values()) - CLOSED_NATS
            left = [m for m, v in self.seen.items() if v.log_weight >= least and m not in done]
            if not left or len(self.seen) > _MOST_MODELS:
                return
            for model in left:
                done.add(model)
                for other in _moves(model, self.evidence.blocks):
                    self.visit(other)


def search(evidence: Evidence, start: Model = frozenset(), ended: Callable[[], bool] = lambda: False) -> Answer:
    """The likeliest sets of blocks of `evidence`.

    Parameters
    ----------
    evidence
        The data.
    start
        The first model.
    ended
        True when time is up; the best model so far is then the answer.
    """
    found = _Search(evidence)
    best = found.climb(start, ended)
    for _ in range(_MOST_REFINED):
        if ended():
            break
        before = best
        evidence = evidence.refined(best.model)
        found = _Search(evidence)
        best = max((found.climb(m, ended) for m in {best.model, frozenset[str]()}), key=lambda v: v.log_weight)
        if _unchanged(before, best):
            break
    found.close(ended)
    best = max(found.seen.values(), key=lambda v: v.log_weight)
    kept = sorted(found.seen.values(), key=lambda v: -v.log_weight)
    kept = [v for v in kept if v.log_weight >= best.log_weight - KEPT_NATS]
    return Answer(tuple(kept), evidence.blocks, evidence, len(found.seen))


def _unchanged(before: Visited, now: Visited) -> bool:
    """Whether a new expansion gives the same best model, with equal amplitudes."""
    if before.model != now.model:
        return False
    found = ((before.posterior.of(name)[0], *now.posterior.of(name)) for name in now.model)
    return all((np.abs(new - old) <= _MOST_CHANGE * np.sqrt(np.diag(spread))).all() for old, new, spread in found)


def _moves(model: Model, blocks: tuple[Block, ...]) -> Iterator[Model]:
    """Every model one addition, one removal or one exchange away."""
    groups = {b.name: b.exclusive for b in blocks}
    outside = [b.name for b in blocks if b.name not in model]

    def fits(base: Model, name: str) -> bool:
        return not groups[name] or all(groups[other] != groups[name] for other in base)

    for name in sorted(model):
        yield model - {name}
    for name in outside:
        if len(model) < _MOST_BLOCKS and fits(model, name):
            yield model | {name}
        for old in sorted(model):
            if fits(model - {old}, name):
                yield (model - {old}) | {name}
