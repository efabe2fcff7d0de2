"""Centres of rings: magnetometer readings while the body turns about a vertical body axis.

A ring is a circle of the true field. Every estimate but the extremes therefore uses samples that an approximate matrix
has mapped back to that circle (METHODS S3). The mean is best for an even turn and biased for an uneven one; a fitted
circle is insensitive to that.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.errors import UndeterminedError
from mavcal.calib.fit import AXES

Array = NDArray[np.float64]

CENTRES = ("circle", "mean", "thinned", "minmax", "4", "3", "2")
"""Methods to find the centre of a ring, the best first."""

FEWEST_OF_CIRCLE = 8
"""Samples below which no circle is fitted."""

LABELS = "x-down, x-up, y-down, y-up, z-down, z-up"

_CLEAR = np.cos(np.radians(35.0))  # a centre farther than this from an axis could belong to two faces
_LARGEST_SD = 0.2  # of a radius: an arc that leaves its centre more open than this is no ring
_SURPRISING = 16.27  # chi-square with three degrees of freedom, exceeded by chance once in a thousand


@dataclass(frozen=True, eq=False)
class Ring:
    """Samples (N, 3) of one turn, in order of time, and the signed unit vector (3,) of the body that pointed down."""

    samples: Array
    down: Array


@dataclass(frozen=True, eq=False)
class Circle:
    """Circle fitted to a ring of corrected samples: centre (3,), radius, and how each sample moves the centre."""

    centre: Array
    radius: float
    height_residuals: Array
    """Heights (N,) above the plane of the ring, which is tilted like the face."""
    radial_residuals: Array
    """Distances (N,) from the circle within the plane, positive outside."""
    outward: Array
    """Unit vectors (N, 3) from the axis to the sample."""
    influence: Array
    """(N, 3): movement of the centre within the plane by one radial residual."""
    height_weights: Array
    """(N,): share of each sample in the height of the centre."""
    spread: float
    """Largest standard deviation of the centre in units of that of one radial residual."""


@dataclass(frozen=True, eq=False)
class Centre:
    """The centre (3,) of a ring in the unit of the samples, and its covariance (3, 3) for noise of variance one."""

    value: Array
    covariance: Array
    surprise: Array
    """Distance (3,) from the centre of the fitted circle, if significant because of an uneven turn; else 0."""


def plane_of(down: Array) -> Array:
    """Unit vectors (3, 2) across the axis of the body that is `down`."""
    return np.eye(3)[:, down == 0.0]


def fit_circle(points: Array, down: Array) -> Circle | None:
    """The circle about `down` through corrected `points` (N, 3), by Gauss and Newton on distances; None: no circle."""
    if len(points) < FEWEST_OF_CIRCLE:
        return None
    plane = plane_of(down)
    flat = points @ plane
    middle = flat.mean(axis=0)
    size = math.sqrt(float(((flat - middle) ** 2).sum(axis=1).mean()))
    if not size > 0.0:
        return None
    x = (flat - middle) / size
    rows = np.column_stack([2.0 * x, np.ones(len(x))])
    start, _, rank, _ = np.linalg.lstsq(rows, (x**2).sum(axis=1), rcond=1e-9)
    square = float(start[2] + start[:2] @ start[:2])
    if rank < 3 or square <= 0.0:
        return None
    solved = _newton(x, np.append(start[:2], math.sqrt(square)))
    if solved is None:
        return None
    parameters, outward, radial, inverse = solved
    design = np.column_stack([outward, np.ones(len(x))])
    height = points @ down
    tilted = np.column_stack([np.ones(len(x)), x - parameters[:2]])
    solve = np.linalg.pinv(tilted)
    heights = solve @ height
    return Circle(
        centre=plane @ (middle + size * parameters[:2]) + heights[0] * down,
        radius=size * float(parameters[2]),
        height_residuals=height - tilted @ heights,
        height_weights=solve[0],
        radial_residuals=size * radial,
        outward=outward @ plane.T,
        influence=(design @ inverse)[:, :2] @ plane.T,
        spread=math.sqrt(float(np.linalg.eigvalsh(inverse[:2, :2])[-1])),
    )


def _newton(x: Array, parameters: Array) -> tuple[Array, Array, Array, Array] | None:
    """Centre and radius, outward unit vectors, residuals and ``(J^T J)^-1`` of a circle; None if it diverges."""
    for _ in range(30):
        from_centre = x - parameters[:2]
        distance = np.maximum(np.hypot(from_centre[:, 0], from_centre[:, 1]), 1e-12)
        outward = from_centre / distance[:, None]
        radial = distance - parameters[2]
        design = np.column_stack([outward, np.ones(len(x))])
        normal = design.T @ design
        if np.linalg.cond(normal) > 1e8:
            return None
        step = np.linalg.solve(normal, design.T @ radial)
        if np.abs(step).max() < 1e-12:
            break
        parameters = parameters + step
        if not np.abs(parameters).max() < 50.0:
            return None
    return parameters, outward, radial, np.asarray(np.linalg.inv(normal))


def is_round(circle: Circle | None, noise_sd: float) -> bool:
    """Whether the samples of `circle` determine its centre, for radial noise of `noise_sd`."""
    return circle is not None and circle.spread * max(noise_sd, 1e-9 * circle.radius) < _LARGEST_SD * circle.radius


def centre_of(ring: Ring, way: str, matrix: Array, circle: Circle | None, noise_sd: float) -> Centre:
    """The centre of one ring.

    Parameters
    ----------
    ring
        The samples and the axis that was down.
    way
        One of :data:`CENTRES`.
    matrix : shape (3, 3)
        Takes samples to the corrected space, in which `circle` lies.
    circle
        None: there is none, and the mean stands in for it.
    noise_sd
        Of a sample, to judge whether a turn was uneven.
    """
    back = np.asarray(np.linalg.inv(matrix), dtype=np.float64)
    reference = None if circle is None else _circle_centre(ring, matrix, back, circle)
    if way == "circle" and reference is not None:
        return reference
    about = back @ circle.centre if circle is not None else ring.samples.mean(axis=0)
    weights = _weights(ring, way, matrix, about)
    if weights is not None:
        value, covariance = weights @ ring.samples, float(weights @ weights) * np.eye(3)
        if way == "thinned" and reference is not None:
            covariance = reference.covariance  # angles about the circle's centre inherit its error
    else:
        value = 0.5 * (ring.samples.min(axis=0) + ring.samples.max(axis=0))
        covariance = _extremes_covariance(ring, circle, back, noise_sd)
    surprise = np.zeros(3)
    if reference is not None and noise_sd > 0.0:
        apart = value - reference.value
        expected = (covariance + reference.covariance) * noise_sd**2
        if apart @ np.linalg.solve(expected, apart) > _SURPRISING:
            surprise = apart
    return Centre(value, covariance, surprise)


def _circle_centre(ring: Ring, matrix: Array, back: Array, circle: Circle) -> Centre:
    """The centre is linear in the errors of the samples: ``sum V (a n^T + w k k^T) W e``."""
    along = circle.height_weights[:, None, None] * np.outer(ring.down, ring.down)
    by_sample = circle.influence[:, :, None] * circle.outward[:, None, :] + along
    linear = back @ by_sample @ matrix
    return Centre(back @ circle.centre, np.einsum("nij,nkj->ik", linear, linear), np.zeros(3))


def _weights(ring: Ring, way: str, matrix: Array, about: Array) -> Array | None:
    """Weights (N,) of the samples whose weighted mean is the centre; None for the extremes."""
    n = len(ring.samples)
    if way in {"mean", "circle"}:
        return np.full(n, 1.0 / n)
    if way == "minmax":
        return None
    plane = plane_of(ring.down)
    flat = (ring.samples - about) @ matrix.T @ plane
    angle = np.arctan2(flat[:, 1], flat[:, 0])
    if way == "thinned":
        return _spans(angle) / (2.0 * math.pi)
    wanted = angle[0] + 2.0 * math.pi * np.arange(int(way)) / int(way)
    apart = np.abs(np.remainder(angle[None, :] - wanted[:, None] + math.pi, 2.0 * math.pi) - math.pi)
    weights = np.zeros(n)
    np.add.at(weights, apart.argmin(axis=1), 1.0 / int(way))
    return weights


def _spans(angle: Array) -> Array:
    """The angle (N,) represented by each sample, half way to its neighbours: equal-angle weights without bins."""
    order = np.argsort(angle)
    gaps = np.diff(angle[order], append=angle[order[0]] + 2.0 * math.pi)
    spans = np.empty(len(angle))
    spans[order] = 0.5 * (gaps + np.roll(gaps, 1))
    return spans


def _extremes_covariance(ring: Ring, circle: Circle | None, back: Array, noise_sd: float) -> Array:
    """Covariance of the middle between two extremes of noise: ``pi^2 / (24 ln n)`` of its variance (Gumbel), n near.

    Along the plane only those within a standard deviation of the extreme compete, ``n sqrt(2 s / R) / pi`` of them.
    """
    n = len(ring.samples)
    radius = float(np.cbrt(abs(np.linalg.det(back)))) * (0.0 if circle is None else circle.radius)
    near = n * math.sqrt(2.0 * noise_sd / radius) / math.pi if radius > 0.0 else 0.0
    along, across = (math.pi**2 / (24.0 * math.log(max(count, 3.0))) for count in (float(n), near))
    return np.asarray(along * np.outer(ring.down, ring.down) + across * (np.eye(3) - np.outer(ring.down, ring.down)))


def faces_of(centres: Array, stated: Sequence[Array | None]) -> Array:
    """Signed unit vectors (K, 3) along the axis that pointed down in each ring.

    Parameters
    ----------
    centres : shape (K, 3)
        Of the rings, roughly.
    stated
        The vector that a label says; all of them or none count. None: the side of the middle on which the centre lies.
        That holds where the field points down and the sensor's axes are nearly those of the body.

    Raises
    ------
    UndeterminedError
        If labels are missing and the centres do not tell, or a face is missing.
    """
    known = [direction for direction in stated if direction is not None]
    faces = np.array(known) if len(known) == len(stated) else _faces_by_centres(centres)
    missing = [
        f"{AXES[axis]}-{'down' if side > 0.0 else 'up'}"
        for axis in range(3)
        for side in (1.0, -1.0)
        if not (faces[:, axis] == side).any()
    ]
    if missing:
        raise UndeterminedError(
            f"{len(faces)} rings, and none of them is {', '.join(missing)}",
            remedy="turn the vehicle once around with every axis down and up in turn, and label the rings "
            f"(column segment: {LABELS})",
        )
    return faces


def _faces_by_centres(centres: Array) -> Array:
    from_middle = centres - 0.5 * (centres.max(axis=0) + centres.min(axis=0))
    length = np.linalg.norm(from_middle, axis=1)
    axis = np.abs(from_middle).argmax(axis=1)
    along = from_middle[np.arange(len(axis)), axis]
    clear = np.abs(along) > _CLEAR * length
    if not clear.all():
        ring = int(np.flatnonzero(~clear)[0])
        raise UndeterminedError(
            f"ring {ring + 1} of {len(centres)} could belong to two faces: its centre lies between the axes",
            remedy=f"label the rings (column segment: {LABELS}), or state their order",
        )
    faces = np.zeros_like(centres)
    faces[np.arange(len(axis)), axis] = np.sign(along)
    return faces
