"""A bias over time as a line, a slope with temperature, a random walk and a scatter from start to start.

``y_i = a + d t_i + s (T_i - T_0) + w(t_i) + v_i + e_i`` for each axis: `w` is a random walk, `v` what differs from
start to start, `e` the measurement's own noise with its known standard deviation. How large `w` and `v` are is not
known; it is integrated over on a grid, with the marginal likelihood of all three axes together. The prior is
log-uniform in their size, and leans to the walk, which foretells worse.

The prior of the drift decides what a few measurements predict (decision 22). If every drift is as
likely as any other, none is ever zero, and every sensor leaves its limit. If its typical size is unknown, zero is near.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SHARES = np.array([0.0, 0.25, 0.5, 0.75, 1.0])
"""Share of the walk in what scatters, over one mean interval between measurements."""
LEAN = np.array([0.01, 0.01, 0.03, 0.1, 0.85])
"""Prior of the shares."""
SIZES = np.geomspace(0.1, 20.0, 17)
"""Standard deviation of what scatters, in those of the residuals."""
LEAST_NOISE = 0.02
"""A measurement is no better than that, in residuals: a smaller one would only make the matrices worse."""
DRIFTS, LEAST_DRIFT, MOST_DRIFT = 10, 0.03, 10.0
"""Grid of the typical change over the whole span: from so many residuals to so many times what a plain line finds."""


class Belief(StrEnum):
    """What is believed of a drift before anything is measured."""

    ANY = "any"  # every drift is as likely as every other one
    SOME = "some"  # it has a typical size, and nothing is known about it


@dataclass(frozen=True, eq=False)
class Draws:
    """Joint draws of what the measurements leave open; arrays have shape (draws,) or (draws, 3)."""

    now: Array
    """The lasting part of the bias at the last measurement and the reference temperature, shape (draws, 3)."""
    per_day: Array
    """Its drift, shape (draws, 3)."""
    per_degc: Array | None
    """Its slope with temperature, shape (draws, 3); None: not among the unknowns."""
    walk: Array
    """Variance of the random walk over one day, shape (draws,)."""


@dataclass(frozen=True, eq=False)
class Measured:
    """Measurements of one sensor in the order of time: more of them than unknowns, over more than one instant."""

    days: Array
    """Shape (n,)."""
    bias: Array
    """Shape (n, 3)."""
    sd: Array
    """One axis, shape (n,)."""
    warmth: Array | None
    """Temperature above the reference one, degC, shape (n,); None: it is left out."""


def draw(seen: Measured, belief: Belief, rng: np.random.Generator, count: int) -> Draws:
    """Draw from what the measurements leave open."""
    days, bias, sd, warmth = seen.days, seen.bias, seen.sd, seen.warmth
    span = float(days[-1] - days[0])
    columns = [np.ones(len(days)), (days - days[-1]) / span]
    if warmth is not None:
        columns.append(warmth / 10.0)
    design = np.stack(columns, axis=1)
    gap = span / (len(days) - 1)
    walks = np.minimum(days[:, None], days) - days[0]
    size, change = _scales(design, bias, sd)
    noise = np.maximum(sd, LEAST_NOISE * size) ** 2
    shares, sizes = (grid.ravel() for grid in np.meshgrid(SHARES, SIZES * size, indexing="ij"))
    shaped = shares[:, None, None] * walks / gap + (1.0 - shares)[:, None, None] * np.eye(len(days))
    covariance = sizes[:, None, None] ** 2 * shaped + np.diag(noise)
    solved = np.linalg.inv(covariance)
    drifts = np.geomspace(LEAST_DRIFT * size, MOST_DRIFT * max(change, size), DRIFTS)
    precisions = np.zeros(1) if belief is Belief.ANY else drifts**-2.0
    weight, best, spread = _lines(design, bias - bias[-1], covariance, solved, precisions)
    drawn = rng.choice(weight.size, size=count, p=weight.ravel() / weight.sum())
    cell = drawn // len(precisions)
    factor = np.linalg.cholesky(spread).reshape(-1, *spread.shape[2:])[drawn]
    unknown = best.reshape(-1, *best.shape[2:])[drawn] + factor @ rng.standard_normal((count, design.shape[1], 3))
    unknown[:, 0] += bias[-1]
    # the walk at the last measurement, given the line
    power = sizes**2 * shares / gap
    towards = power[:, None] * walks[:, -1]
    gain = np.einsum("ci,cij->cj", towards, solved)
    rest = np.sqrt(np.clip(power * walks[-1, -1] - np.einsum("ci,ci->c", gain, towards), 0.0, None))
    walked = (gain @ bias)[cell] - np.einsum("dk,dka->da", (gain @ design)[cell], unknown)
    walked += rest[cell, None] * rng.standard_normal((count, 3))
    per_degc = None if warmth is None else unknown[:, 2] / 10.0
    return Draws(unknown[:, 0] + walked, unknown[:, 1] / span, per_degc, power[cell])


def _lines(
    design: Array, bias: Array, covariance: Array, solved: Array, precisions: Array
) -> tuple[Array, Array, Array]:
    """Weight of every cell and precision of the drift's prior, with the line's mean and covariance in each."""
    prior = np.zeros((len(precisions), design.shape[1], design.shape[1]))
    prior[:, 1, 1] = precisions
    information = (design.T @ solved @ design)[:, None] + prior
    spread = np.linalg.inv(information)
    spread = 0.5 * (spread + np.swapaxes(spread, -1, -2))
    towards = (design.T @ solved @ bias)[:, None]
    best = spread @ towards
    misfit = np.einsum("ia,cij,ja->c", bias, solved, bias)[:, None] - np.einsum("cdua,cdua->cd", best, towards)
    scatter = _logdet(covariance)[:, None] + _logdet(information) - np.log(np.where(precisions > 0.0, precisions, 1.0))
    lean = np.log(np.repeat(LEAN, len(SIZES)))[:, None]
    log_weight = lean - 0.5 * (3.0 * scatter + misfit)
    weight: Array = np.exp(log_weight - log_weight.max())
    return weight, best, np.asarray(spread, dtype=np.float64)


def _scales(design: Array, bias: Array, sd: Array) -> tuple[float, float]:
    """Standard deviation of what a plain line leaves, or of the measurements if larger; its change over the span."""
    line = np.linalg.lstsq(design, bias, rcond=None)[0]
    free = max(3 * (len(bias) - design.shape[1]), 1)
    found = max(float(np.sqrt(((bias - design @ line) ** 2).sum() / free)), float(np.median(sd)), 1e-12)
    return found, float(np.linalg.norm(line[1]))


def _logdet(matrices: Array) -> Array:
    return np.asarray(np.linalg.slogdet(matrices)[1], dtype=np.float64)
