"""How severe an effect is: lambda, the information that the data hold against its absence.

``lambda = sum (delta / sigma)^2`` of the noise-free difference with and without, and for what is random twice the
Kullback-Leibler divergence, which is the same thing for a mean: the expected 2 log likelihood ratio.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from mavcal.calib.blind.missions import World
from mavcal.calib.blind.sensors import Effect, Suite, at_samples, mean_signal

Array = NDArray[np.float64]

LOWEST, HIGHEST = 20.0, 2000.0


def severity(world: World, suite: Suite, effect: Effect) -> float:
    """Lambda of one effect alone."""
    return sum(
        float(np.sum(difference(world, suite, effect, s) ** 2)) / suite[s].variance
        + effect.information(world, s, suite[s])
        for s in effect.sensors
    )


def difference(world: World, suite: Suite, effect: Effect, sensor: str) -> Array:
    """Noise-free signal with the effect minus without, at the sensor's samples."""
    with_it = at_samples(mean_signal(world, sensor, (effect,)), suite[sensor])
    return with_it - at_samples(world.truth(sensor), suite[sensor])


def net_severity(world: World, suite: Suite, effect: Effect) -> float:
    """Lambda of what a constant and a matrix on the sensor's own axes cannot imitate; the mean's part only."""
    total = 0.0
    for sensor in effect.sensors:
        truth = at_samples(world.truth(sensor), suite[sensor])
        columns = np.column_stack([np.ones(len(truth)), truth])
        delta = difference(world, suite, effect, sensor)
        left = delta - columns @ np.linalg.lstsq(columns, delta, rcond=None)[0]
        total += float(np.sum(left**2)) / suite[sensor].variance + effect.information(world, sensor, suite[sensor])
    return total


def draw_severity(rng: np.random.Generator) -> float:
    """Log-uniform over the campaign's range."""
    return math.exp(rng.uniform(math.log(LOWEST), math.log(HIGHEST)))


def with_severity(
    world: World, suite: Suite, make: Callable[[float], Effect], bounds: tuple[float, float], target: float
) -> Effect | None:
    """The effect of the size that has that lambda; None: no size within the physical `bounds` has it."""

    def excess(log_size: float) -> float:
        return math.log(max(severity(world, suite, make(math.exp(log_size))), 1e-12) / target)

    low, high = math.log(bounds[0]), math.log(bounds[1])
    if (excess(low) > 0.0) == (excess(high) > 0.0):
        return None
    return make(math.exp(brentq(excess, low, high, xtol=1e-4, rtol=1e-6, maxiter=60)))


def divergence(ratio: Array) -> float:
    """Twice the divergence of independent Gaussians whose variances are `ratio` times the nominal ones."""
    return float(np.sum(ratio - 1.0 - np.log(ratio)))
