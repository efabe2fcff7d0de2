"""Sensors whose bias wanders in a known way, calibrated a few times, and followed until they leave their limit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.fleet.observation import BiasObservation
from mavcal.calib.fleet.trend import DAY_S, HORIZON_D, YEAR_D, Slope, bias_trend

Array = NDArray[np.float64]

LIMIT = 0.5
"""deg/s, that of gyroscopes; everything here is in this unit."""


@dataclass(frozen=True)
class Wander:
    """A way to wander: drift a year, walk over a year's root, scatter from start to start, slope per degC."""

    name: str
    drift: float
    walk: float
    start: float
    per_degc: float = 0.0


WANDERS = (
    Wander("a straight drift", 0.20, 0.00, 0.01),
    Wander("a random walk", 0.00, 0.20, 0.00),
    Wander("a slow random walk", 0.00, 0.05, 0.01),
    Wander("a drift with a random walk", 0.15, 0.10, 0.00),
    Wander("scatter from start to start", 0.00, 0.00, 0.05),
    Wander("a drift with both", 0.15, 0.10, 0.03),
    Wander("a drift, temperature too", 0.15, 0.05, 0.01, 0.005),
    Wander("nothing but noise", 0.00, 0.00, 0.00),
)
NOISE = 0.003
"""Standard deviation of one calibration."""


@dataclass(frozen=True)
class Held:
    """What the intervals of one sensor held."""

    date: bool
    early: bool
    """It left before the interval: the dangerous side."""
    drift: float
    """Share of the axes."""
    slope: float | None
    """The same of the slope with temperature; None: there was none."""
    dated: bool
    """The interval ends within ten years."""


def run(wander: Wander, n: int, seed: int) -> Held:
    """One sensor with `n` calibrations, 30 to 180 days apart."""
    rng = np.random.default_rng([seed, n, WANDERS.index(wander)])
    days = np.concatenate([[0.0], np.cumsum(rng.uniform(30.0, 180.0, n - 1))]).round()
    ahead = int(days[-1] + HORIZON_D) + 1
    turn = rng.standard_normal(3)
    per_year = wander.drift * turn / np.linalg.norm(turn)
    walked = np.cumsum(rng.standard_normal((ahead, 3)) * wander.walk / np.sqrt(YEAR_D), axis=0)
    lasting = np.arange(ahead)[:, None] / YEAR_D * per_year + walked
    warm = rng.uniform(10.0, 45.0, n)
    slope = wander.per_degc * rng.standard_normal(3)
    seen = []
    for day, temperature in zip(days.astype(int), warm, strict=True):
        start = wander.start * rng.standard_normal(3)
        x, y, z = lasting[day] + start + NOISE * rng.standard_normal(3) + slope * (temperature - 25.0)
        known = float(temperature) if wander.per_degc else 25.0
        seen.append(BiasObservation(day * DAY_S, (float(x), float(y), float(z)), (NOISE, NOISE, NOISE), known))
    last = int(days[-1])
    corrected = np.array(seen[-1].bias) - slope * (warm[-1] - 25.0)
    off = np.linalg.norm(lasting[last:] - corrected, axis=1)
    beyond = off > LIMIT
    truth = (last + int(beyond.argmax())) * DAY_S if beyond.any() else np.inf
    trend = bias_trend(seen, LIMIT)
    assert trend.leaving is not None
    assert trend.per_year is not None
    low = np.inf if trend.leaving.earliest is None else trend.leaving.earliest
    high = np.inf if trend.leaving.latest is None else trend.leaving.latest
    return Held(
        bool(low <= truth <= high),
        bool(truth < low),
        _share(trend.per_year, per_year),
        None if trend.per_degc is None else _share(trend.per_degc, slope),
        bool(np.isfinite(high)),
    )


def _share(slopes: tuple[Slope, Slope, Slope], truth: Array) -> float:
    return float(np.mean([s.low <= d <= s.high for s, d in zip(slopes, truth, strict=True)]))
