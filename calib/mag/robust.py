"""Start values and noise estimates that withstand outliers."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mavcal.calib.errors import UndeterminedError
from mavcal.calib.mag.distance import Distances, Pass
from mavcal.calib.mag.moments import Moments
from mavcal.calib.mag.samples import Array, Cloud
from mavcal.calib.mag.shape import Ellipsoid, MagModel
from mavcal.calib.mag.simple_fits import solve_sphere

MAD_TO_SD = 1.4826
"""Standard deviation of normal noise over its median absolute deviation."""

OUTLIER = 6.0
"""Distance in standard deviations that normal noise does not reach (2e-9)."""

MOST_OUTLIERS = 0.3
"""Fraction of outliers above which the samples are refused, since the majority is no longer clear."""

_SMALLEST_SD = 1e-9  # of the radius: exact data have no noise, only rounding
_TRIM = 3.0
_TRIMMED_SD = 0.98658  # sd of a standard normal cut at 3
_ROUNDS = 12
_TRIALS = 150  # a tenth of the subsets is clean at 20 % of outliers, one in twenty at 25 %
_SCORED = 300
_MAJORITY = 1 << 15  # samples that are enough to know where the majority lies
_PLAUSIBLE = 0.02  # of the radius: noise that a compass has; beyond, outliers may hide in the majority's spread
_ROUND = 1.5  # longest radius over shortest: beyond, a few far samples may bend the ellipsoid through themselves
_PART = 0.2  # of the radius: samples that cover a sphere lie a whole radius from their middle
_MANY = 0.1  # fraction of outliers from which on the concentration steps are not trusted alone
_CLEARLY = 0.7  # noise left by another start, relative, from which on that one is taken


@dataclass(frozen=True, eq=False)
class Start:
    """Starting point of the iteration."""

    ellipsoid: Ellipsoid
    noise_sd: float
    outliers: bool
    """Whether some samples deviate by more than noise can."""
    first: Pass | None = None
    """The pass over the samples at `ellipsoid` with the variance of `noise_sd`; None: it was not made."""


def find_start(cloud: Cloud, whole: Moments, smallest_sd: float, model: MagModel = MagModel.SYMMETRIC) -> Start:
    """An ellipsoid of the form `model` near the majority of `cloud`, in its scale; `whole` are its moments.

    Adjusted least squares on all samples; with outliers, repeatedly on those within three standard deviations. If too
    many drop out, or if a distant sample may have attracted the first ellipsoid, the best of many small subsets is
    tried.

    Raises
    ------
    UndeterminedError
        If there is no start, not even a sphere.
    """
    floor = max(_SMALLEST_SD, smallest_sd)
    first, noise_sd = _first_guess(cloud, whole, model)
    at_first = Distances(cloud).at(first, noise_sd**2, None)
    residuals = at_first.residuals
    sd = robust_sd(residuals[:: max(1, len(residuals) // _MAJORITY)], floor)
    clean = max(float(residuals.max()), -float(residuals.min())) <= OUTLIER * sd
    fits = clean and (sd <= _PLAUSIBLE * first.mean_radius or _looks_normal(residuals))
    bent = first.radii[2] > _ROUND * first.radii[0] or _swollen(cloud, first)
    best, plain = first, Start(first, noise_sd, outliers=False, first=at_first)
    if fits and not bent:
        return plain
    if not clean:
        best, sd = _concentrated(cloud, first, floor, model)
    spread = sd > _PLAUSIBLE * best.mean_radius
    if bent or spread or np.mean(np.abs(distances_from(cloud, best)) > OUTLIER * sd) > _MANY:
        other, other_sd = _concentrated(cloud, _consensus(cloud, best, model), floor, model)
        if other_sd < _CLEARLY * sd:
            best, sd = other, other_sd
    if fits and best is first:
        return plain
    residuals = distances_from(cloud, best)
    return Start(best, sd, outliers=bool(np.abs(residuals).max() > OUTLIER * sd))


def _swollen(cloud: Cloud, ellipsoid: Ellipsoid) -> bool:
    """Whether most samples lie in a small part of `ellipsoid`, which distant ones may have stretched."""
    seen = cloud.take(slice(None, None, max(1, len(cloud) // _MAJORITY))).scaled()
    return float(np.median(np.linalg.norm(seen - np.median(seen, axis=0), axis=1))) < _PART * ellipsoid.mean_radius


def _looks_normal(residuals: Array) -> bool:
    """Whether the fourth moment is that of plain noise within four standard deviations, ``sqrt(24/N)`` each."""
    squares = residuals * residuals
    variance = float(squares.mean())
    return abs(float(squares @ squares) / len(squares) / variance**2 - 3.0) <= 4.0 * math.sqrt(24.0 / len(squares))


def _first_guess(cloud: Cloud, whole: Moments, model: MagModel) -> tuple[Ellipsoid, float]:
    """Adjusted least squares and their noise; a sphere if these give no plausible ellipsoid."""
    try:
        ellipsoid, noise_sd = whole.ellipsoid(model)
        if _is_sensible(ellipsoid):
            return ellipsoid, noise_sd
    except UndeterminedError:
        pass
    offset, radius = solve_sphere(cloud.scaled())
    sphere = Ellipsoid(offset, radius * np.eye(3))
    return sphere, robust_sd(distances_from(cloud, sphere), _SMALLEST_SD)


def _is_sensible(ellipsoid: Ellipsoid) -> bool:
    radii = ellipsoid.radii
    return bool(radii[2] < 20.0 * radii[0] and radii[2] < 20.0)


def distances_from(cloud: Cloud, ellipsoid: Ellipsoid) -> Array:
    """Signed distances (N,) of `cloud` from `ellipsoid`, in its scale."""
    return Distances(cloud).at(ellipsoid, 0.0, None).residuals


def robust_sd(residuals: Array, floor: float) -> float:
    """Standard deviation of the majority: median absolute deviation, then the rms within three of it."""
    sd = max(MAD_TO_SD * float(np.median(np.abs(residuals))), floor)
    for _ in range(3):
        inside = residuals[np.abs(residuals) <= _TRIM * sd]
        sd = max(float(np.sqrt(np.mean(inside**2))) / _TRIMMED_SD, floor) if len(inside) else sd
    return sd


def _ellipsoid_of(cloud: Cloud, model: MagModel) -> Ellipsoid | None:
    try:
        ellipsoid, _ = Moments.of(cloud).ellipsoid(model)
    except UndeterminedError:
        return None
    return ellipsoid if _is_sensible(ellipsoid) else None


def _concentrated(cloud: Cloud, ellipsoid: Ellipsoid, floor: float, model: MagModel) -> tuple[Ellipsoid, float]:
    """Refit to what lies within three standard deviations until that set stays (Rousseeuw's concentration steps).

    A subset represents many samples; the final fit uses them all.
    """
    cloud = cloud.take(slice(None, None, max(1, len(cloud) // _MAJORITY)))
    distances = Distances(cloud)
    kept = np.zeros(len(cloud), dtype=np.bool_)
    for _ in range(_ROUNDS):
        residuals = distances.at(ellipsoid, 0.0, None).residuals
        sd = max(MAD_TO_SD * float(np.median(np.abs(residuals))), floor)
        inside = np.abs(residuals) <= _TRIM * sd
        if np.array_equal(inside, kept):
            break
        kept = inside
        refit = _ellipsoid_of(cloud.take(kept), model)
        if refit is None:
            break
        ellipsoid = refit
    return ellipsoid, robust_sd(distances.at(ellipsoid, 0.0, None).residuals, floor)


def _consensus(cloud: Cloud, fallback: Ellipsoid, model: MagModel) -> Ellipsoid:
    """The ellipsoid through a few random samples that is nearest to the majority (least median; fixed seed)."""
    rng = np.random.default_rng(20)
    scored = cloud if len(cloud) <= _SCORED else cloud.take(rng.choice(len(cloud), _SCORED, replace=False))
    distances = Distances(scored)
    best, least = fallback, float(np.median(np.abs(distances.at(fallback, 0.0, None).residuals)))
    for _ in range(_TRIALS):
        candidate = _ellipsoid_of(cloud.take(rng.choice(len(cloud), model.size + 1, replace=False)), model)
        if candidate is not None:
            median = float(np.median(np.abs(distances.at(candidate, 0.0, None).residuals)))
            if median < least:
                best, least = candidate, median
    return best
