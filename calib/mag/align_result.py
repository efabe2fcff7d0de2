"""From an alignment with its information to a :class:`FitResult`: scale, verdict, warnings, quality."""

from __future__ import annotations

import math
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.c_array import c_array, homogeneous
from mavcal.calib.errors import UndeterminedError
from mavcal.calib.fit import FitResult, parameter_names
from mavcal.calib.mag.align_lag import FieldLag
from mavcal.calib.mag.align_solve import AlignmentSolution
from mavcal.calib.mag.align_start import check_dip
from mavcal.calib.mag.context import MagContext
from mavcal.calib.mag.earthly import earthly
from mavcal.calib.mag.heading import heading_sd_deg
from mavcal.calib.mag.mounting import mounting_of, rotation_covariance
from mavcal.calib.mag.result import FIELD_TOLERANCE, UNDETERMINED_SD
from mavcal.calib.mag.samples import axis_word
from mavcal.calib.mag.sections import mask_bytes, visited
from mavcal.calib.stats.residuals import residual_statistics
from mavcal.calib.triad import TriadModel

Array = NDArray[np.float64]

_ROUGHEST = 0.15  # of the field, residuals from which on nothing is explained


@dataclass(frozen=True, eq=False)
class AlignFit:
    """What was found in scaled samples ``(y - centre) / scale``, and everything that tells how far to trust it."""

    alignment: AlignmentSolution
    centre: Array
    scale: float
    information: Array
    """(13, 13), weakened by what is correlated in time and by an unknown lag."""
    variance_inflation: float
    down: Array
    lag: FieldLag | None
    """What is left of the lag after `shift`, and its uncertainty; None: the movement does not show it, or stated."""
    shift: float
    n_gated: int
    n_outliers: int

    @property
    def noise_sd(self) -> float:
        """Noise of one axis of the field, in the unit of the samples."""
        return self.alignment.noise.field * self.scale

    @property
    def radius(self) -> float:
        """Strength of the field in the unit of the samples: the geometric mean of the ellipsoid's axes."""
        return self.scale / float(np.cbrt(np.linalg.det(self.alignment.matrix)))

    @property
    def sine(self) -> float:
        """Sine of the dip."""
        return float(self.alignment.unknowns[12])

    def model(self, strength: float | None) -> tuple[TriadModel, Array]:
        """Offset and matrix ``F B`` with their covariance (12, 12); without a strength F makes ``det C = 1``."""
        B = self.alignment.matrix / self.scale
        inverse = np.linalg.inv(B)
        factor = strength if strength is not None else 1.0 / float(np.cbrt(np.linalg.det(B)))
        jacobian = np.zeros((12, 13))
        jacobian[:3, 9:12] = self.scale * np.eye(3)
        by_matrix = np.eye(9) if strength is not None else np.eye(9) - np.outer(B.ravel(), inverse.T.ravel()) / 3.0
        jacobian[3:, :9] = factor / self.scale * by_matrix
        size = np.sqrt(np.diag(self.information))
        covariance = np.linalg.inv(self.information / np.outer(size, size)) / np.outer(size, size)
        spread = jacobian @ covariance @ jacobian.T
        model = TriadModel(self.centre + self.scale * self.alignment.unknowns[9:12], factor * B)
        return model, 0.5 * (spread + spread.T)

    def sine_sd(self) -> float:
        """Standard deviation of the sine of the dip."""
        size = np.sqrt(np.diag(self.information))
        return math.sqrt(float(np.linalg.inv(self.information / np.outer(size, size))[12, 12])) / float(size[12])


def aligned_result(method: str, fit: AlignFit, context: MagContext, n_samples: int) -> FitResult:
    """The verdict on `fit`.

    Raises
    ------
    UndeterminedError
        If the data leave part of it open, naming the movement or the place that would not.
    """
    cosine = _checked_dip(fit)
    model, covariance = fit.model(context.strength)
    if context.field is not None and context.field.norm_sd > 0.0:
        error = np.concatenate([np.zeros(3), model.matrix.ravel()]) * context.field.norm_sd / context.field.norm
        covariance = covariance + np.outer(error, error)
    _check_determined(model, covariance, fit.radius)
    quality = _quality(fit, context, model, covariance, cosine)
    left = fit.alignment.residuals
    found = context.made(method, n_samples).fitted(
        model,
        covariance,
        message=(
            f"mounting {quality['mounting_deg']:.2f} deg known to {quality['mounting_sd_deg']:.2g} deg, heading good "
            f"to {quality['heading_sd_deg']:.2g} deg at a dip of {quality['dip_deg']:.1f} deg"
        ),
        n_used=len(left),
        residual_rms=quality["residual_rms"],
        condition_number=_condition(fit.information),
        warnings=_warnings(fit, context, quality),
        quality=MappingProxyType(quality),
        native=MappingProxyType(_native(fit, context, model)),
    )
    return earthly(found, context)


def _checked_dip(fit: AlignFit) -> float:
    """The cosine of the dip, if a rotation about the vertical can be seen at all."""
    noise = math.hypot(fit.noise_sd / fit.radius, fit.alignment.noise.vertical)
    if noise > _ROUGHEST:
        raise UndeterminedError(
            f"field and vertical disagree by {noise:.0%}: the field changed while turning, or the accelerometer felt "
            "more than gravity",
            remedy="keep away from steel, magnets and currents, turn slowly, calibrate the accelerometer, and repeat",
        )
    return check_dip(fit.sine, noise)


def _check_determined(model: TriadModel, covariance: Array, radius: float) -> None:
    size = float(np.cbrt(np.linalg.det(model.matrix)))
    relative = np.concatenate([covariance.diagonal()[:3] / radius**2, covariance.diagonal()[3:] / size**2])
    names = tuple(n for n, v in zip(parameter_names(), relative, strict=True) if not v <= UNDETERMINED_SD**2)
    if not names:
        return
    turn, offset = rotation_covariance(model, covariance), covariance[:3, :3] / radius**2
    (turn_worst, turn_axes), (worst, axes) = np.linalg.eigh(turn), np.linalg.eigh(offset)
    if turn_worst[-1] > worst[-1]:
        axis = axis_word(turn_axes[:, -1])
        remedy = f"hold the vehicle with its {axis} axis level, pointing east and west, and tilt it to all sides"
    else:
        remedy = f"turn the vehicle so that its {axis_word(axes[:, -1])} axis points up and down as well"
    raise UndeterminedError(f"the movement does not determine {', '.join(names)}", missing=names, remedy=remedy)


def _condition(information: Array) -> float:
    size = np.sqrt(np.diag(information))
    return float(np.linalg.cond(information / np.outer(size, size)))


def _quality(fit: AlignFit, context: MagContext, model: TriadModel, covariance: Array, cosine: float) -> dict[str, Any]:
    found, radius = fit.alignment, fit.radius
    strength = radius if context.strength is None else context.strength
    dof = 2 * len(found.residuals) - len(found.unknowns)
    of_field = found.residuals[:, 0] * fit.noise_sd
    chi2 = residual_statistics(of_field, len(of_field) - 9, _noise(context))
    both = residual_statistics(found.residuals, dof, None)
    offset_sd = model.matrix @ covariance[:3, :3] @ model.matrix.T
    comparable = context.unit == "uT" and context.strength is not None
    seen = visited(found.corrected)
    lag = fit.lag
    return {
        **chi2,
        "first_correlation": both["first_correlation"],
        "white": both["white"],
        "residual_rms": math.sqrt(float((of_field**2).mean())),
        "noise_sd": fit.noise_sd,
        "vertical_noise_deg": math.degrees(found.noise.vertical),
        "variance_inflation": fit.variance_inflation,
        "n_outliers": fit.n_outliers,
        "n_gated": fit.n_gated,
        "radius": radius,
        "field_ratio": radius / strength if comparable else None,
        "dip_deg": math.degrees(math.atan2(fit.sine, cosine)),
        "dip_sd_deg": math.degrees(fit.sine_sd() / cosine),
        **mounting_of(model, covariance),
        "heading_sd_deg": heading_sd_deg(
            model, covariance, strength, math.atan2(fit.sine, cosine), context.body_from_sensor
        ),
        "heading_dip_deg": math.degrees(math.atan2(fit.sine, cosine)),
        "offset_sd_ut": math.sqrt(float(np.linalg.eigvalsh(offset_sd)[-1]))
        if context.unit == "uT" or context.strength is not None
        else None,
        "time_offset": fit.shift,
        "time_offset_left": None if lag is None else lag.value,
        "time_offset_sd": None if lag is None else lag.sd * math.sqrt(fit.variance_inflation),
        "coverage_mask": mask_bytes(seen),
        "coverage": float(seen.mean()),
    }


def _noise(context: MagContext) -> float | None:
    variance = context.noise_variance
    return None if variance is None else math.sqrt(variance)


def _warnings(fit: AlignFit, context: MagContext, quality: dict[str, Any]) -> tuple[str, ...]:
    found = []
    if context.strength is None:
        found.append("field strength unknown: the matrix keeps the mean radius, its common scale is not calibrated")
    ratio = quality["field_ratio"]
    if ratio is not None and abs(ratio - 1.0) > FIELD_TOLERANCE:
        found.append(f"the measured field is {ratio:.2f} times the stated one: steel or a magnet is near")
    if fit.n_gated:
        found.append(f"{fit.n_gated} samples were left out: the accelerometer felt more than gravity, or had no sample")
    if fit.n_outliers:
        found.append(f"{fit.n_outliers} samples do not fit the field and the vertical of the others and were left out")
    if quality["variance_inflation"] > 1.5:
        found.append(
            f"the residuals wander (variance x {quality['variance_inflation']:.1f}): motion, currents or an "
            "accelerometer that is not calibrated; the stated uncertainty includes it"
        )
    if fit.shift:
        found.append(f"the magnetometer was taken as {fit.shift * 1e3:.1f} ms later than the accelerometer")
    elif fit.lag is None:
        found.append("nothing is said of a time offset between the sensors: no times, or too little turning")
    return tuple(found)


def _native(fit: AlignFit, context: MagContext, model: TriadModel) -> dict[str, Any]:
    whole = homogeneous(model.matrix, model.offset)
    return {
        "B": (fit.alignment.matrix / fit.scale).tolist(),
        "b": model.offset.tolist(),
        "sin_dip": fit.sine,
        "rotation": model.rotation.tolist(),
        "symmetric": model.symmetric().matrix.tolist(),
        "form": "|B (y - b)| = 1, down . B (y - b) = sin_dip",
        "homogeneous": whole.tolist(),
        "c_array": c_array(f"mag_{context.instance}", whole),
    }
