"""Fits in the form that the composers need: sorted by content, then by sensor.

Every fit has the form of a sensor model. In a level fit this model is neutral, in a motor fit it is the one in force.
Read as corrections they would state, with certainty, that the sensor has no error. So only :func:`contents` makes a
:data:`Correction`, and code that needs the true sensor model takes nothing else.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, NewType

import numpy as np

from mavcal.calib.firmware import losses, names
from mavcal.calib.firmware.compose import mag_motor, trim
from mavcal.calib.firmware.compose.draft import Draft, Subject
from mavcal.calib.firmware.names import Role
from mavcal.calib.firmware.plan import Value
from mavcal.calib.fit import AXES, FitResult, FitStatus
from mavcal.calib.gyro.g_sensitivity import METHOD as G_SENSITIVITY
from mavcal.calib.recording import Array, Sensor
from mavcal.calib.triad import TriadModel

Correction = NewType("Correction", FitResult)
"""A fit whose model is an estimate of the sensor."""

NOT_HELD: Final = frozenset({G_SENSITIVITY})
"""Methods whose offset belongs to a term that no firmware stores: that of a gyroscope without g-sensitivity."""


@dataclass(frozen=True)
class Contents:
    """Fits by content."""

    corrections: tuple[Correction, ...]
    levels: tuple[FitResult, ...]
    motors: tuple[FitResult, ...]
    others: tuple[FitResult, ...]
    """Fits without a result that a firmware could store."""


def contents(fits: Sequence[FitResult]) -> Contents:
    """Sort fits by content; refused ones are left out."""
    usable = [fit for fit in fits if fit.status != FitStatus.REFUSED]
    levels = tuple(fit for fit in usable if trim.is_level(fit))
    motors = tuple(fit for fit in usable if mag_motor.is_motor(fit))
    rest = [fit for fit in usable if not (trim.is_level(fit) or mag_motor.is_motor(fit))]
    corrections = tuple(Correction(fit) for fit in rest if _corrects(fit))
    return Contents(corrections, levels, motors, tuple(fit for fit in rest if not _corrects(fit)))


def _corrects(fit: FitResult) -> bool:
    """Whether anything of the model was estimated. What a method holds fixed has no variance."""
    return fit.method not in NOT_HELD and bool(np.nanmax(fit.sd, initial=0.0) > 0.0)


InForce = Callable[[Mapping[str, Value], Sensor, int], TriadModel]


@dataclass(frozen=True)
class Pair:
    """Fits of one sensor: its calibration at one temperature, its drift with temperature, or both."""

    about: Subject
    at_rest: FitResult | None
    """A fit of offset (and matrix) without temperature."""
    drift: FitResult | None
    """A fit with a polynomial."""

    @property
    def absolute(self) -> FitResult | None:
        """The fit that determines the offset; None: only the shape of the drift is known."""
        if self.at_rest is not None:
            return self.at_rest
        if self.drift is not None and not is_shape_only(self.drift):
            return self.drift
        return None


def is_shape_only(fit: FitResult) -> bool:
    """Whether a thermal fit determines only the change of the offset with temperature, not its value.

    With one pose an accelerometer's offset cannot be told from the tilt; such a fit holds the matrix fixed.
    """
    if not fit.determined(*(f"offset_{a}" for a in AXES)) and fit.sensor == Sensor.ACCEL:
        return True
    matrix_fixed = not np.any(np.diag(fit.covariance)[losses.MATRIX])
    return fit.sensor == Sensor.ACCEL and fit.model.polynomial is not None and matrix_fixed


def keeps_matrix(fit: FitResult) -> bool:
    """Whether a compass fit left only matrix entries undetermined, which it holds near those in force."""
    return bool(fit.quality.get("soft_iron_kept")) and all(name.startswith("matrix") for name in fit.undetermined)


def drift_axes(fit: FitResult) -> str:
    """The axes whose drift a thermal fit determines; of a fit without temperature every axis."""
    return "".join(a for a in AXES if fit.determined(*(f"poly{j + 1}_{a}" for j in range(fit.degree))))


def usable_fits(draft: Draft, fits: Sequence[FitResult]) -> tuple[FitResult, ...]:
    """The fits that may be written; the draft gets the reasons for the others."""
    kept = []
    for fit in fits:
        about = Subject(fit.sensor, fit.instance)
        if fit.status == FitStatus.REFUSED:
            _leave_out(draft, about, fit.message)
        elif not drift_axes(fit):
            _leave_out(draft, about, _why_no_drift(fit), needless=bool(fit.quality.get("below_resolution")))
        elif fit.relative:
            draft.block(
                f"{about}: the calibration in force during the capture is not known, so this fit is relative and "
                "cannot be written as absolute values. Capture again with the vehicle's parameters in the recording",
                about,
            )
        else:
            kept.append(fit)
    return tuple(kept)


def _leave_out(draft: Draft, about: Subject, why: str, *, needless: bool = False) -> None:
    text = f"{about} is left out: {why}"
    draft.warn(text)
    draft.drop(about, text, needless=needless)


def _why_no_drift(fit: FitResult) -> str:
    """Reason why no axis of a thermal fit is determined."""
    if fit.quality.get("below_resolution"):
        return "its drift with temperature is below what the stream resolves, on every axis"
    return f"its drift with temperature is not determined on any axis. {'; '.join(fit.warnings) or fit.message}"


def pair_fits(fits: Sequence[Correction]) -> tuple[Pair, ...]:
    """Fits by sensor instance; of several of a kind the last one counts."""
    at_rest: dict[Subject, FitResult] = {}
    drift: dict[Subject, FitResult] = {}
    for fit in fits:
        kind = at_rest if fit.model.polynomial is None else drift
        kind[Subject(fit.sensor, fit.instance)] = fit
    return tuple(Pair(about, at_rest.get(about), drift.get(about)) for about in {**at_rest, **drift})


def offset_at(fit: FitResult, temperature: float) -> tuple[Array, Array]:
    """Offset (3,) of a thermal fit at `temperature` (degC), and its covariance (3, 3)."""
    polynomial = fit.model.polynomial
    if polynomial is None:
        return fit.model.offset, fit.covariance[losses.OFFSETS, losses.OFFSETS]
    degree = fit.degree
    d = float(np.clip(temperature, polynomial.t_min, polynomial.t_max)) - polynomial.t_ref
    jacobian = np.zeros((3, fit.covariance.shape[0]))
    jacobian[:, losses.OFFSETS] = np.eye(3)
    for axis in range(3):
        first = losses.POLYNOMIAL + axis * degree
        jacobian[axis, first : first + degree] = d ** np.arange(1, degree + 1)
    return fit.model.offset + polynomial(temperature), jacobian @ fit.covariance @ jacobian.T


def body_from_raw(
    in_force: InForce, roles: Mapping[Role, str], parameters: Mapping[str, Value], about: Subject
) -> Array:
    """Rotation from the raw sensor frame to the body: the correction in force with every calibration value neutral."""
    neutral = dict(parameters)
    neutral |= {roles[role]: 0.0 for role in names.OFFSET}
    neutral |= {roles[role]: 1.0 for role in names.SCALE if role in roles}
    neutral |= {roles[role]: 0.0 for role in names.CROSS if role in roles}
    neutral |= {roles[role]: 0.0 for role in (Role.FIELD_SCALE, Role.THERMAL_ENABLE) if role in roles}
    return in_force(neutral, about.sensor, about.instance).matrix
