"""Temperature polynomials into PX4's TC_An and TC_Gn (FLIGHT_CONTROLLERS 1.4).

``TC(T) = X0 + X1 d + X2 d^2 + X3 d^3``, ``d = clamp(T) - TREF``, in natural units, subtracted before CAL_*_OFF. TREF
is free, so a fit is stored as it is. PX4 does not remember at which temperature CAL_*_OFF was taken; X0 takes up what
keeps the offset right there.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.firmware import losses, names
from mavcal.calib.firmware.compose.announce import lose_drift
from mavcal.calib.firmware.compose.draft import Draft, Rank, Subject
from mavcal.calib.firmware.compose.fitted import Pair
from mavcal.calib.firmware.compose.px4_held import held_drift
from mavcal.calib.firmware.compose.px4_memory import held_by, model_after, row_of
from mavcal.calib.firmware.limits import THERMAL_SPAN_MIN
from mavcal.calib.firmware.names import THERMAL, Role
from mavcal.calib.firmware.options import how
from mavcal.calib.firmware.plan import ParameterKind
from mavcal.calib.firmware.retained import asks_for_save
from mavcal.calib.fit import AXES, FitResult
from mavcal.calib.recording import Sensor

Array = NDArray[np.float64]
Names = Mapping[Role, str]

ENABLED: Final = 1
DEGREE: Final = 3


def thermal_term(draft: Draft, about: Subject, temperature: float | None) -> Array | None:
    """``TC(T)`` (3,) with the draft written; zero where TC is off, None if it is on and T is not known."""
    model = model_after(draft, about)
    if model.polynomial is None:
        return np.zeros(3)
    if temperature is None:
        return None
    return model.offset + model.polynomial(temperature)


def thermal_runs(draft: Draft, about: Subject) -> bool:
    """Whether TC corrects `about` once the draft is written."""
    return model_after(draft, about).polynomial is not None


def set_thermal(draft: Draft, pair: Pair) -> None:
    """Plan the thermal row of one sensor."""
    fit, about = pair.drift, pair.about
    assert fit is not None
    roles = row_of(draft, about)
    if not _may_store(draft, about, roles, fit):
        return
    held = held_drift(fit)
    fit = held.fit
    constant, variance = _constant(draft, pair, fit)
    if constant is None:
        return
    if held.fixed:
        draft.lose(about, "terms of the drift", held.cost, fit.unit, held.text(about))
    polynomial = fit.model.polynomial
    assert polynomial is not None
    for role, value in (
        (Role.THERMAL_REF, polynomial.t_ref),
        (Role.THERMAL_MIN, polynomial.t_min),
        (Role.THERMAL_MAX, polynomial.t_max),
    ):
        draft.set_real(
            roles[role],
            value,
            Rank.THERMAL,
            "range of temperature in which the drift was measured, and its reference",
            about=about,
            unit="degC",
            hidden=True,
        )
    _set_coefficients(draft, about, roles, fit, constant, variance)
    running = int(draft.parameters[roles[Role.THERMAL_ENABLE]]) == ENABLED
    draft.set_integer(
        roles[Role.THERMAL_ID],
        int(draft.get(roles[Role.ID], 0.0)),
        Rank.THERMAL,
        f"the row belongs to {about}",
        kind=ParameterKind.INT32,
        about=about,
        needs_reboot=True,
        hidden=True,
    )
    if not running:
        draft.set_integer(
            roles[Role.THERMAL_ENABLE],
            ENABLED,
            Rank.THERMAL_ENABLE,
            "use the temperature compensation (from the next start on)",
            kind=ParameterKind.INT32,
            about=about,
            needs_reboot=True,
        )


def _may_store(draft: Draft, about: Subject, roles: Names, fit: FitResult) -> bool:
    if Role.THERMAL_ENABLE not in roles:
        draft.block(f"{about}: PX4 has no free row of temperature compensation for it", about)
        return False
    enable = roles[Role.THERMAL_ENABLE]
    if enable not in draft.parameters:
        draft.block(
            f"the vehicle does not list {enable}: its start script does not run the temperature compensation, so the "
            "coefficients would have no effect. The fit can be exported, not written",
            about,
        )
        return False
    polynomial = fit.model.polynomial
    assert polynomial is not None
    if fit.degree > DEGREE:
        draft.block(
            f"{about}: a polynomial of degree {fit.degree} cannot be stored; fit again with degree {DEGREE}", about
        )
        return False
    if polynomial.t_max - polynomial.t_min < THERMAL_SPAN_MIN:
        draft.block(
            f"the drift is known from {polynomial.t_min:.1f} to {polynomial.t_max:.1f} degC only; at least "
            f"{THERMAL_SPAN_MIN:g} degC are needed. Start colder or warm up further",
            about,
        )
        return False
    return True


def _constant(draft: Draft, pair: Pair, fit: FitResult) -> tuple[Array | None, Array]:
    """X0 (3,) and its variance (3,); None: the drift cannot be joined to the offset in force."""
    about = pair.about
    if pair.absolute is not None:
        return np.zeros(3), np.zeros(3)  # CAL_*_OFF is written too, and takes all of it
    polynomial = fit.model.polynomial
    assert polynomial is not None
    taken = draft.options.accel_temperature.get(about.instance)
    memory = held_by(draft, about)
    if taken is None and memory.offset.any():
        lose_drift(
            draft,
            about,
            fit,
            "PX4 does not store at which temperature the accelerometer was calibrated. Run the accel job after this "
            f"one, or give that temperature with {how('accel_temperature')}",
        )
        return None, np.zeros(3)
    if taken is None:
        draft.warn(f"{about} was never calibrated: calibrate it after this, with the compensation running")
        return np.zeros(3), np.zeros(3)
    before = thermal_term(draft, about, taken)
    assert before is not None
    powers = (float(np.clip(taken, polynomial.t_min, polynomial.t_max)) - polynomial.t_ref) ** np.arange(
        1, fit.degree + 1
    )
    rows = [slice(losses.POLYNOMIAL + a * fit.degree, losses.POLYNOMIAL + (a + 1) * fit.degree) for a in range(3)]
    variance = np.array([powers @ fit.covariance[r, r] @ powers for r in rows])
    return before - polynomial(taken), variance


def _set_coefficients(
    draft: Draft, about: Subject, roles: Names, fit: FitResult, constant: Array, variance: Array
) -> None:
    polynomial = fit.model.polynomial
    assert polynomial is not None
    sd = np.sqrt(np.clip(np.diag(fit.covariance)[losses.POLYNOMIAL :], 0.0, None)).reshape(3, fit.degree)
    for axis, letter in enumerate(AXES):
        declined = not fit.determined(*(f"poly{j}_{letter}" for j in range(1, fit.degree + 1)))
        if declined:
            draft.warn(f"{about}: the drift of the {letter} axis is not determined and is not compensated")
        for order in range(DEGREE + 1):
            value, spread = 0.0, None
            if order == 0:
                value, spread = float(constant[axis]), float(np.sqrt(variance[axis])) or None
            elif order <= fit.degree and not declined:
                value, spread = float(polynomial.coefficients[axis, order - 1]), float(sd[axis, order - 1]) or None
            draft.set_real(
                roles[THERMAL[order][axis]],
                value,
                Rank.THERMAL,
                f"temperature drift of {about}, {letter} axis, order {order}",
                about=about,
                sd=spread,
                unit=fit.unit if order == 0 else f"{fit.unit}/degC^{order}",
                hidden=True,
            )
    _silent_first(draft, [roles[role] for order in THERMAL for role in order])


def _silent_first(draft: Draft, rows: Sequence[str]) -> None:
    """Changes that ask for no save by themselves are written before those that do."""
    changes = draft.planned(rows)
    draft.reorder([c.name for c in sorted(changes, key=lambda c: asks_for_save(c.name, c.old or 0.0, c.new))])


def add_constant(
    draft: Draft, about: Subject, more: Array, sd: Array, why: str = "too fine a change for PX4's calibration memory"
) -> None:
    """Add `more` (3,) of an offset to the constant X0, which PX4 applies however small it is."""
    roles = row_of(draft, about)
    for axis, role in enumerate(names.THERMAL[0]):
        draft.set_real(
            roles[role],
            draft.get(roles[role], 0.0) + float(more[axis]),
            Rank.THERMAL,
            f"offset of {about}, {AXES[axis]} axis, {why}",
            about=about,
            sd=float(sd[axis]) or None,
            unit="m/s2" if about.sensor == Sensor.ACCEL else "rad/s",
            hidden=True,
        )
