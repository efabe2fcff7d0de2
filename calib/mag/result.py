"""Facts that a compass fit needs beside the samples, and the function that makes its :class:`FitResult`.

Each method finds offset and matrix in its own way, with its own message and warnings. The scaling to the Earth's field,
the heading error and the limits of usability are common to all.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Final, TypedDict

import numpy as np

from mavcal.calib.c_array import c_array, homogeneous
from mavcal.calib.earth import STRONGEST_UT, WEAKEST_UT, EarthField, beyond_earth
from mavcal.calib.errors import InvalidInputError, UndeterminedError
from mavcal.calib.fit import FitBuilder, FitResult, FitStatus, parameter_names
from mavcal.calib.mag.free_rotation import angle_between
from mavcal.calib.mag.heading import DEFAULT_INCLINATION, heading_sd_deg
from mavcal.calib.recording import Array, Sensor
from mavcal.calib.triad import TriadModel


@dataclass(frozen=True, eq=False)
class MagContext:
    """Facts about sensor and field, beside the samples.

    Parameters
    ----------
    unit
        Of the samples: ``uT`` or ``counts``.
    noise_sd
        Noise of one axis in that unit, without quantisation; None: from the residuals.
    quantum
        Width of a quantisation bin; its ``q^2/12`` is added to the variance of `noise_sd`.
    field
        The true field: its strength ties the scale, its dip the heading error. None: scale and dip are unknown.
    body_from_sensor
        Mounting rotation (3, 3), for the heading error only; None: the sensor's axes are the vehicle's.
    compensated
        Whether the vehicle has a compensation of the motors' field in force.
    times
        Times of the samples, s, (N,), for the search for blur and lag in their residuals; None: not known.
    """

    instance: int = 0
    unit: str = "uT"
    noise_sd: float | None = None
    quantum: float = 0.0
    field: EarthField | None = None
    body_from_sensor: Array | None = None
    relative: bool = False
    temperature: float | None = None
    compensated: bool = False
    times: Array | None = None

    def __post_init__(self) -> None:
        if self.noise_sd is not None and not (math.isfinite(self.noise_sd) and self.noise_sd > 0.0):
            raise InvalidInputError(f"noise of a magnetometer must be positive, not {self.noise_sd}")
        if not (math.isfinite(self.quantum) and self.quantum >= 0.0):
            raise InvalidInputError(f"a quantisation bin cannot be {self.quantum} wide")

    def made(self, method: str, n_samples: int, movement: str = "") -> FitBuilder:
        """A builder for the result of a method with this number of samples."""
        return FitBuilder(
            method, Sensor.MAG, self.instance, self.unit, n_samples, self.relative, self.temperature, movement
        )

    @property
    def noise_variance(self) -> float | None:
        """Variance of one axis with quantisation, in the unit of the samples squared; None: not known."""
        return None if self.noise_sd is None else self.noise_sd**2 + self.quantum**2 / 12.0

    @property
    def strength(self) -> float | None:
        """Length of the corrected vectors, uT; None: the mean radius of the ellipsoid."""
        return None if self.field is None else self.field.norm

    @property
    def inclination(self) -> float:
        """Dip of the field, rad."""
        return DEFAULT_INCLINATION if self.field is None else self.field.inclination


class MagFacts(TypedDict, total=False):
    """Keyword arguments of every magnetometer fit: the parameters of :class:`MagContext`."""

    instance: int
    unit: str
    noise_sd: float | None
    quantum: float
    field: EarthField | None
    body_from_sensor: Array | None
    relative: bool
    temperature: float | None
    compensated: bool
    times: Array | None


UNDETERMINED_SD = 0.1
"""Standard deviation relative to the radius above which a parameter is undetermined. The linearisation error, (sd/R)^2,
then reaches a tenth of the sd, and the stated uncertainty is no longer valid."""

FIELD_TOLERANCE = 0.2
"""Departure of the fitted from the modelled field strength, relative, that is reported."""

SCALE_UNKNOWN = "field strength unknown: the matrix keeps the mean radius, its common scale is not calibrated"

_REPORTED: Final = 0.12  # beyond the Earth's range, relative: a sensor's scale and the crust explain as much
_IMPLAUSIBLE: Final = 0.35  # of the Earth's field: as far off the health of a log calls a compass faulty


@dataclass(frozen=True, eq=False)
class CompassFit:
    """A usable correction with its covariance and diagnostics, before the checks that all methods share."""

    method: str
    model: TriadModel
    covariance: Array
    """(12, 12), in the order of :func:`calib.fit.parameter_names`."""
    n_samples: int
    n_used: int
    message: str
    residual_rms: float
    condition_number: float
    quality: Mapping[str, Any]
    """Has ``radius`` where the field strength was measured."""
    native: Mapping[str, Any] = dataclasses.field(default_factory=lambda: MappingProxyType({}))
    warnings: tuple[str, ...] = ()
    undetermined: Mapping[str, str] = dataclasses.field(default_factory=lambda: MappingProxyType({}))
    """Parameters that the method leaves open, each with the movement that would determine it."""


def compass_result(fit: CompassFit, context: MagContext, *, of_earth: bool = True) -> FitResult:
    """The result of `fit`; refused where its field cannot be the Earth's.

    `of_earth` False: the scale has another source, so the strength is not checked.
    """
    covariance = fit.covariance.copy()
    rows = [parameter_names().index(name) for name in fit.undetermined]
    covariance[rows, :] = covariance[:, rows] = 0.0
    found = context.made(fit.method, fit.n_samples).fitted(
        fit.model,
        covariance,
        message=fit.message,
        n_used=fit.n_used,
        residual_rms=fit.residual_rms,
        condition_number=fit.condition_number,
        undetermined=fit.undetermined,
        warnings=fit.warnings,
        quality=MappingProxyType(dict(fit.quality)),
        native=MappingProxyType(dict(fit.native)),
    )
    return checked_against_earth(found, context) if of_earth else found


def refusal(method: str, error: UndeterminedError, n_samples: int, context: MagContext) -> FitResult:
    """The refused fit for `error`."""
    message = f"{error}; {error.remedy}" if error.remedy else str(error)
    return context.made(method, n_samples).refused(message, error.missing or parameter_names(), error.remedy or message)


def field_quality(
    model: TriadModel,
    covariance: Array,
    radius: float,
    dip: float,
    context: MagContext,
    *,
    length: float | None = None,
) -> dict[str, float | None]:
    """Field strength `radius` beside the true one, heading error at `dip` (rad), and offset error in uT.

    `radius` is in the unit of the samples. `length` is that of the corrected vectors where it was stated in a unit of
    its own; None: the true strength, else `radius`.
    """
    strength = context.strength if length is None else None
    in_microtesla = context.unit == "uT" or strength is not None
    corrected = length or strength or radius
    offset = model.matrix @ covariance[:3, :3] @ model.matrix.T
    return {
        "radius": radius,
        "field_ratio": radius / strength if context.unit == "uT" and strength is not None else None,
        "heading_sd_deg": heading_sd_deg(model, covariance, corrected, dip, context.body_from_sensor),
        "heading_dip_deg": math.degrees(dip),
        "offset_sd_ut": math.sqrt(float(np.linalg.eigvalsh(offset)[-1])) if in_microtesla else None,
    }


def with_strength_sd(covariance: Array, model: TriadModel, field: EarthField | None) -> Array:
    """`covariance` (12, 12) with the uncertainty of the field strength that `model` is scaled to."""
    if field is None:
        return covariance
    error = np.concatenate([np.zeros(3), model.matrix.ravel()]) * field.norm_sd / field.norm
    return covariance + np.outer(error, error)


def undetermined_parameters(model: TriadModel, covariance: Array, radius: float) -> tuple[str, ...]:
    """Parameters whose standard deviation relative to the field exceeds :data:`UNDETERMINED_SD`."""
    size = np.cbrt(abs(float(np.linalg.det(model.matrix))))
    relative = np.concatenate([covariance.diagonal()[:3] / radius**2, covariance.diagonal()[3:] / size**2])
    return tuple(n for n, v in zip(parameter_names(), relative, strict=True) if not v <= UNDETERMINED_SD**2)


def year_warning(context: MagContext) -> list[str]:
    """A warning where the date lies outside the years of the magnetic model."""
    if context.field is None or context.field.valid:
        return []
    return [f"the date is outside the years of {context.field.model}: its field strength is extrapolated"]


def array_forms(model: TriadModel, instance: int) -> dict[str, Any]:
    """The correction as a homogeneous 4 x 4 matrix, and that as an array of C."""
    whole = homogeneous(model.matrix, model.offset)
    return {"homogeneous": whole.tolist(), "c_array": c_array(f"mag_{instance}", whole)}


def plausible_field(radius: float) -> bool:
    """Whether a sensor with a wrong scale at a disturbed site may read the Earth's field as `radius` uT."""
    return beyond_earth(radius) <= _IMPLAUSIBLE


def checked_against_earth(fit: FitResult, context: MagContext) -> FitResult:
    """`fit` with a warning where no place on Earth has such a field strength; refused where it is far off.

    A fit scaled to a stated field is never refused, since the sensor may read in any unit.
    """
    radius = fit.quality.get("radius")
    if fit.unit != "uT" or fit.status == FitStatus.REFUSED or radius is None:
        return fit
    off = beyond_earth(float(radius))
    if off <= _REPORTED:
        return fit
    text = (
        f"the measured field of {radius:.3g} uT is none of the Earth's, which has {WEAKEST_UT:.0f} to "
        f"{STRONGEST_UT:.0f} uT anywhere: steel or a magnet is near, the unit is another one, or the scale is off"
    )
    if off <= _IMPLAUSIBLE or context.field is not None:
        return dataclasses.replace(fit, warnings=(text, *fit.warnings))
    remedy = "keep away from steel and magnets, or state the unit of the samples (--unit-mag) or the field (--field)"
    return context.made(fit.method, fit.n_samples).refused(
        f"{text}; {remedy}", parameter_names(), remedy, quality=fit.quality
    )


def rotation_covariance(model: TriadModel, covariance: Array) -> Array:
    """Covariance (3, 3) in rad^2 of small rotations of the corrected vectors about x, y, z.

    ``C = Q S`` by polar decomposition and ``dC = [phi] C + Q dS``: the skew part of ``G = Q^T dC`` is
    ``(tr S - S) Q^T phi``. `covariance` is (12, 12), in the order of :func:`calib.fit.parameter_names`.
    """
    rotation, symmetric = model.rotation, model.symmetric().matrix
    inverse = np.linalg.inv(np.trace(symmetric) * np.eye(3) - symmetric)
    turn = np.zeros((3, 9))
    for k in range(9):
        change = np.zeros((3, 3))
        change.flat[k] = 1.0
        G = rotation.T @ change
        turn[:, k] = rotation @ inverse @ np.array([G[2, 1] - G[1, 2], G[0, 2] - G[2, 0], G[1, 0] - G[0, 1]])
    return np.asarray(turn @ covariance[3:12, 3:12] @ turn.T, dtype=np.float64)


def mounting_of(model: TriadModel, covariance: Array) -> dict[str, float]:
    """Angle of the rotation in the matrix of `model`, and its standard deviation about the worst axis, degrees."""
    worst = float(np.linalg.eigvalsh(rotation_covariance(model, covariance))[-1])
    return {
        "mounting_deg": math.degrees(angle_between(np.eye(3), model.rotation)),
        "mounting_sd_deg": math.degrees(math.sqrt(max(worst, 0.0))),
    }
