"""Fits into ArduPilot's parameters: accelerometers, gyroscopes and their temperature (FLIGHT_CONTROLLERS 1.1, 1.2).

``u = s - P(T) + P(CALTEMP)`` and ``c = SCAL (u - OFFS)``: the offset stands for one temperature, CALTEMP, and an
unknown CALTEMP (-300) is silently taken as TMIN. Offset and CALTEMP are therefore written together.

Everything here acts at once, without a restart. TCALn_ENABLE is documented as needing one, but only for learning
(value 2, latched at boot); the correction reads it with every sample. A plan that switches it to 1 therefore does not
ask for a restart. If a firmware needed one, the physical check would show it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.firmware import losses
from mavcal.calib.firmware.ardupilot import parameters as ardupilot
from mavcal.calib.firmware.ardupilot.learning import learning_warnings
from mavcal.calib.firmware.compose.announce import lose_accel, lose_gyro_matrix, offsets_usable, scale_usable
from mavcal.calib.firmware.compose.ardupilot_mark import mark_calibrated
from mavcal.calib.firmware.compose.ardupilot_thermal import set_thermal, thermal_in_force
from mavcal.calib.firmware.compose.draft import Draft, Rank, Subject
from mavcal.calib.firmware.compose.fitted import Pair, offset_at
from mavcal.calib.firmware.names import OFFSET, SCALE, Role
from mavcal.calib.firmware.options import how
from mavcal.calib.firmware.plan import ParameterKind
from mavcal.calib.fit import AXES, FitResult
from mavcal.calib.recording import Sensor

Array = NDArray[np.float64]
Names = Mapping[Role, str]

CALTEMP_UNKNOWN: Final = -300.0
REPEATABILITY: Final = MappingProxyType({Sensor.ACCEL: 0.005, Sensor.GYRO: np.radians(0.01)})
"""How well an offset in force may be known, m/s2 and rad/s: the uncertainty at which the jobs end."""


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
    """Whether the offset in force is what a drift fit finds at the very same temperature.

    Moving offset and CALTEMP along the fitted curve would change nothing that any stream could show, so nothing could
    prove it; both are left alone.
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
        draft.set_integer(
            "INS_GYR_CAL",
            0,
            Rank.SETTING,
            "keep the gyro offsets: no new estimate at boot",
            kind=ParameterKind.INT8,
        )
    elif planned:
        draft.warn(
            "the next boot discards these gyro offsets: INS_GYR_CAL = 1 makes the vehicle estimate its own at every "
            f"boot. Keep them with {how('keep_gyro_at_boot')}, which sets INS_GYR_CAL to 0",
            first=True,
        )
