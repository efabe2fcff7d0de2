"""Fits into PX4's accelerometer and gyroscope parameters (FLIGHT_CONTROLLERS 1.4).

``b = L R [(a - TC(T) - OFF) o SCALE]``. Rows are matched by device id; small changes do not reach the memory that
corrects (:mod:`calib.firmware.compose.px4_memory`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.errors import FirmwareError
from mavcal.calib.firmware import losses, names
from mavcal.calib.firmware.compose.announce import lose_accel, lose_gyro_matrix, offsets_usable, scale_usable
from mavcal.calib.firmware.compose.draft import Draft, Rank, Subject
from mavcal.calib.firmware.compose.fitted import Pair, offset_at
from mavcal.calib.firmware.compose.px4_memory import (
    Vector,
    held_by,
    neutral_model,
    order_without_restart,
    representable,
    row_of,
    set_vector,
    survives_restart,
)
from mavcal.calib.firmware.compose.px4_thermal import add_constant, set_thermal, thermal_runs, thermal_term
from mavcal.calib.firmware.names import Role
from mavcal.calib.firmware.options import how
from mavcal.calib.firmware.plan import ParameterKind
from mavcal.calib.fit import AXES, FitResult
from mavcal.calib.recording import Sensor

Array = NDArray[np.float64]

GYRO_WRITER: Final = "IMU_GYRO_CAL_EN"
"""Whether PX4 starts its gyro_calibration; read at the start only, so that setting it to 0 stops nothing."""
RESTING: Final = "beside CAL_GYRO's, which PX4's gyro_calibration keeps right until the restart"


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
    draft.set_integer(
        roles[Role.ID], device, Rank.ID, f"the row belongs to {about}", kind=ParameterKind.INT32, about=about
    )
    return True


def _row_is_free(draft: Draft, about: Subject, name: str, held: int, filled: int) -> bool:
    """Whether the row by order may be taken, which holds the id `held`; else the sensor is refused.

    Rows that hold an id are not always those of the sensors that stream: PX4 keeps the id of one that was taken away.
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
    """Whether PX4 would rewrite a new gyro offset between its write and the restart that starts the compensation.

    Its gyro_calibration compares the offset with the mean of the gyro at the present temperature, 5 s after every
    change. An offset that is right with the compensation only would not last until the restart; the one in force would.
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
            kind=ParameterKind.INT32,
            session=True,
        )
    if Sensor.GYRO in sensors and int(draft.parameters.get(GYRO_WRITER, 0)) != 0:
        draft.warn(
            "PX4 re-estimates the gyro offsets by itself while disarmed and still (IMU_GYRO_CAL_EN = 1): it "
            "overwrites them where its estimate differs by more than 0.01 rad/s, and takes a steady turn for a bias. "
            "Setting it to 0 stops this only after a restart"
        )
