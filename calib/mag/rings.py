"""Six rings: offset and full matrix of a magnetometer, mounting included, from turns about the vertical (METHODS S3).

With body axis k down the field runs round ``h = F (sin d k + cos d (e1 cos p + e2 sin p))``. The centre of the ring is
``b + F sin d A k``. Half the difference of the centres with an axis down and up is ``v_i = F sin d A e_i``. But for one
common factor this is a *column* of the matrix. The mean of the six centres is b. Only the vertical field is used: near
the magnetic equator the columns vanish. A face of the fixture that is not square enters at full size.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Unpack

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.errors import InvalidInputError, UndeterminedError
from mavcal.calib.fit import FitResult
from mavcal.calib.mag.context import MagContext, MagFacts
from mavcal.calib.mag.result import refusal
from mavcal.calib.mag.ring_centres import (
    CENTRES,
    FEWEST_OF_CIRCLE,
    Centre,
    Circle,
    Ring,
    centre_of,
    fit_circle,
    is_round,
)
from mavcal.calib.mag.rings_algebra import columns_of
from mavcal.calib.mag.rings_faces import faces_of
from mavcal.calib.mag.rings_result import RingsFit, rings_result
from mavcal.calib.mag.robust import MAD_TO_SD, MOST_OUTLIERS, OUTLIER
from mavcal.calib.mag.serial import variance_inflation

Array = NDArray[np.float64]

METHOD = "mag-rings"

_ROUNDS = 4  # of centres and matrix: each makes the circles rounder by the square of what was wrong
_SETTLED = 1e-12
_TRIMS = 6
_SPIKE = 4.0  # of the median distance from the middle of a ring, beyond which no turn and no noise goes
_MOST_CONDITION = 20.0  # of the columns: a matrix beyond it is noise, or no compass


def fit_rings(
    rings: Sequence[Array],
    downs: Sequence[Array | None],
    *,
    centre: str = "circle",
    fixture_sd: float = 0.0,
    diameter: float | None = None,
    **facts: Unpack[MagFacts],
) -> FitResult:
    """Offset and full matrix from rings about the vertical, each axis of the body once down and once up.

    Parameters
    ----------
    rings
        Samples (N, 3) of each turn, in order of time.
    downs
        The axis of the body that pointed down in each ring: a signed unit vector (3,). None: seen from the centres.
    centre
        One of :data:`calib.mag.ring_centres.CENTRES`; what is not ``circle`` is tested against the circle.
    fixture_sd
        Tilt of every face about each horizontal axis, standard deviation in degrees; part of the covariance.
    diameter
        Length of a corrected diameter, in whatever unit: twice the field strength. None: the field's, else det C = 1.
    **facts
        What is known of sensor and field: :class:`calib.mag.result.MagContext`.

    Returns
    -------
    FitResult
        ``native`` holds the centres, the columns with their homogeneous 4 x 4 matrix, and the published variant. Near
        the magnetic equator the offset alone is determined.

    Raises
    ------
    InvalidInputError
        If samples have another shape or are not finite, or an option is impossible.
    """
    context = MagContext(**facts)
    _check(rings, downs, centre, fixture_sd, diameter)
    samples = [np.asarray(ring, dtype=np.float64) for ring in rings]
    total = sum(len(ring) for ring in samples)
    try:
        kept = _turned(samples)
        faces = faces_of(np.array([0.5 * (r.max(axis=0) + r.min(axis=0)) for r in kept]), downs)
        fit = _without_outliers([Ring(s, k) for s, k in zip(kept, faces, strict=True)], centre, fixture_sd)
    except UndeterminedError as error:
        return refusal(METHOD, error, total, context)
    return rings_result(METHOD, fit, context, diameter, total)


def _check(
    rings: Sequence[Array], downs: Sequence[Array | None], centre: str, fixture_sd: float, diameter: float | None
) -> None:
    if len(rings) != len(downs):
        raise InvalidInputError(f"{len(downs)} directions for {len(rings)} rings: one each is needed")
    if centre not in CENTRES:
        raise InvalidInputError(f"the centre is one of {', '.join(CENTRES)}, not {centre!r}")
    if not (math.isfinite(fixture_sd) and fixture_sd >= 0.0):
        raise InvalidInputError(f"the tilt of the fixture is a number of degrees, not {fixture_sd}")
    if diameter is not None and not (math.isfinite(diameter) and diameter > 0.0):
        raise InvalidInputError(f"the diameter of the corrected field is positive, not {diameter}")
    for number, ring in enumerate(rings):
        shape = np.shape(ring)
        if len(shape) != 2 or shape[1] != 3:
            raise InvalidInputError(f"ring {number + 1} has shape {shape}: (N, 3) is needed")
        if not np.isfinite(ring).all():
            raise InvalidInputError(f"ring {number + 1} has samples that are not finite: drop those rows first")


def _turned(samples: Sequence[Array]) -> list[Array]:
    """The rings, if there are six or more and the field moved in each of them.

    Raises
    ------
    UndeterminedError
        Naming what is missing.
    """
    remedy = "turn the vehicle once around, evenly, with every axis down and up in turn; one label a ring"
    if len(samples) < 6:
        raise UndeterminedError(f"{len(samples)} rings: six are needed", remedy=remedy)
    widths = [float(np.ptp(ring, axis=0).max()) if len(ring) else 0.0 for ring in samples]
    for number, ring in enumerate(samples):
        if len(ring) < 2 or widths[number] <= 1e-6 * max(widths):
            raise UndeterminedError(f"ring {number + 1} has {len(ring)} samples and does not turn", remedy=remedy)
    return list(samples)


def _without_outliers(rings: Sequence[Ring], way: str, fixture_sd: float) -> RingsFit:
    """The fit of the samples that are within :data:`OUTLIER` standard deviations of their own ring.

    Raises
    ------
    UndeterminedError
        If too many are not.
    """
    given = sum(len(ring.samples) for ring in rings)
    rings = [Ring(_without_spikes(ring.samples), ring.down) for ring in rings]
    for _ in range(_TRIMS):
        fit = _solved(rings, way, fixture_sd)
        kept = [_inside(rows) for rows in fit.residuals_by_ring()]
        if all(k.all() for k in kept):
            break
        rings = [Ring(r.samples[k], r.down) if len(k) else r for r, k in zip(rings, kept, strict=True)]
    left = sum(len(ring.samples) for ring in rings)
    if left < (1.0 - MOST_OUTLIERS) * given:
        raise UndeterminedError(
            f"{given - left} of {given} magnetometer samples lie off their rings",
            remedy="find what disturbs the field (motors, steel, a phone nearby), turn steadily, and repeat",
        )
    return fit


def _without_spikes(samples: Array) -> Array:
    """The samples that are not many times as far from the middle of the ring as most."""
    if len(samples) < FEWEST_OF_CIRCLE:
        return samples
    far = np.linalg.norm(samples - np.median(samples, axis=0), axis=1)
    return np.asarray(samples[far <= _SPIKE * np.median(far)])


def _inside(residuals: Array) -> NDArray[np.bool_]:
    """Which rows (N, 2) are no outliers: none where the ring has no circle."""
    if not len(residuals):
        return np.zeros(0, dtype=np.bool_)
    sd = MAD_TO_SD * np.median(np.abs(residuals), axis=0)
    quiet = np.maximum(sd, 1e-9 * np.abs(residuals).max())
    return np.asarray((np.abs(residuals) <= OUTLIER * np.maximum(quiet, quiet.max() / 3.0)).all(axis=1))


def _solved(rings: Sequence[Ring], way: str, fixture_sd: float) -> RingsFit:
    faces = np.array([ring.down for ring in rings])
    matrix: Array = np.eye(3)
    noise_sd = 0.0
    for _ in range(_ROUNDS):
        circles, noise_sd = _circles(rings, matrix, noise_sd)
        centres = [centre_of(r, way, matrix, c, noise_sd) for r, c in zip(rings, circles, strict=True)]
        offset, columns = columns_of(np.array([c.value for c in centres]), faces)
        if not np.linalg.cond(columns) < _MOST_CONDITION:
            break
        before, matrix = matrix, np.asarray(np.linalg.inv(columns), dtype=np.float64)
        if np.linalg.norm(matrix @ np.linalg.inv(before) - np.eye(3)) < _SETTLED:
            break
    residuals, dof = _residuals(rings, circles, matrix)
    inflation = 1.0
    if way in {"circle", "mean", "thinned"} and len(residuals):
        inflation = max(variance_inflation(residuals[:, 0]), variance_inflation(residuals[:, 1]))
    values = np.array([c.value for c in centres])
    closure = values - offset - faces @ columns.T
    return RingsFit(
        rings=tuple(rings),
        way=way,
        centres=values,
        covariance=_covariance(centres, faces, columns, closure, noise_sd**2 * inflation if dof else None, fixture_sd),
        offset=offset,
        columns=columns,
        circles=tuple(circles),
        residuals=residuals,
        dof=dof,
        noise_sd=noise_sd if dof else None,
        variance_inflation=inflation,
        uneven=tuple(j for j, c in enumerate(centres) if c.surprise.any()),
        fixture_sd=fixture_sd,
    )


def _circles(rings: Sequence[Ring], matrix: Array, noise_sd: float) -> tuple[list[Circle | None], float]:
    """Circles of all rings, without those that their samples leave open, and the noise of one axis of a sample."""
    found = [fit_circle(ring.samples @ matrix.T, ring.down) for ring in rings]
    residuals, dof = _residuals(rings, found, matrix)
    if dof:
        noise_sd = math.sqrt(float((residuals**2).sum()) / dof)
    gain = float(np.cbrt(abs(np.linalg.det(matrix))))
    return [c if is_round(c, noise_sd * gain) else None for c in found], noise_sd


def _residuals(rings: Sequence[Ring], circles: Sequence[Circle | None], matrix: Array) -> tuple[Array, int]:
    """Distances (N, 2) of samples from their plane and circle in the unit of the samples, and degrees of freedom."""
    pieces, dof = [np.zeros((0, 2))], 0
    for ring, circle in zip(rings, circles, strict=True):
        if circle is not None:
            along = float(np.linalg.norm(ring.down @ matrix))
            across = np.linalg.norm(circle.outward @ matrix, axis=1)
            pieces.append(np.column_stack([circle.height_residuals / along, circle.radial_residuals / across]))
            dof += 2 * len(ring.samples) - 6
    return np.concatenate(pieces), dof


def _covariance(
    centres: Sequence[Centre], faces: Array, columns: Array, closure: Array, variance: float | None, fixture_sd: float
) -> Array:
    """Covariance of the centres (3 K, 3 K): noise of each, and a tilt that all rings of a face share.

    `variance` None: no ring has samples enough to tell its noise; the disagreement of the centres tells it.
    """
    count = len(centres)
    whole = np.zeros((count, 3, count, 3))
    scatter = float((closure**2).sum()) / (3 * (count - 4))
    for j, centre in enumerate(centres):
        noise = scatter * np.eye(3) if variance is None else variance * centre.covariance
        whole[j, :, j] = noise + np.outer(centre.surprise, centre.surprise)
        across = columns @ (np.eye(3) - np.outer(faces[j], faces[j])) @ columns.T
        for other in np.flatnonzero((faces == faces[j]).all(axis=1)):
            whole[j, :, other] += math.radians(fixture_sd) ** 2 * across
    return whole.reshape(3 * count, 3 * count)
