"""Evidence whose every posterior has a closed form: columns in white noise, amplitudes with normal priors."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from mavcal.calib.inference.model import Block, Evidence, Model, Posterior

Array = np.ndarray


@dataclass(frozen=True, eq=False)
class Columns:
    """``y = sum of columns @ amplitudes + noise``; `columns` (N, k) by block, noise of unit variance."""

    blocks: tuple[Block, ...]
    columns: dict[str, Array]
    y: Array

    def posterior(self, model: Model) -> Posterior:
        chosen = [b for b in self.blocks if b.name in model]
        x = np.column_stack([np.empty((len(self.y), 0)), *(self.columns[b.name] for b in chosen)])
        sd = np.array([s for b in chosen for s in b.sd])
        cov = (x * sd**2) @ x.T + np.eye(len(self.y))
        size = float(np.linalg.slogdet(2.0 * np.pi * cov)[1])
        evidence = -0.5 * (size + float(self.y @ np.linalg.solve(cov, self.y)))
        covariance = np.linalg.inv(x.T @ x + np.diag(sd**-2.0)) if chosen else np.empty((0, 0))
        places, at = {}, 0
        for block in chosen:
            places[block.name] = slice(at, at + len(block.sd))
            at += len(block.sd)
        return Posterior(evidence, covariance @ (x.T @ self.y), covariance, places)

    def refined(self, model: Model) -> Evidence:
        del model
        return self


def models_of(blocks: tuple[Block, ...]) -> Iterator[Model]:
    """Every set of blocks in which no two are of one exclusive group."""
    for size in range(len(blocks) + 1):
        for some in itertools.combinations(blocks, size):
            groups = [b.exclusive for b in some if b.exclusive]
            if len(groups) == len(set(groups)):
                yield frozenset(b.name for b in some)


def brute_force(evidence: Columns) -> dict[Model, float]:
    """Probability of every model."""
    models = list(models_of(evidence.blocks))
    logs = []
    for model in models:
        prior = sum(
            np.log(b.prior_odds / (1.0 + b.prior_odds)) if b.name in model else -np.log1p(b.prior_odds)
            for b in evidence.blocks
        )
        logs.append(evidence.posterior(model).log_evidence + prior)
    weights = np.exp(np.array(logs) - max(logs))
    return dict(zip(models, (weights / weights.sum()).tolist(), strict=True))


def drawn(
    blocks: tuple[Block, ...], truth: dict[str, tuple[float, ...]], seed: int, n: int = 60, size: float = 1.0
) -> Columns:
    """Random columns of root mean square `size`, and the data that `truth` makes of them."""
    rng = np.random.default_rng(seed)
    columns = {b.name: size * rng.normal(size=(n, len(b.sd))) for b in blocks}
    y = rng.normal(size=n)
    for name, amplitudes in truth.items():
        y = y + columns[name] @ np.array(amplitudes)
    return Columns(blocks, columns, y)
