"""What the search needs: blocks that a model may contain, and the posterior of any set of them.

Nothing here knows what a block means. A :class:`Posterior` has the marginal likelihood of the data under one set of
blocks. Every amplitude is integrated out under its prior (Laplace where the model is not linear).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.inference.quadratic import Quadratic

Array = NDArray[np.float64]
Model = frozenset[str]
"""The names of the blocks that are in."""


@dataclass(frozen=True)
class Block:
    """One effect: its prior odds, the spread of its amplitudes, and which blocks it excludes.

    `prior_odds` are the odds of being in the model; `sd` (k,) the prior standard deviations of its k amplitudes.
    `nameless` blocks stand for what no named one explains. Two of the same `exclusive` group are never in one model.
    """

    name: str
    sd: tuple[float, ...]
    prior_odds: float
    nameless: bool = False
    exclusive: str = ""


@dataclass(frozen=True, eq=False)
class Posterior:
    """One model after the data: log of the marginal likelihood, amplitudes (K,) and their covariance (K, K).

    `places` gives the position of each block's amplitudes; the rest are parameters that every model has.
    """

    log_evidence: float
    amplitudes: Array
    covariance: Array
    places: Mapping[str, slice] = field(default_factory=dict)

    def of(self, block: str) -> tuple[Array, Array]:
        """Amplitudes (k,) and covariance (k, k) of one block."""
        where = self.places[block]
        return self.amplitudes[where], self.covariance[where, where]


class Evidence(Protocol):
    """The data: the posterior of any model."""

    @property
    def blocks(self) -> tuple[Block, ...]:
        """All blocks that a model may contain."""

    def posterior(self, model: Model) -> Posterior:
        """Posterior of the model with these blocks."""

    def refined(self, model: Model) -> Evidence:
        """The same data expanded about that model's best point."""


Map = Callable[[Array], tuple[Array, Array]]
"""From the amplitudes (K,) of a model to the parameters (P,) of one record, with their derivative (P, K)."""


@dataclass(frozen=True, eq=False)
class Term:
    """One record: what it says of its own parameters, and how these follow from the amplitudes of a model."""

    says: Quadratic
    parameters: Map


_ROUNDS: Final = 20
_SETTLED: Final = 1e-5
"""Gain of a further step, nats, below which the iteration has converged."""
_SHORTEST: Final = 1e-3


def laplace(terms: Iterable[Term], start: Array, prior_mean: Array, prior_sd: Array) -> tuple[float, Array, Array]:
    """Log of the integral over all amplitudes, the best ones (K,) and their covariance (K, K).

    Gauss-Newton about the best point; exact where the parameters are linear in the amplitudes. The priors are normal
    and independent. Raises LinAlgError if the curvature is singular even with the priors.
    """
    terms, z = tuple(terms), start.copy()
    best, slope, hessian = _expanded(terms, z, prior_mean, prior_sd)
    for _ in range(_ROUNDS):
        step = np.linalg.solve(hessian, slope)
        gain, part = 0.5 * float(slope @ step), 1.0
        if gain < _SETTLED:
            break
        while part > _SHORTEST:
            found = _expanded(terms, z + part * step, prior_mean, prior_sd)
            if found[0] > best:
                break
            part *= 0.5
        else:
            break
        z = z + part * step
        best, slope, hessian = found
    _, logdet = np.linalg.slogdet(hessian * np.outer(prior_sd, prior_sd))
    return best - 0.5 * float(logdet), z, np.asarray(np.linalg.inv(hessian))


def _expanded(terms: tuple[Term, ...], z: Array, mean: Array, sd: Array) -> tuple[float, Array, Array]:
    """Log of likelihood times prior at `z`, its gradient and its curvature."""
    off = (z - mean) / sd
    value, slope, hessian = -0.5 * float(off @ off), -off / sd, np.diag(sd**-2.0)
    for term in terms:
        theta, jacobian = term.parameters(z)
        value += term.says.at(theta)
        slope = slope + jacobian.T @ term.says.slope(theta)
        hessian = hessian + jacobian.T @ term.says.curvature @ jacobian
    return value, slope, hessian
