"""Six rings: offset and full matrix of a magnetometer, mounting included, from turns about the vertical (METHODS S3).

With body axis k down the field describes the circle ``h = F (sin d k + cos d (e1 cos p + e2 sin p))``. The centre of
the ring is ``b + F sin d A k``. Half the difference of the centres with an axis down and up is ``v_i = F sin d A e_i``.
Apart from one common factor this is a *column* of the matrix. The mean of the six centres is b. Only the vertical field
is used: near the magnetic equator the columns vanish. An error of a fixture face has its full effect.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Unpack

import numpy as np
import scipy

from mavcal.calib.c_array import homogeneous
from mavcal.calib.errors import InvalidInputError, UndeterminedError
from mavcal.calib.fit import FitResult, parameter_names
from mavcal.calib.mag.result import (
    SCALE_UNKNOWN,
    UNDETERMINED_SD,
    CompassFit,
    MagContext,
    MagFacts,
    array_forms,
    compass_result,
    field_quality,
    mounting_of,
    refusal,
    with_strength_sd,
    year_warning,
)
from mavcal.calib.mag.ring_centres import CENTRES, Ring, faces_of, plane_of
from mavcal.calib.mag.ring_solve import RingsFit, by_dominant, columns_of, published, solve_rings
from mavcal.calib.stats.residuals import residual_statistics
from mavcal.calib.triad import Array, TriadModel

METHOD = "mag-rings"

NEAR_EQUATOR = (
    "rings about the vertical see the matrix through the vertical field alone, which is too weak here (near the "
    "magnetic equator, or too few samples): tilt the vehicle to all sides and use mag-ellipsoid or mag-align, or turn "
    "each ring longer"
)

_MISFIT = 0.001


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
        One of :data:`calib.mag.ring_centres.CENTRES`; methods other than ``circle`` are tested against it.
    fixture_sd
        Tilt of every face about each horizontal axis, standard deviation in degrees; part of the covariance.
    diameter
        Length of a corrected diameter, in whatever unit: twice the field strength. None: the field's, else det C = 1.
    **facts
        Known facts of sensor and field, as in :class:`calib.mag.result.MagContext`.

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
        fit = solve_rings([Ring(s, k) for s, k in zip(kept, faces, strict=True)], centre, fixture_sd)
    except UndeterminedError as error:
        return refusal(METHOD, error, total, context)
    return _result(fit, context, diameter, total)


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


@dataclass(frozen=True, eq=False)
class _Scale:
    """Conversion from the corrected space of ``V^-1`` to microtesla, with the samples in that space."""

    fit: RingsFit
    strength: float | None

    @cached_property
    def moments(self) -> tuple[tuple[int, Array, Array], ...]:
        """Number, mean and scatter of the samples of every ring."""
        samples = [ring.samples for ring in self.fit.rings]
        return tuple((len(s), s.mean(axis=0), np.cov(s.T, bias=True)) for s in samples)

    def model(self, centres: Array) -> Array:
        """Offset and matrix (12,) as a function of the centres (K, 3)."""
        offset, columns = columns_of(centres, self.fit.faces)
        sign = 1.0 if np.linalg.det(columns) > 0.0 else -1.0
        inverse = sign * np.linalg.inv(columns)
        if self.strength is None:
            matrix = inverse / np.cbrt(np.linalg.det(inverse))
        else:
            matrix = inverse * self.strength / math.sqrt(1.0 + self.square_radius(centres, columns))
        return np.concatenate([offset, matrix.ravel()])

    def square_radius(self, centres: Array, columns: Array) -> float:
        """Mean square of the rings' radii in units of the vertical field, ``cot^2 d``, without its noise."""
        inverse = np.linalg.inv(columns)
        noise = 0.0 if self.fit.noise_sd is None else self.fit.noise_sd**2
        total, count = 0.0, 0
        for (n, mean, scatter), ring, centre in zip(self.moments, self.fit.rings, centres, strict=True):
            plane = inverse.T @ plane_of(ring.down)
            about = scatter + np.outer(mean - centre, mean - centre) - noise * np.eye(3)
            total += n * float(np.sum(plane * (about @ plane)))
            count += n
        return max(total / count, 0.0)

    def covariance(self, centres: Array) -> Array:
        """(12, 12) of :meth:`model`: that of the centres, and of the radius that ties the strength."""
        step = 1e-5 * float(np.abs(self.fit.columns).max())
        columns = []
        for k in range(centres.size):
            change = np.zeros(centres.size)
            change[k] = step
            moved = change.reshape(centres.shape)
            columns.append((self.model(centres + moved) - self.model(centres - moved)) / (2.0 * step))
        jacobian = np.array(columns).T
        spread = jacobian @ self.fit.covariance @ jacobian.T
        if self.strength is not None and self.fit.noise_sd is not None:
            square = self.square_radius(centres, self.fit.columns)
            count = sum(len(ring.samples) for ring in self.fit.rings)
            gain = float(np.linalg.norm(np.linalg.inv(self.fit.columns), 2))
            relative = math.sqrt(square / count) * self.fit.noise_sd * gain / (1.0 + square)
            scale = np.concatenate([np.zeros(3), self.model(centres)[3:]]) * relative
            spread = spread + self.fit.variance_inflation * np.outer(scale, scale)
        return np.asarray(0.5 * (spread + spread.T), dtype=np.float64)


def _result(fit: RingsFit, context: MagContext, diameter: float | None, n_samples: int) -> FitResult:
    """The verdict on `fit`; near the magnetic equator only the offset is determined."""
    strength = 0.5 * diameter if diameter is not None else context.strength
    scale = _Scale(fit, strength)
    whole = fit.weakest_column() < UNDETERMINED_SD and np.linalg.cond(fit.columns) < 20.0
    covariance = np.zeros((12, 12))
    covariance[:3, :3] = fit.offset_covariance()
    model = TriadModel(fit.offset)
    if whole:
        values = scale.model(fit.centres)
        model = TriadModel(values[:3], values[3:].reshape(3, 3))
        covariance = scale.covariance(fit.centres)
    chi2, closing = fit.chi2()
    p_value = float(scipy.special.chdtrc(closing, chi2)) if fit.noise_sd is not None else None
    if p_value is not None and p_value < _MISFIT:
        covariance = covariance * (chi2 / closing)
    if diameter is None and whole:
        covariance = with_strength_sd(covariance, model, context.field)
    quality = _quality(fit, context, model, covariance, diameter=diameter, whole=whole)
    quality |= {"n_outliers": n_samples - fit.n_used}
    quality |= {"chi2": chi2 if p_value is not None else None, "dof": closing, "p_value": p_value}
    return compass_result(
        CompassFit(
            METHOD,
            model,
            covariance,
            n_samples=n_samples,
            n_used=fit.n_used,
            message=_message(fit, quality, whole),
            residual_rms=quality["residual_rms"],
            condition_number=float(np.linalg.cond(fit.columns)),
            quality=quality,
            native=_native(fit, context, model, strength, whole),
            warnings=_warnings(fit, context, strength, quality),
            undetermined={} if whole else dict.fromkeys(parameter_names()[3:], NEAR_EQUATOR),
        ),
        context,
        of_earth=diameter is None,  # a diameter is in whatever unit
    )


def _quality(
    fit: RingsFit,
    context: MagContext,
    model: TriadModel,
    covariance: Array,
    *,
    diameter: float | None,
    whole: bool,
) -> dict[str, Any]:
    left = fit.residuals if len(fit.residuals) else fit.closure
    rms = _rms(left)
    quality: dict[str, Any] = {**residual_statistics(left, fit.dof, context.noise_sd)}
    quality |= {
        "residual_rms": rms,
        "noise_sd": fit.noise_sd,
        "closure_rms": _rms(fit.closure),
        "variance_inflation": fit.variance_inflation,
        "rings": len(fit.rings),
        "fixture_sd_deg": fit.fixture_sd,
        "heading_sd_deg": None,
        "mounting_deg": None,
        "mounting_sd_deg": None,
        "dip_deg": None,
        "field_ratio": None,
        "offset_sd_ut": None,
    }
    if not whole:
        return quality
    square = _Scale(fit, None).square_radius(fit.centres, fit.columns)
    dip = math.atan2(1.0, math.sqrt(square))
    radius = float(np.cbrt(abs(np.linalg.det(fit.columns)))) * math.sqrt(1.0 + square)
    inclination = dip if context.field is None or context.field.model == "given" else abs(context.field.inclination)
    length = None if diameter is None else 0.5 * diameter
    return quality | {
        "dip_deg": math.degrees(dip),
        **field_quality(model, covariance, radius, inclination, context, length=length),
        **mounting_of(model, covariance),
    }


def _rms(values: Array) -> float:
    return math.sqrt(float((values**2).mean()))


def _message(fit: RingsFit, quality: dict[str, Any], whole: bool) -> str:
    if not whole:
        return f"{len(fit.rings)} rings determine the offset alone: {NEAR_EQUATOR}"
    return (
        f"{len(fit.rings)} rings, centres by {fit.way}: mounting {quality['mounting_deg']:.2f} deg known to "
        f"{quality['mounting_sd_deg']:.2g} deg, heading good to {quality['heading_sd_deg']:.2g} deg at a dip of "
        f"{quality['heading_dip_deg']:.0f} deg"
    )


def _warnings(fit: RingsFit, context: MagContext, strength: float | None, quality: dict[str, Any]) -> tuple[str, ...]:
    found = []
    if strength is None:
        found.append(SCALE_UNKNOWN)
    if np.linalg.det(fit.columns) < 0.0:
        found.append(
            "the centres lie on the far side of every label: the field points up here (southern hemisphere), the "
            "labels name the axis that is up, or the sensor's axes are mirrored; the first two make no difference"
        )
    found += year_warning(context)
    if fit.fixture_sd == 0.0:
        found.append(
            "the faces were taken as exactly square: every degree of tilt is a degree of mounting; state --fixture-sd"
        )
    if fit.uneven:
        numbers = ", ".join(str(j + 1) for j in fit.uneven)
        found.append(
            f"ring {numbers} was turned unevenly: its {fit.way} is off the fitted circle, and the sd says so; use "
            "--centre circle"
        )
    missing = [str(j + 1) for j, circle in enumerate(fit.circles) if circle is None]
    if missing:
        found.append(
            f"ring {', '.join(missing)} has too few samples, or too short an arc, for a circle: its mean or the chosen "
            "points hold only if they are evenly spaced"
        )
    if quality["n_outliers"]:
        found.append(f"{quality['n_outliers']} samples lie off their ring and were left out")
    p_value = quality["p_value"]
    if p_value is not None and p_value < _MISFIT:
        found.append(
            f"the middles of opposite rings disagree by {quality['closure_rms']:.3g} {context.unit} (p = {p_value:.1e})"
            "; the sd is inflated to it: the fixture is worse than stated, or the field changed meanwhile"
        )
    return tuple(found)


def _native(
    fit: RingsFit, context: MagContext, model: TriadModel, strength: float | None, whole: bool
) -> dict[str, Any]:
    found: dict[str, Any] = {
        "centre": fit.way,
        "centres": fit.centres.tolist(),
        "faces": fit.faces.tolist(),
        "b": fit.offset.tolist(),
        "columns": fit.columns.tolist(),
        "form": "h ~ columns^-1 (m - b)",
    }
    if not whole:
        return found
    inverse = np.linalg.inv(fit.columns)
    diameter = 2.0 * (strength or float(np.cbrt(abs(np.linalg.det(fit.columns)))))
    samples = np.concatenate([ring.samples for ring in fit.rings])
    matrix, gains = published(samples, fit.offset, fit.columns, diameter)
    return found | {
        "inverse": inverse.tolist(),
        "homogeneous_of_columns": homogeneous(inverse, fit.offset).tolist(),
        **array_forms(model, context.instance),
        "published": {
            "columns": by_dominant(fit.columns).tolist(),
            "inverse": np.linalg.inv(by_dominant(fit.columns)).tolist(),
            "gains": gains.tolist(),
            "diameter": diameter,
            "matrix": matrix.tolist(),
            "homogeneous": homogeneous(matrix, fit.offset).tolist(),
        },
    }
