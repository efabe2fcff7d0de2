"""Verdict on an ellipsoid from its covariance, residuals and coverage; blur and lag of slow samples.

Residuals of a compass sampled more slowly than it turned are not a time series, so serial correlation cannot tell
misfit from noise. Yet the cause of blur and lag is known: the turn. A mean over a window ``w`` shortens the field by
``(w^2/24) |du/dt|^2``, which a steady tumble hides in the ellipsoid. An axis read later by ``d`` than the others has an
error of ``d du_i/dt``, along the field ``d u_i du_i/dt``. Rows that are poses, recorded one by one with their times,
have no turn and independent errors. One of three criteria identifies them: steps of 60 degrees or more, steps as long
as between random rows, or an impossible rate of turn.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, Final

import numpy as np
import scipy
from numpy.typing import NDArray

from mavcal.calib.fit import OFFSETS, FitResult, parameter_names
from mavcal.calib.mag.coverage import mask_bytes, visited
from mavcal.calib.mag.distance import score_rows
from mavcal.calib.mag.result import (
    FIELD_TOLERANCE,
    SCALE_UNKNOWN,
    CompassFit,
    MagContext,
    compass_result,
    field_quality,
    undetermined_parameters,
    year_warning,
)
from mavcal.calib.mag.samples import axis_word
from mavcal.calib.mag.serial import LONGEST, white_variance
from mavcal.calib.mag.shape import Ellipsoid, correction, correction_covariance
from mavcal.calib.stats.residuals import residual_statistics
from mavcal.calib.triad import Array, TriadModel

WINDOW_S: Final = 0.1
"""Longest window over which a compass averages, s: ArduPilot reads out at 10 Hz, and magnetometers average inside."""
_SPARSE: Final = float(np.radians(30.0))  # from one sample to the next: beyond it residuals are no series
_POSES: Final = float(np.radians(60.0))  # no vehicle turns so far at every sample
_FASTEST: Final = 2.0 * np.pi  # rad/s: nor so fast for the whole of a recording
_IN_ORDER: Final = 4.0  # standard deviations by which the steps of a movement are shorter than those at random
_MOVES: Final = float(np.radians(1.0))  # between samples, of a compass that is being turned
_FEWEST: Final = 30  # samples that tell of it
_GAP: Final = 3.0  # usual steps, beyond which nothing is known of the turn
_CHANCE: Final = 1e-3  # of finding blur or lag where there is none
_UNIFORM: Final = float(np.sqrt(0.2))  # of the fourth power of a window, if any up to the longest is as likely
_FAR: Final = 5.0  # standard deviations beyond which a residual is an outlier
_CAUSES: Final = 3  # the blur, and the lag of two axes behind the third
_ROUGHEST = 0.15  # residual relative to the radius from which on the samples are no ellipsoid
_CHANGED_FIELD = 0.05  # residual relative to the radius, above the noise, that is 5 deg of heading now and then
_PIECES = 10.0
"""Most independent pieces of misfit over which an error averages out: it follows the movement, not the number of
samples."""
_VISIBLE = 1e-4  # of the field: a residual below that moves no heading by a hundredth of a degree, whatever its cause
_MISFIT = 1.3  # residuals larger than the noise by this factor are reported as misfit
_MANY = 20_000  # samples that are enough to draw a coverage mask


@dataclass(frozen=True, eq=False)
class TurningField:
    """Rotation of the field between readings of a slowly sampled compass, where neighbouring samples determine it."""

    rows: NDArray[np.intp]
    """Rows of the samples, (M,)."""
    u: Array
    """Direction of the field, (M, 3)."""
    rate: Array
    """Its change, 1/s, (M, 3)."""
    squared: Array
    """Square of its rate of turn, rad^2/s^2, (M,)."""
    step: float
    """Usual turn from one sample to the next, rad."""
    window: float
    """Longest possible averaging window of a reading, s: at most the sample interval."""

    @classmethod
    def of(cls, t: Array, corrected: Array) -> TurningField | None:
        """The turn of `corrected` (N, 3), samples at `t` (N,) after the fit; None for a series, and for poses."""
        if len(t) < _FEWEST:
            return None
        u = corrected / np.maximum(np.linalg.norm(corrected, axis=1), 1e-300)[:, None]
        cosines = np.clip(np.einsum("ni,ni->n", u[1:], u[:-1]), -1.0, 1.0)
        turned, steps = np.arccos(cosines), np.diff(t)
        moving = (turned > _MOVES) & (steps > 0.0)
        if int(moving.sum()) < _FEWEST:
            return None
        step, rate = float(np.median(turned[moving])), float(np.median(turned[moving] / steps[moving]))
        by_chance, spread = float(u.mean(axis=0) @ u.mean(axis=0)), float(cosines.std()) / np.sqrt(len(cosines))
        in_order = float(cosines.mean()) - by_chance > _IN_ORDER * spread
        if not (_SPARSE <= step < _POSES and rate < _FASTEST and in_order):
            return None
        usual = float(np.median(steps))
        known = (steps[1:] > 0.0) & (steps[:-1] > 0.0) & (np.maximum(steps[1:], steps[:-1]) < _GAP * usual)
        rows = np.flatnonzero(known) + 1
        if len(rows) < _FEWEST:
            return None
        rates = turned / np.maximum(steps, 1e-12)
        return cls(
            rows=rows,
            u=u[rows],
            rate=(u[rows + 1] - u[rows - 1]) / (t[rows + 1] - t[rows - 1])[:, None],
            squared=0.5 * (rates[rows - 1] ** 2 + rates[rows] ** 2),
            step=step,
            window=min(WINDOW_S, usual),
        )

    @property
    def blur(self) -> Array:
        """Relative shortening of the field by averaging, rms over windows up to the longest, (M,)."""
        return np.asarray(_UNIFORM * self.window**2 / 24.0 * self.squared, dtype=np.float64)

    def seen_in(self, lengths: Array) -> float:
        """Share of the variance of `lengths` (N,), ideally one, that follows the turn; 0: none."""
        off = (lengths - np.median(lengths))[self.rows]
        kept = np.abs(off) <= _FAR * 1.4826 * float(np.median(np.abs(off)))
        if int(kept.sum()) < _FEWEST:
            return 0.0
        u, off = self.u[kept], off[kept]
        causes = np.column_stack([self.squared, self.u[:, 0] * self.rate[:, 0], self.u[:, 1] * self.rate[:, 1]])[kept]
        model = np.column_stack([np.ones(len(u)), u, u**2, u * np.roll(u, 1, axis=1)])
        whole = np.column_stack([model, causes / np.maximum(np.abs(causes).max(axis=0), 1e-300)])
        without, with_them = _squares_left(model, off), _squares_left(whole, off)
        free = len(off) - whole.shape[1]
        if free < 1 or not with_them > 0.0:
            return 0.0
        chance = scipy.special.fdtrc(_CAUSES, free, (without - with_them) / _CAUSES / (with_them / free))
        return float((without - with_them) / without) if chance < _CHANCE else 0.0


def _squares_left(columns: Array, y: Array) -> float:
    left = y - columns @ np.linalg.lstsq(columns, y, rcond=1e-9)[0]
    return float(left @ left)


@dataclass(frozen=True, eq=False)
class ShapeFit:
    """An ellipsoid with covariance, residuals and diagnostics."""

    method: str
    ellipsoid: Ellipsoid
    covariance: Array
    """(9, 9), correlated residuals included; zero where the method holds a parameter fixed."""
    residuals: Array
    """Distances from the ellipsoid of the samples that were used, in order of time."""
    dof: float
    condition_number: float
    form: str = "ellipsoid"
    """Form of the fitted shape."""
    n_outliers: int = 0
    native: Mapping[str, Any] = field(default_factory=lambda: MappingProxyType({}))
    warnings: tuple[str, ...] = ()
    fallback_reason: str = ""
    """Reason for a form other than the requested one; empty: none."""
    undetermined: Mapping[str, str] = field(default_factory=lambda: MappingProxyType({}))
    """Parameters that the method does not determine, each with the movement that would."""
    variance_inflation: float = 1.0
    """Largest factor by which residuals that are correlated in time widened `covariance`."""

    def moved(self, centre: Array, scale: float) -> ShapeFit:
        """The fit of ``centre + scale * y``, with everything in the unit of that."""
        return dataclasses.replace(
            self,
            ellipsoid=self.ellipsoid.moved(centre, scale),
            covariance=self.covariance * scale**2,
            residuals=self.residuals * scale,
        )


def ellipsoid_result(fit: ShapeFit, samples: Array, context: MagContext) -> FitResult:
    """The verdict on `fit` of `samples` (N, 3); refused where the data do not support it."""
    thinned = samples[:: max(1, len(samples) // _MANY)]
    seen = visited((thinned - fit.ellipsoid.offset) @ correction(fit.ellipsoid, context.strength).matrix.T)
    quality = residual_quality(fit, context) | {"coverage_mask": mask_bytes(seen), "coverage": float(seen.mean())}
    turn = _turn(fit, samples, context)
    if turn is not None:
        lengths = np.linalg.norm(correction(fit.ellipsoid, 1.0).apply(samples), axis=1)
        quality |= {"step_deg": math.degrees(turn.step), "blur_share": turn.seen_in(lengths)}
        fit = _blurred(fit, samples, turn)
    fit = _widened(fit, quality)
    return judged_ellipsoid(fit, quality, len(samples), len(fit.residuals), context)


def judged_ellipsoid(
    fit: ShapeFit, about_samples: Mapping[str, Any], n_samples: int, n_used: int, context: MagContext
) -> FitResult:
    """The verdict on `fit`, given :func:`residual_quality` and the coverage in `about_samples`."""
    model = correction(fit.ellipsoid, context.strength)
    strength_sd = 0.0 if context.field is None else context.field.norm_sd
    full = correction_covariance(fit.ellipsoid, fit.covariance, context.strength, strength_sd)
    quality = {
        **about_samples,
        "dof": fit.dof,
        "variance_inflation": fit.variance_inflation,
        "n_outliers": fit.n_outliers,
        "axis_ratio": float(fit.ellipsoid.radii[2] / fit.ellipsoid.radii[0]),
        **field_quality(model, full, fit.ellipsoid.mean_radius, context.inclination, context),
    }
    reason = _field_changed(fit, quality) or _why_not(fit, quality["residual_rms"], model, full)
    if reason is not None:
        message, names = reason
        message = f"{fit.fallback_reason}. {message[0].upper()}{message[1:]}" if fit.fallback_reason else message
        made = context.made(fit.method, n_samples)
        return made.refused(message, names, message, quality=MappingProxyType(quality))
    return compass_result(
        CompassFit(
            fit.method,
            model,
            full,
            n_samples=n_samples,
            n_used=n_used,
            message=_message(quality) + _undetermined_text(fit),
            residual_rms=quality["residual_rms"],
            condition_number=fit.condition_number,
            quality=quality,
            native=_native(fit.ellipsoid, model) | dict(fit.native),
            warnings=(
                *((fit.fallback_reason,) if fit.fallback_reason else ()),
                *fit.warnings,
                *_warnings(fit, context, quality),
            ),
            undetermined=fit.undetermined,
        ),
        context,
    )


def residual_quality(fit: ShapeFit, context: MagContext) -> dict[str, Any]:
    """Figures of the residuals of `fit`, for ``quality``."""
    squares = float(fit.residuals @ fit.residuals)
    noise = context.noise_variance
    floor = white_variance(fit.residuals) if noise is None else noise
    statistics = residual_statistics(fit.residuals[:LONGEST], int(fit.dof), None)
    chi2 = squares / floor if floor > 0.0 else None
    return {
        "residual_rms": math.sqrt(squares / len(fit.residuals)),
        "chi2": chi2,
        "p_value": float(scipy.special.chdtrc(fit.dof, chi2)) if chi2 is not None and noise is not None else None,
        "noise_sd": math.sqrt(floor),
        "noise_from": "successive residuals" if noise is None else "given",
        "first_correlation": statistics["first_correlation"],
        "white": statistics["white"],
    }


def _turn(fit: ShapeFit, samples: Array, context: MagContext) -> TurningField | None:
    """Turn of the field between samples too slow to be a series; None: they are fast enough."""
    if context.times is None or len(context.times) != len(samples):
        return None
    return TurningField.of(context.times, correction(fit.ellipsoid, 1.0).apply(samples))


def _blurred(fit: ShapeFit, samples: Array, turn: TurningField) -> ShapeFit:
    """The fit with the possible error by the longest blur, which more samples do not reduce."""
    inverse = np.linalg.inv(fit.ellipsoid.shape)
    outwards = turn.blur / np.linalg.norm(turn.u @ inverse, axis=1)  # along the normal, in the unit of the samples
    pull = score_rows(samples[turn.rows], fit.ellipsoid) @ outwards
    variance = float(fit.residuals @ fit.residuals) / max(fit.dof, 1.0) * fit.variance_inflation
    moved = fit.covariance @ pull / max(variance, 1e-300)
    return dataclasses.replace(fit, covariance=fit.covariance + np.outer(moved, moved))


def _widened(fit: ShapeFit, quality: Mapping[str, Any]) -> ShapeFit:
    """The fit with the uncertainty of its misfit, for any number of samples.

    Residuals beyond the noise are misfit, which averages over :data:`_PIECES` at most. So are residuals that follow the
    turn if the compass was read more slowly than it turned.
    """
    squares = quality["residual_rms"] ** 2
    misfit = quality.get("blur_share", 0.0)
    if _misfits(fit, quality):
        misfit = max(misfit, (squares - quality["noise_sd"] ** 2) / squares)
    factor = misfit * len(fit.residuals) / (_PIECES * fit.variance_inflation)
    if factor <= 1.0:
        return fit
    return dataclasses.replace(
        fit, covariance=fit.covariance * factor, variance_inflation=fit.variance_inflation * factor
    )


def _misfits(fit: ShapeFit, quality: Mapping[str, Any]) -> bool:
    """Whether the residuals are larger than the noise, and large enough to matter."""
    if quality["chi2"] is None or not fit.dof > 0:
        return False
    visible = quality["residual_rms"] > _VISIBLE * fit.ellipsoid.mean_radius
    excess = math.sqrt(quality["chi2"] / fit.dof)
    return bool(visible and excess > max(_MISFIT, 1.0 + 3.0 / math.sqrt(2.0 * fit.dof)))


def _why_not(fit: ShapeFit, rough: float, model: TriadModel, full: Array) -> tuple[str, tuple[str, ...]] | None:
    """Reason to refuse the fit, and the undetermined parameters; None: it may be used. `rough`: residual rms."""
    radius = fit.ellipsoid.mean_radius
    if rough > _ROUGHEST * radius:
        message = (
            f"the magnetometer samples are {rough / radius:.0%} of the field off every {fit.form}: the field changed "
            "while turning (keep away from steel, magnets and currents, and repeat)"
        )
        if fit.form != "ellipsoid" and not fit.undetermined:
            message += ", or this form is too simple: fit mag-ellipsoid"
        return message, parameter_names()
    names = tuple(n for n in undetermined_parameters(model, full, radius) if n not in fit.undetermined)
    if not names:
        return None
    weakest = np.linalg.eigh(full[:3, :3])[1][:, -1]
    worst = math.sqrt(float(np.linalg.eigvalsh(full[:3, :3])[-1]))
    message = (
        f"the movement does not determine {', '.join(names)} (offset known to {worst:.3g} at a field "
        f"of {radius:.3g}): turn the vehicle so that its {axis_word(weakest)} axis points up and down as well"
    )
    return message, names


def _field_changed(fit: ShapeFit, quality: Mapping[str, Any]) -> tuple[str, tuple[str, ...]] | None:
    """Reason to refuse residuals far beyond the noise, worth degrees of heading; None: they are small enough."""
    rough = quality["residual_rms"] / fit.ellipsoid.mean_radius
    if fit.form != "ellipsoid" or not _CHANGED_FIELD < rough <= _ROUGHEST or not _misfits(fit, quality):
        return None
    message = (
        f"the field wandered by {rough:.0%} of itself while turning, which is no noise and costs "
        f"{math.degrees(rough):.0f} deg of heading: keep away from steel, magnets and currents, and repeat"
    )
    return message, parameter_names()


def _warnings(fit: ShapeFit, context: MagContext, quality: Mapping[str, Any]) -> tuple[str, ...]:
    found: list[str] = []
    ratio = quality["field_ratio"]
    if context.strength is None:
        found.append(SCALE_UNKNOWN)
    elif ratio is not None and abs(ratio - 1.0) > FIELD_TOLERANCE:
        found.append(
            f"the measured field of {quality['radius']:.1f} uT is {ratio:.2f} times the {context.strength:.1f} uT of "
            "the magnetic model: steel or a magnet is near, the sensor's scale is off, or the place is wrong"
        )
    found += year_warning(context)
    if _misfits(fit, quality):
        found.append(
            f"residuals are {math.sqrt(quality['chi2'] / fit.dof):.1f} times the noise: the samples are not quite "
            f"{'an' if fit.form == 'ellipsoid' else 'a'} {fit.form} (blur, currents, steel nearby). The stated "
            "uncertainty includes that"
        )
    if "step_deg" in quality:
        seen = quality["blur_share"]
        found.append(
            f"the compass was read more slowly than it turned, by {quality['step_deg']:.0f} deg from one sample to the "
            "next: the stated uncertainty includes what a blur or a lag could hide"
            + (f", and {seen:.0%} of the residuals' variance follow the turn" if seen else "")
            + ". Turn more slowly, or record it at 10 Hz"
        )
    if fit.dof < 10:
        found.append(f"only {fit.dof:.0f} samples more than parameters: the stated uncertainty is itself uncertain")
    if fit.n_outliers:
        found.append(f"{fit.n_outliers} samples lie off the ellipsoid and were left out")
    return tuple(found)


def _message(quality: Mapping[str, Any]) -> str:
    return (
        f"heading good to {quality['heading_sd_deg']:.2g} deg at a dip of {quality['heading_dip_deg']:.0f} deg, "
        f"residual {quality['residual_rms']:.3g} at a field of {quality['radius']:.4g}"
    )


def _undetermined_text(fit: ShapeFit) -> str:
    if not fit.undetermined:
        return ""
    names = [*(name for name in fit.undetermined if name in OFFSETS), "the matrix"]
    return f"; {' and '.join(names)} stay open: {next(iter(fit.undetermined.values()))}"


def _native(ellipsoid: Ellipsoid, model: TriadModel) -> dict[str, Any]:
    """The form of MATLAB's magcal: ``corrected = (D - b) A`` by rows, det A = 1, on a sphere of radius `expmfs`."""
    normal = model.matrix / np.cbrt(abs(float(np.linalg.det(model.matrix))))
    return {
        "b": ellipsoid.offset.tolist(),
        "A": normal.tolist(),
        "expmfs": ellipsoid.mean_radius,
        "radii": ellipsoid.radii.tolist(),
        "shape": ellipsoid.shape.tolist(),
    }
