"""Plain least squares of an injected effect."""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy.optimize import minimize_scalar

from mavcal.calib.gap.effects.base import MeanEffect
from mavcal.calib.gap.problem import Trace


def with_measured(trace: Trace, measured: np.ndarray) -> Trace:
    return dataclasses.replace(trace, measured=measured)


def noisy(trace: Trace, change: np.ndarray, sigma: float, seed: int) -> Trace:
    noise = np.random.default_rng(seed).normal(0.0, sigma, trace.ideal.shape)
    return with_measured(trace, trace.ideal + change + noise)


def amplitudes(effect: MeanEffect, trace: Trace, theta: float) -> tuple[np.ndarray, np.ndarray, float]:
    """Amplitudes, their sd per unit noise, and the sum of squares that is left."""
    X = effect.columns(trace, theta).reshape(-1, trace.ideal.size).T
    y = trace.residual.ravel()
    if effect.fixed:
        return np.ones(1), np.zeros(1), float(((y - X[:, 0]) ** 2).sum())
    beta = np.linalg.lstsq(X, y, rcond=1e-9)[0]
    sd = np.sqrt(np.diag(np.linalg.pinv(X.T @ X)))
    return beta, sd, float(((y - X @ beta) ** 2).sum())


def fitted(effect: MeanEffect, trace: Trace) -> tuple[float, np.ndarray, np.ndarray]:
    """Shape's value, amplitudes and their sd per unit noise: grid, then refined between neighbours."""
    if effect.shape is None:
        beta, sd, _ = amplitudes(effect, trace, np.nan)
        return np.nan, beta, sd
    grid = effect.shape.grid(trace)
    tried = grid if effect.shape.screen is None else effect.shape.screen(trace, trace.residual)
    best = tried[int(np.argmin([amplitudes(effect, trace, th)[2] for th in tried]))]
    at = int(np.searchsorted(grid, best))
    low, high = grid[max(at - 1, 0)], grid[min(at + 1, len(grid) - 1)]
    found = minimize_scalar(
        lambda th: amplitudes(effect, trace, th)[2],
        bounds=(low, high),
        method="bounded",
        options={"xatol": 1e-7 * max(abs(low), abs(high))},
    )
    beta, sd, _ = amplitudes(effect, trace, found.x)
    return float(found.x), beta, sd
