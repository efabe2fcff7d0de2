"""Temperature polynomials into INS_TCALn (FLIGHT_CONTROLLERS 1.2).

``P(t) = 1e-6 (C1 t + C2 t^2 + C3 t^3)``, ``t = clamp(T) - 35``; there is no constant, and one range of temperature
serves the accelerometer and the gyroscope of an instance.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.firmware import losses
from mavcal.calib.firmware.ardupilot import parameters as ardupilot
from mavcal.calib.firmware.ardupilot.learning import LEARNING
from mavcal.calib.firmware.ardupilot.parameters import T_REF, THERMAL_SCALE
from mavcal.calib.firmware.compose.announce import lose_drift
from mavcal.calib.firmware.compose.draft import Draft, Rank, Subject
from mavcal.calib.firmware.compose.fitted import Pair
from mavcal.calib.firmware.limits import THERMAL_SPAN_MIN
from mavcal.calib.firmware.names import THERMAL, Role
from mavcal.calib.firmware.plan import ParameterKind
from mavcal.calib.fit import AXES, FitResult
from mavcal.calib.recording import Sensor
from mavcal.calib.triad import ThermalPolynomial

Array = NDArray[np.float64]
Names = Mapping[Role, str]

ORDERS: Final = (1, 2, 3)
ENABLED: Final = 1


def recentre(degree: int, shift: float) -> Array:
    """Matrix (degree, degree) that moves a polynomial without constant to another reference, ``d = t + shift``.

    ``(t + s)^j = sum_i binom(j, i) s^(j-i) t^i``.
    """
    matrix = np.zeros((degree, degree))
    for j in range(1, degree + 1):
        binomial = 1.0
        for i in range(j, 0, -1):
            matrix[i - 1, j - 1] = binomial * shift ** (j - i)
            binomial = binomial * i / (j - i + 1)
    return matrix


def thermal_in_force(draft: Draft, names: Names) -> bool:
    """Whether the temperature compensation is switched on once the draft is written."""
    return int(draft.get(names[Role.THERMAL_ENABLE], 0.0)) == ENABLED


def set_thermal(draft: Draft, instance: int, pairs: Sequence[Pair]) -> None:
    """Plan the thermal set of one inertial unit from the drift fits among `pairs`."""
    sensors = (Sensor.ACCEL, Sensor.GYRO)
    names = {s: ardupilot.calibration_names(draft.parameters, s, instance) for s in sensors}
    enable = names[Sensor.GYRO][Role.THERMAL_ENABLE]
    abouts = [p.about for p in pairs if p.drift is not None]
    if not _may_enable(draft, enable, abouts):
        return
    running = int(draft.parameters[enable]) == ENABLED
    drifts = {p.about.sensor: p.drift for p in pairs if p.drift is not None and _reference_known(draft, p, names)}
    if not drifts:
        return
    kept = [s for s in sensors if s not in drifts and running and _has_coefficients(draft, names[s])]
    fits = [drift for drift in drifts.values() if drift is not None]
    limits = _common_range(draft, names[Sensor.GYRO], fits, abouts, running=running and bool(kept))
    if limits is None:
        return
    about = Subject(next(iter(drifts)), instance)
    for role, value in ((Role.THERMAL_MIN, limits[0]), (Role.THERMAL_MAX, limits[1])):
        draft.set_real(
            names[Sensor.GYRO][role],
            value,
            Rank.THERMAL,
            "range of temperature in which the drift was measured",
            about=about,
            unit="degC",
            hidden=True,
        )
    for sensor in sensors:
        if sensor in drifts:
            _set_coefficients(draft, Subject(sensor, instance), names[sensor], drifts[sensor])
        elif sensor not in kept:
            _clear_coefficients(draft, Subject(sensor, instance), names[sensor])
    draft.set_integer(
        enable,
        ENABLED,
        Rank.THERMAL_ENABLE,
        "use the temperature compensation",
        kind=ParameterKind.INT8,
        about=about,
    )


def _may_enable(draft: Draft, enable: str, abouts: Sequence[Subject]) -> bool:
    if enable not in draft.parameters:
        why = (
            f"the vehicle does not list {enable}: this board has no temperature compensation (it needs more than 1 MB "
            "of flash). The fit can be exported, not written"
        )
    elif int(draft.parameters[enable]) == LEARNING:
        why = f"{enable} = 2: the vehicle is learning its own compensation. Set it to 0, restart, then repeat"
    else:
        return True
    _refuse(draft, abouts, why)
    return False


def _refuse(draft: Draft, abouts: Sequence[Subject], why: str) -> None:
    for about in abouts:
        draft.block(why, about)


def _reference_known(draft: Draft, pair: Pair, names: Mapping[Sensor, Names]) -> bool:
    """Offsets against temperature are meaningless without the temperature that OFFS stands for."""
    drift = pair.drift
    if drift is None or pair.absolute is not None:
        return True
    name = names[pair.about.sensor][Role.TEMPERATURE]
    if float(draft.parameters.get(name, -300.0)) > -100.0:  # the firmware's "unknown" is -300
        return True
    lose_drift(
        draft,
        pair.about,
        drift,
        f"{name} does not say at which temperature the offset in force was taken. Run the {pair.about.sensor} job "
        "first, then this one again",
    )
    return False


def _common_range(
    draft: Draft, names: Names, drifts: Sequence[FitResult], abouts: Sequence[Subject], *, running: bool
) -> tuple[float, float] | None:
    """The range that every polynomial covers: beyond its own data none of them may be evaluated."""
    polynomials = [fit.model.polynomial for fit in drifts if fit.model.polynomial is not None]
    low = max(p.t_min for p in polynomials)
    high = min(p.t_max for p in polynomials)
    if running:  # another sensor's coefficients stay and hold in the old range only
        low = max(low, draft.get(names[Role.THERMAL_MIN], 0.0))
        high = min(high, draft.get(names[Role.THERMAL_MAX], 70.0))
    if high - low < THERMAL_SPAN_MIN:
        _refuse(
            draft,
            abouts,
            f"the drift is known from {low:.1f} to {high:.1f} degC only; at least {THERMAL_SPAN_MIN:g} degC are "
            "needed. Start colder or warm up further",
        )
        return None
    return low, high


def ardupilot_coefficients(polynomial: ThermalPolynomial) -> Array:
    """The polynomial in ArduPilot's parameters: about 35 degC, in units of 1e-6, shape (3, k)."""
    degree = polynomial.coefficients.shape[1]
    return np.asarray(polynomial.coefficients @ recentre(degree, T_REF - polynomial.t_ref).T / THERMAL_SCALE)


def _set_coefficients(draft: Draft, about: Subject, names: Names, fit: FitResult) -> None:
    polynomial = fit.model.polynomial
    assert polynomial is not None
    degree = fit.degree
    if degree > len(ORDERS):
        draft.block(f"{about}: a polynomial of degree {degree} cannot be stored; fit again with degree 3", about)
        return
    values = ardupilot_coefficients(polynomial)
    shift = recentre(degree, T_REF - polynomial.t_ref) / THERMAL_SCALE
    for axis, letter in enumerate(AXES):
        declined = [n for n in (f"poly{j}_{letter}" for j in range(1, degree + 1)) if not fit.determined(n)]
        if declined:
            draft.warn(f"{about}: the drift of the {letter} axis is not determined and is not compensated")
        rows = slice(losses.POLYNOMIAL + axis * degree, losses.POLYNOMIAL + (axis + 1) * degree)
        sd = np.sqrt(np.diag(shift @ fit.covariance[rows, rows] @ shift.T))
        for order in ORDERS:
            estimated = order <= degree and not declined
            draft.set_real(
                names[THERMAL[order][axis]],
                float(values[axis, order - 1]) if estimated else 0.0,
                Rank.THERMAL,
                f"temperature drift of {about}, {letter} axis, order {order}",
                about=about,
                sd=float(sd[order - 1]) if estimated else None,
                unit=f"1e-6 {fit.unit}/degC^{order}",
                hidden=True,
            )


def _has_coefficients(draft: Draft, names: Names) -> bool:
    return any(float(draft.parameters.get(names[role], 0.0)) for order in ORDERS for role in THERMAL[order])


def _clear_coefficients(draft: Draft, about: Subject, names: Names) -> None:
    """Unmeasured coefficients are set to zero before the set is enabled: hidden ones may hold anything."""
    for order in ORDERS:
        for role in THERMAL[order]:
            draft.set_real(
                names[role],
                0.0,
                Rank.THERMAL,
                f"no temperature drift of {about} was measured",
                about=about,
                hidden=True,
            )
