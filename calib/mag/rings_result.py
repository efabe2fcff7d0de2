"""From the centres of rings with their covariance to a :class:`FitResult`: scale, verdict, warnings, native forms."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from mavcal.calib.c_array import c_array, homogeneous
from mavcal.calib.fit import FitResult, parameter_names
from mavcal.calib.mag.context import MagContext
from mavcal.calib.mag.earthly import earthly
from mavcal.calib.mag.heading import heading_sd_deg
from mavcal.calib.mag.mounting import mounting_of
from mavcal.calib.mag.result import UNDETERMINED_SD
from mavcal.calib.mag.ring_centres import Circle, Ring, plane_of
from mavcal.calib.mag.rings_algebra import by_dominant, centres_inverse, columns_of, published
from mavcal.calib.stats.residuals import residual_statistics
from mavcal.calib.triad import TriadModel

Array = NDArray[np.float64]

NEAR_EQUATOR = (
    "rings about the vertical see the matrix through the vertical field alone, which is too weak here (near the "
    "magnetic equator, or too few samples): tilt the vehicle to all sides and use mag-ellipsoid or mag-align, or turn "
    "each ring longer"
)

_MISFIT = 0.001


@dataclass(frozen=True, eq=False)
class RingsFit:
    """What the centres say, and everything that tells how far to trust it. Samples are in their own unit."""

    rings: tuple[Ring, ...]
    way: str
    centres: Array
    """(K, 3)."""
    covariance: Array
    """(3 K, 3 K) of the centres."""
    offset: Array
    columns: Array
    """(3, 3): V, whose columns are ``F sin d A e_i``."""
    circles: tuple[Circle | None, ...]
    residuals: Array
    """(N, 2): distances from plane and circle."""
    dof: int
    noise_sd: float | None
    """Noise of one axis of a sample; None: the rings have too few samples to tell."""
    variance_inflation: float
    uneven: tuple[int, ...]
    fixture_sd: float

    @property
    def faces(self) -> Array:
        """Signed unit vectors (K, 3): which axis pointed down."""
        return np.array([ring.down for ring in self.rings])

    @property
    def closure(self) -> Array:
        """What the centres leave (K, 3): the middles of the three pairs disagree by it."""
        return np.asarray(self.centres - self.offset - self.faces @ self.columns.T, dtype=np.float64)

    def residuals_by_ring(self) -> list[Array]:
        """The rows of `residuals` of every ring; none for a ring without a circle."""
        found, first = [], 0
        for ring, circle in zip(self.rings, self.circles, strict=True):
            count = 0 if circle is None else len(ring.samples)
            found.append(self.residuals[first : first + count])
            first += count
        return found

    @property
    def n_used(self) -> int:
        """Samples that are not outliers."""
        return sum(len(ring.samples) for ring in self.rings)

    def weakest_column(self) -> float:
        """Standard deviation of the columns over their smallest singular value."""
        solve = centres_inverse(self.faces)[1:]
        spread = np.einsum("ak,kilj,al->aij", solve, self._blocks(), solve)
        worst = max(float(np.linalg.eigvalsh(block)[-1]) for block in spread)
        return math.sqrt(max(worst, 0.0)) / max(float(np.linalg.svd(self.columns, compute_uv=False)[-1]), 1e-300)

    def offset_covariance(self) -> Array:
        """(3, 3)."""
        solve = centres_inverse(self.faces)[0]
        return np.asarray(np.einsum("k,kilj,l->ij", solve, self._blocks(), solve), dtype=np.float64)

    def chi2(self) -> tuple[float, int]:
        """How far the centres disagree in units of their covariance, and the degrees of freedom."""
        count = len(self.rings)
        values, vectors = np.linalg.eigh(
            np.eye(count) - np.column_stack([np.ones(count), self.faces]) @ centres_inverse(self.faces)
        )
        basis = vectors[:, values > 0.5]
        r = (basis.T @ self.closure).ravel()
        size = len(r)
        spread = np.einsum("kp,kilj,lq->piqj", basis, self._blocks(), basis).reshape(size, size)
        floor = (1e-9 * float(np.abs(self.columns).max())) ** 2 * np.eye(size)
        return float(r @ np.linalg.solve(spread + floor, r)), size

    def _blocks(self) -> Array:
        count = len(self.rings)
        return self.covariance.reshape(count, 3, count, 3)


@dataclass(frozen=True, eq=False)
class _Scale:
    """What makes a matrix of columns one of microtesla: samples in the corrected space of ``V^-1``."""

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
        """Mean square of the rings' radii in units of the vertical field, ``cot^2 d``, freed of the noise in it."""
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


def rings_result(method: str, fit: RingsFit, context: MagContext, diameter: float | None, n_samples: int) -> FitResult:
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
    if strength is not None and context.field is not None and diameter is None and whole:
        error = np.concatenate([np.zeros(3), model.matrix.ravel()]) * context.field.norm_sd / strength
        covariance = covariance + np.outer(error, error)
    quality = _quality(fit, context, model, covariance, strength=strength, of_field=diameter is None, whole=whole)
    quality |= {"n_outliers": n_samples - fit.n_used}
    quality |= {"chi2": chi2 if p_value is not None else None, "dof": closing, "p_value": p_value}
    found = context.made(method, n_samples).fitted(
        model,
        covariance,
        message=_message(fit, quality, whole),
        n_used=fit.n_used,
        residual_rms=quality["residual_rms"],
        condition_number=float(np.linalg.cond(fit.columns)),
        undetermined={} if whole else dict.fromkeys(parameter_names()[3:], NEAR_EQUATOR),
        warnings=_warnings(fit, context, strength, quality),
        quality=MappingProxyType(quality),
        native=MappingProxyType(_native(fit, context, model, strength, whole)),
    )
    return earthly(found, context) if diameter is None else found  # a diameter is in whatever unit


def _quality(
    fit: RingsFit,
    context: MagContext,
    model: TriadModel,
    covariance: Array,
    *,
    strength: float | None,
    of_field: bool,
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
    corrected = radius if strength is None else strength
    inclination = dip if context.field is None or context.field.model == "given" else abs(context.field.inclination)
    comparable = of_field and strength is not None and context.unit == "uT"
    offset = model.matrix @ covariance[:3, :3] @ model.matrix.T
    in_microtesla = context.unit == "uT" or (of_field and strength is not None)
    return quality | {
        "radius": radius,
        "dip_deg": math.degrees(dip),
        "field_ratio": radius / strength if comparable and strength is not None else None,
        "offset_sd_ut": math.sqrt(float(np.linalg.eigvalsh(offset)[-1])) if in_microtesla else None,
        "heading_sd_deg": heading_sd_deg(model, covariance, corrected, inclination, context.body_from_sensor),
        "heading_dip_deg": math.degrees(inclination),
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
        found.append("field strength unknown: the matrix keeps the mean radius, its common scale is not calibrated")
    if np.linalg.det(fit.columns) < 0.0:
        found.append(
            "the centres lie on the far side of every label: the field points up here (southern hemisphere), the "
            "labels name the axis that is up, or the sensor's axes are mirrored; the first two make no difference"
        )
    if context.field is not None and not context.field.valid:
        found.append(f"the date is outside the years of {context.field.model}: its field strength is extrapolated")
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
    whole_model = homogeneous(model.matrix, model.offset)
    return found | {
        "inverse": inverse.tolist(),
        "homogeneous_of_columns": homogeneous(inverse, fit.offset).tolist(),
        "homogeneous": whole_model.tolist(),
        "c_array": c_array(f"mag_{context.instance}", whole_model),
        "published": {
            "columns": by_dominant(fit.columns).tolist(),
            "inverse": np.linalg.inv(by_dominant(fit.columns)).tolist(),
            "gains": gains.tolist(),
            "diameter": diameter,
            "matrix": matrix.tolist(),
            "homogeneous": homogeneous(matrix, fit.offset).tolist(),
        },
    }
