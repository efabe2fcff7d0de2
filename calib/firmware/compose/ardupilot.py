"""Turns accelerometer and gyroscope fits, drift included, into ArduPilot's parameters (FLIGHT_CONTROLLERS 1.1, 1.2).

``u = s - P(T) + P(CALTEMP)`` and ``c = SCAL (u - OFFS)``: the offset stands for one temperature, CALTEMP, and an
unknown CALTEMP (-300) is silently taken as TMIN. Offset and CALTEMP are therefore written together.

Everything here acts at once, without a restart. TCALn_ENABLE is documented as needing one, but only for learning
(value 2, latched at boot); the correction reads it with every sample. A plan that switches it to 1 therefore does not
ask for a restart. If a firmware needed one, the physical check would show it.

INS_TCALn hold ``P(t) = 1e-6 (C1 t + C2 t^2 + C3 t^3)``, ``t = clamp(T) - 35``; there is no constant. One range of
temperature serves the accelerometer and the gyroscope of an instance.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Final

import numpy as np

from mavcal.calib.firmware import losses
from mavcal.calib.firmware.ardupilot import parameters as ardupilot
from mavcal.calib.firmware.ardupilot.doubts import LEARNING, learning_warnings
from mavcal.calib.firmware.ardupilot.parameters import T_REF, THERMAL_SCALE
from mavcal.calib.firmware.compose.announce import (
    lose_accel,
    lose_drift,
    lose_gyro_matrix,
    offsets_usable,
    scale_usable,
)
from mavcal.calib.firmware.compose.ardupilot_mark import mark_calibrated
from mavcal.calib.firmware.compose.draft import Draft, Rank, Subject
from mavcal.calib.firmware.compose.fitted import Pair, offset_at
from mavcal.calib.firmware.limits import THERMAL_SPAN_MIN
from mavcal.calib.firmware.names import OFFSET, SCALE, THERMAL, Role
from mavcal.calib.firmware.options import how
from mavcal.calib.fit import AXES, FitResult
from mavcal.calib.recording import Array, Sensor
from mavcal.calib.triad import ThermalPolynomial

Names = Mapping[Role, str]

ORDERS: Final = (1, 2, 3)
ENABLED: Final = 1
CALTEMP_UNKNOWN: Final = -300.0
REPEATABILITY: Final = MappingProxyType({Sensor.ACCEL: 0.005, Sensor.GYRO: np.radians(0.01)})
"""Uncertainty of an offset in force, m/s2 and rad/s: that at which the jobs end."""


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
    draft.set_integer(enable, ENABLED, Rank.THERMAL_ENABLE, "use the temperature compensation", about=about)


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
    """Whether the temperature of OFFS is known, without which a drift fit cannot be written."""
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
    """Set unmeasured coefficients to zero before the set is enabled, since hidden ones may have any value."""
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


def compose_imu(draft: Draft, pairs: Sequence[Pair]) -> None:
    """Plan every accelerometer and gyroscope that was fitted."""
    for text in learning_warnings(draft.parameters) if pairs else ():
        draft.warn(text)
    drifting = {pair.about.instance for pair in pairs if pair.drift is not None}
    for instance in sorted(drifting):
        set_thermal(draft, instance, [p for p in pairs if p.about.instance == instance])
    for pair in pairs:
        names = ardupilot.calibration_names(draft.parameters, pair.about.sensor, pair.about.instance)
        absolute = pair.absolute
        if absolute is None:
            continue
        if not offsets_usable(
            draft, pair.about, absolute, thermal=absolute.degree == 0 and thermal_in_force(draft, names)
        ):
            continue
        _set_offsets(draft, pair.about, names, absolute)
        if pair.about.sensor == Sensor.ACCEL:
            _set_scale(draft, pair.about, names, absolute)
        else:
            lose_gyro_matrix(draft, pair.about, absolute)
    fitted = {p.about.instance for p in pairs if p.about.sensor == Sensor.ACCEL and p.at_rest is not None}
    if fitted:
        mark_calibrated(draft, Sensor.ACCEL, fitted)


def _set_offsets(draft: Draft, about: Subject, names: Names, fit: FitResult) -> None:
    offset, covariance, temperature = offset_to_write(draft, names, fit)
    if temperature is not None and _still_holds(draft, about, names, offset, covariance, temperature):
        return
    unit = "m/s2" if about.sensor == Sensor.ACCEL else "rad/s"
    for axis, role in enumerate(OFFSET):
        if not fit.determined(f"offset_{AXES[axis]}"):
            continue
        draft.set_real(
            names[role],
            float(offset[axis]),
            Rank.OFFSET,
            f"offset of {about}, {AXES[axis]} axis",
            about=about,
            sd=float(np.sqrt(covariance[axis, axis])),
            unit=unit,
        )
    _set_temperature(draft, about, names, temperature)


def offset_to_write(draft: Draft, roles: Names, fit: FitResult) -> tuple[Array, Array, float | None]:
    """Offset (3,), its covariance (3, 3) and the temperature it stands for (None: not known).

    A thermal fit is evaluated at the temperature that the offset in force stands for, if P varies there. Otherwise it
    is evaluated at its own reference, moved into the range in which P varies.
    """
    polynomial = fit.model.polynomial
    if polynomial is None:
        return *offset_at(fit, 0.0), fit.temperature
    stored = draft.get(roles[Role.TEMPERATURE], CALTEMP_UNKNOWN)
    low, high = draft.get(roles[Role.THERMAL_MIN], 0.0), draft.get(roles[Role.THERMAL_MAX], 70.0)
    temperature = stored if low <= stored <= high else float(np.clip(polynomial.t_ref, low, high))
    return *offset_at(fit, temperature), temperature


def _still_holds(
    draft: Draft, about: Subject, names: Names, offset: Array, covariance: Array, temperature: float
) -> bool:
    """Whether the offset in force agrees with a drift fit at its temperature.

    Moving offset and CALTEMP along the fitted curve would not change any stream, and could not be proved; both are left
    unchanged.
    """
    if temperature != draft.parameters.get(names[Role.TEMPERATURE]):
        return False
    stored = [draft.parameters.get(names[role]) for role in OFFSET]
    if any(value is None for value in stored):
        return False
    apart = np.abs(np.array([float(value) for value in stored if value is not None]) - offset)
    return bool((apart <= 3.0 * np.sqrt(np.diag(covariance) + REPEATABILITY[about.sensor] ** 2)).all())


def _set_temperature(draft: Draft, about: Subject, names: Names, temperature: float | None) -> None:
    name = names[Role.TEMPERATURE]
    if temperature is None and thermal_in_force(draft, names):
        draft.block(
            f"{about}: temperature compensation is in force, but the temperature during the calibration is not known, "
            f"so {name} cannot be written with the offset. Repeat with a stream that carries the IMU's temperature",
            about,
        )
        return
    if name not in draft.parameters:
        return  # a board without temperature calibration has no CALTEMP
    if temperature is None:
        draft.warn(f"{about}: the temperature is not known; {name} is set to -300 (unknown)")
    draft.set_real(
        name,
        CALTEMP_UNKNOWN if temperature is None else temperature,
        Rank.TEMPERATURE,
        f"temperature at which the offset of {about} was taken",
        about=about,
        unit="degC",
    )


def _set_scale(draft: Draft, about: Subject, names: Names, fit: FitResult) -> None:
    in_force = np.array([float(draft.parameters.get(names[role], 1.0)) for role in SCALE])
    if not scale_usable(draft, about, fit, in_force):
        return
    parts = losses.split(fit)
    for axis, role in enumerate(SCALE):
        draft.set_real(
            names[role],
            float(parts.diagonal[axis]),
            Rank.SCALE,
            f"scale of {about}, {AXES[axis]} axis",
            about=about,
            sd=float(parts.sd[3 + axis]),
        )
    lose_accel(draft, about, parts, parts.diagonal, ardupilot.board_rotation(draft.parameters))


def boot_calibration(draft: Draft, *, planned: bool) -> None:
    """Announce or warn that the next boot estimates the gyro offsets again; `planned`: the plan writes gyro offsets."""
    if int(draft.parameters.get("INS_GYR_CAL", 1)) == 0:
        return
    if draft.options.keep_gyro_at_boot:
        draft.set_integer("INS_GYR_CAL", 0, Rank.SETTING, "keep the gyro offsets: no new estimate at boot")
    elif planned:
        draft.warn(
            "the next boot discards these gyro offsets: INS_GYR_CAL = 1 makes the vehicle estimate its own at every "
            f"boot. Keep them with {how('keep_gyro_at_boot')}, which sets INS_GYR_CAL to 0",
            first=True,
        )
