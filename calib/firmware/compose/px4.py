"""Turns accelerometer and gyroscope fits, drift included, into PX4's parameters (FLIGHT_CONTROLLERS 1.4).

``b = L R [(a - TC(T) - OFF) o SCALE]``. Rows are matched by device id; small changes do not reach the memory that
corrects (:mod:`calib.firmware.compose.px4_memory`).

TC_An and TC_Gn hold ``TC(T) = X0 + X1 d + X2 d^2 + X3 d^3``, ``d = clamp(T) - TREF``, in natural units, subtracted
before CAL_*_OFF. TREF is free, so a fit is stored as it is. PX4 does not store the temperature of CAL_*_OFF; X0 is
chosen so that the offset stays right there.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from mavcal.calib.errors import FirmwareError
from mavcal.calib.firmware import losses, names
from mavcal.calib.firmware.compose.announce import (
    lose_accel,
    lose_drift,
    lose_gyro_matrix,
    offsets_usable,
    scale_usable,
)
from mavcal.calib.firmware.compose.draft import Draft, Rank, Subject
from mavcal.calib.firmware.compose.fitted import Pair, offset_at
from mavcal.calib.firmware.compose.px4_held import held_drift
from mavcal.calib.firmware.compose.px4_memory import (
    Vector,
    held_by,
    model_after,
    neutral_model,
    order_without_restart,
    representable,
    row_of,
    set_vector,
    survives_restart,
)
from mavcal.calib.firmware.limits import THERMAL_SPAN_MIN
from mavcal.calib.firmware.names import THERMAL, Role
from mavcal.calib.firmware.options import how
from mavcal.calib.firmware.values import asks_for_save
from mavcal.calib.fit import AXES, FitResult
from mavcal.calib.recording import Array, Sensor

Names = Mapping[Role, str]

ENABLED: Final = 1
DEGREE: Final = 3
GYRO_WRITER: Final = "IMU_GYRO_CAL_EN"
"""Whether PX4 starts its gyro_calibration; read at the start only, so that setting it to 0 stops nothing."""
RESTING: Final = "beside CAL_GYRO's, which PX4's gyro_calibration keeps right until the restart"


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
    """Order changes that do not trigger a save before those that do."""
    changes = draft.planned(rows)
    draft.reorder([c.name for c in sorted(changes, key=lambda c: asks_for_save(c.name, c.old or 0.0, c.new))])


def add_constant(
    draft: Draft, about: Subject, more: Array, sd: Array, why: str = "too fine a change for PX4's calibration memory"
) -> None:
    """Add `more` (3,) of an offset to the constant X0, which PX4 applies regardless of its size."""
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


def compose_imu(draft: Draft, pairs: Sequence[Pair]) -> None:
    """Plan every accelerometer and gyroscope that was fitted."""
    for pair in pairs:
        if not set_row(draft, pair.about):
            continue
        if pair.drift is not None:
            set_thermal(draft, pair)
        fit = pair.absolute
        if fit is None:
            continue
        if not offsets_usable(draft, pair.about, fit, thermal=fit.degree == 0 and thermal_runs(draft, pair.about)):
            continue
        _set_offset(draft, pair.about, fit)
        if pair.about.sensor == Sensor.ACCEL:
            _set_scale(draft, pair.about, fit)
        else:
            lose_gyro_matrix(draft, pair.about, fit)
    _silence_writers(draft, pairs)


def set_row(draft: Draft, about: Subject) -> bool:
    """Give the sensor its own row, which needs its device id."""
    try:
        roles = row_of(draft, about)
    except FirmwareError as error:
        draft.block(f"{about}: {error}", about)
        return False
    if int(draft.parameters.get(roles[Role.PRIORITY], -1)) == 0:
        draft.warn(f"{about} is disabled ({roles[Role.PRIORITY]} = 0); it stays so")
    device_ids = draft.options.device_ids
    device = device_ids.get((about.sensor, about.instance))
    held = int(draft.parameters.get(roles[Role.ID], 0))
    rows = _rows(draft, about.sensor)
    twice = [Subject(*key) for key, other in sorted(device_ids.items()) if key[0] == about.sensor and other == device]
    if len(twice) > 1:
        draft.block(f"{' and '.join(map(str, twice))} cannot both have the device id {device}", about)
        return False
    if held != 0 and device == held:
        if (about.sensor, about.instance) not in draft.options.without_row:
            return True  # the operator has read it
        draft.block(f"PX4 says that {about} is in none of its rows, but {device} is in {roles[Role.ID]}", about)
        return False
    if held != 0 and device is not None:  # an inertial sensor: a compass has the row of its id, or a free one
        where = f"is in {rows[device]}" if device in rows else "is in no row"
        draft.block(
            f"{about} has by order the row of another sensor: its device id {device} {where}, and {roles[Role.ID]} is "
            f"{held}. That row's correction was taken out of its samples. If the other sensor is gone, set "
            f"{roles[Role.ID]} to 0; else run PX4's own calibration once. Then start again",
            about,
        )
        return False
    if held != 0:
        return _row_is_free(draft, about, roles[Role.ID], held, len(rows))
    if device is None:
        draft.block(
            f"{roles[Role.ID]} is 0: the vehicle has never calibrated {about}, and a stream does not tell its device "
            f"id. Run PX4's own quick calibration once, or give it with {how('device_ids')}",
            about,
        )
        return False
    draft.set_integer(roles[Role.ID], device, Rank.ID, f"the row belongs to {about}", about=about)
    return True


def _row_is_free(draft: Draft, about: Subject, name: str, held: int, filled: int) -> bool:
    """Whether the row by order may be taken, which holds the id `held`; else the sensor is refused.

    Rows with an id need not belong to streaming sensors: PX4 keeps the id of a removed one.
    """
    without = draft.options.without_row
    ask = (
        f"Run PX4's own calibration of it once, which stores the id. Or give its id with {how('device_ids')}; "
        f"`listener sensor_{about.sensor}` on PX4's console says it"
    )
    if (about.sensor, about.instance) in without:
        draft.block(
            f"PX4 says that {about} is in none of its rows, so {name} = {held} is the id of another sensor. {ask}",
            about,
        )
        return False
    if filled > 1 and any(sensor == about.sensor for sensor, _ in without):
        draft.block(
            f"PX4 says that one {about.sensor} is in none of its rows, and {filled} rows hold ids: which one is "
            f"that of {about} is not known ({name} = {held}). {ask}",
            about,
        )
        return False
    if about.instance > 0 or filled > 1:
        shown = (
            "no stream shows whether that is right" if about.sensor == Sensor.MAG else "the physical check looks at it"
        )
        draft.warn(
            f"PX4 streams do not say which device {about} is; its row is taken by order ({name} = {held}), and {shown}"
        )
    return True


def _rows(draft: Draft, sensor: Sensor) -> dict[int, str]:
    """The name that holds each device id."""
    ids = (names.px4_names(sensor, slot)[Role.ID] for slot in range(names.PX4_SLOTS))
    return {device: name for name in ids if (device := int(draft.parameters.get(name, 0))) != 0}


def _set_offset(draft: Draft, about: Subject, fit: FitResult) -> None:
    temperature = fit.temperature if fit.model.polynomial is None else fit.model.polynomial.t_ref
    thermal = thermal_term(draft, about, temperature)
    if thermal is None:
        draft.block(
            f"{about}: temperature compensation is in force, but the temperature during the calibration is not known. "
            "Repeat with a stream that carries it",
            about,
        )
        return
    offset, covariance = offset_at(fit, temperature if temperature is not None else 0.0)
    memory = held_by(draft, about)
    roles = row_of(draft, about)
    known = np.array([fit.determined(f"offset_{a}") for a in AXES])
    wanted = Vector(
        about,
        names.OFFSET,
        np.where(known, offset - thermal, memory.offset),
        np.where(known, np.sqrt(np.diag(covariance)), 0.0),
        "m/s2" if about.sensor == Sensor.ACCEL else "rad/s",
        f"offset of {about}",
    )
    if _rewritten_before_restart(draft, about):
        held = np.array([float(draft.parameters.get(roles[role], 0.0)) for role in names.OFFSET])
        add_constant(draft, about, wanted.values - held, wanted.sd, RESTING)
        return
    lasting = survives_restart(about, names.OFFSET, wanted.values)
    if thermal_runs(draft, about) and _thermal_is_live(draft, about):
        target = representable(wanted)
        if not lasting or order_without_restart(draft, wanted, target) is None:
            add_constant(draft, about, wanted.values - memory.offset, wanted.sd)
            return
    if not lasting and thermal_runs(draft, about):
        add_constant(draft, about, wanted.values, wanted.sd)
    elif not lasting:
        cost = float(np.linalg.norm(wanted.values))
        draft.lose(
            about,
            "offset",
            cost,
            wanted.unit,
            f"{about}: its offset of {cost:.4f} {wanted.unit} is too small to reach PX4's memory and is not written; "
            "it could be held by the temperature compensation, if that ran",
        )
    set_vector(draft, wanted, representable(wanted))


def _rewritten_before_restart(draft: Draft, about: Subject) -> bool:
    """Whether PX4 would rewrite a new gyro offset before the restart that starts the compensation.

    Its gyro_calibration compares the offset with the gyro's mean at the present temperature, 5 s after every change. An
    offset that is right only with the compensation would not last until the restart; the one in force would.
    """
    if about.sensor != Sensor.GYRO or int(draft.parameters.get(GYRO_WRITER, 0)) == 0:
        return False
    return thermal_runs(draft, about) and not _thermal_is_live(draft, about)


def _thermal_is_live(draft: Draft, about: Subject) -> bool:
    """Whether TC runs already, so that X0 acts at once."""
    roles = row_of(draft, about)
    own = int(draft.parameters.get(roles[Role.ID], 0))
    return (
        own != 0
        and int(draft.parameters.get(roles[Role.THERMAL_ENABLE], 0)) == 1
        and int(draft.parameters.get(roles[Role.THERMAL_ID], 0)) == own
    )


def _set_scale(draft: Draft, about: Subject, fit: FitResult) -> None:
    memory = held_by(draft, about)
    if not scale_usable(draft, about, fit, memory.scale):
        return
    parts = losses.split(fit)
    wanted = Vector(about, names.SCALE, parts.diagonal, parts.sd[3:6], "", f"scale of {about}")
    stored = representable(wanted)
    set_vector(draft, wanted, stored)
    lose_accel(draft, about, parts, stored, neutral_model(draft.parameters, about).matrix)


def _silence_writers(draft: Draft, pairs: Sequence[Pair]) -> None:
    """Switch off for this session what would write the same parameters; say what cannot be switched off."""
    sensors = {pair.about.sensor for pair in pairs}
    if not sensors:
        return
    if int(draft.parameters.get("SENS_IMU_AUTOCAL", 0)) != 0:
        draft.set_integer(
            "SENS_IMU_AUTOCAL",
            0,
            Rank.SESSION,
            "after a landing PX4 would write its own estimate of the offsets",
            session=True,
        )
    if Sensor.GYRO in sensors and int(draft.parameters.get(GYRO_WRITER, 0)) != 0:
        draft.warn(
            "PX4 re-estimates the gyro offsets by itself while disarmed and still (IMU_GYRO_CAL_EN = 1): it "
            "overwrites them where its estimate differs by more than 0.01 rad/s, and takes a steady turn for a bias. "
            "Setting it to 0 stops this only after a restart"
        )
