"""Turns compass fits into ArduPilot's parameters (FLIGHT_CONTROLLERS 1.3).

``c = M (s (R m + OFS)) + MOT``: the offset is *added*, in mGauss, in the *body* frame. A fit in the raw sensor frame
(``C (m - b)``) is therefore turned into the body first: ``M = R S R^T``, ``OFS = -R b``. The whole symmetric matrix can
be stored.

The strength of the field goes into M. COMPASS_SCALE is written 1 where the true field was known, and 0 ("not set")
where it was not; both multiply by 1. The 1 tells the estimator that the scale is true: EKF3 asks ``have_scale_factor``
before it trusts its table of the Earth's field.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from mavcal.calib.firmware import losses, names
from mavcal.calib.firmware.ardupilot import parameters as ardupilot
from mavcal.calib.firmware.ardupilot.parameters import UT_PER_MGAUSS
from mavcal.calib.firmware.compose.announce import compass_usable, field_plausible, lose_compass_mounting
from mavcal.calib.firmware.compose.ardupilot_mark import mark_calibrated
from mavcal.calib.firmware.compose.draft import Draft, Rank, Subject
from mavcal.calib.firmware.compose.fitted import Pair, body_from_raw
from mavcal.calib.firmware.compose.mounting import (
    MountingRotation,
    ask_for_mounting,
    by_angles,
    mounting_turn,
    set_angles,
)
from mavcal.calib.firmware.limits import COMPASS_OFFS_MAX, COMPASS_SCALE_WINDOW
from mavcal.calib.firmware.names import Role
from mavcal.calib.firmware.rotations import rotation_matrix, rotation_words
from mavcal.calib.fit import AXES, FitResult
from mavcal.calib.mag.free_rotation import Euler
from mavcal.calib.recording import Array, Sensor


def compose_compasses(draft: Draft, pairs: Sequence[Pair]) -> None:
    """Plan every compass that was fitted."""
    fitted = [(p.about, p.at_rest) for p in pairs if p.at_rest is not None]
    for about, fit in fitted:
        _compose_one(draft, about, fit)
    if not fitted:
        return
    if int(draft.parameters.get("COMPASS_LEARN", 0)) != 0:
        draft.set_integer(
            "COMPASS_LEARN",
            0,
            Rank.SESSION,
            "learning would overwrite the offsets (ArduPilot's own calibration switches it off too)",
        )
    mark_calibrated(draft, Sensor.MAG, {about.instance for about, _ in fitted})


def _compose_one(draft: Draft, about: Subject, fit: FitResult) -> None:
    roles = ardupilot.calibration_names(draft.parameters, Sensor.MAG, about.instance)
    if not compass_usable(draft, about, fit, "ArduPilot's offsets are in mGauss"):
        return
    old = body_from_raw(ardupilot.calibration_in_force, roles, draft.parameters, about)
    internal = int(draft.parameters.get(roles[Role.EXTERNAL], 0)) == 0
    turn = mounting_turn(draft, "ardupilot", about, fit, old, follows="AHRS_ORIENTATION" if internal else "")
    new = old if turn is None else _set_rotation(draft, about, roles, turn, turn.matrix @ old)
    if new is None:
        return
    parts = losses.split(fit).rotated(new)
    accepted = f"; ArduPilot accepts a factor of {COMPASS_SCALE_WINDOW[1]:g} at most"
    if not (field_plausible(draft, about, fit, parts, accepted) and _offset_usable(draft, about, parts)):
        return
    _set_values(draft, about, roles, parts)
    lose_compass_mounting(draft, about, fit, old, new)
    absolute = fit.quality.get("field_ratio") is not None
    draft.set_real(
        roles[Role.FIELD_SCALE],
        1.0 if absolute else 0.0,
        Rank.FIELD_SCALE,
        "the matrix holds the true strength of the field" if absolute else "the strength of the field is not known",
        about=about,
    )
    _carry_motors(draft, about, roles, fit, parts.symmetric, new @ old.T)


def _set_rotation(
    draft: Draft, about: Subject, roles: Mapping[Role, str], turn: MountingRotation, body_from_sensor: Array
) -> Array | None:
    """Plan the mounting `body_from_sensor`, by number or by angles; what will be in force (3, 3), None if it cannot."""
    if int(draft.parameters.get(roles[Role.EXTERNAL], 0)) == 0:
        draft.block(
            f"{about} is internal and follows AHRS_ORIENTATION, but its field is turned by {turn.name} against the "
            "accelerometer: it is external (set "
            f"{roles[Role.EXTERNAL]} to 1 and repeat) or the board's orientation is wrong",
            about,
        )
        return None
    name = roles[Role.ROTATION]
    before, number, angles = int(draft.parameters.get(name, 0)), turn.number("ardupilot", body_from_sensor), ""
    if number is None:
        number = _free_custom(draft, about, name)
        if number is None:
            return None
        euler, in_force = by_angles(turn, body_from_sensor)
        angles = f"{rotation_words('ardupilot', number)}: {euler}"
        _set_custom(draft, about, number, euler)
    else:
        in_force = rotation_matrix("ardupilot", number)
    ask_for_mounting(draft, "ardupilot", about, turn, (name, before, number), angles)
    draft.set_integer(
        name,
        number,
        Rank.ROTATION,
        f"{about} is mounted {turn.words}; offsets and matrix are for this mounting",
        about=about,
    )
    return in_force


def _set_custom(draft: Draft, about: Subject, number: int, euler: Euler) -> None:
    """The angles before the number that calls them: where they were never used they act at once, else after a restart.

    AP_CustomRotations.cpp makes a rotation of its angles when it is first used, and never again before the next boot.
    """
    draft.set_integer(
        names.ARDUPILOT_CUSTOM_SWITCH, 1, Rank.ROTATION, "use rotations by angles", about=about, needs_reboot=True
    )
    set_angles(draft, about, names.ARDUPILOT_CUSTOM[number], euler, needs_reboot=True, hidden=True)


def _free_custom(draft: Draft, about: Subject, own: str) -> int | None:
    """The custom rotation that only this compass uses, or an unused one; None: there is none."""
    if names.ARDUPILOT_CUSTOM_SWITCH not in draft.parameters:
        draft.block(
            f"{about} is mounted at angles that no number of ArduPilot's stands for, and this vehicle has no "
            f"{names.ARDUPILOT_CUSTOM_SWITCH} (ArduPilot 4.3 and later): mount the compass square, or update",
            about,
        )
        return None
    compasses = [f"COMPASS_ORIENT{digit}" for digit in ("", "2", "3")]
    users = [name for name in ("AHRS_ORIENTATION", *compasses) if name != own]
    used = {int(draft.get(name, 0)) for name in users}
    numbers = [n for n in names.ARDUPILOT_CUSTOM if n not in used]
    mine = int(draft.parameters.get(own, 0))
    if mine in numbers:
        return mine
    empty = [n for n in numbers if not any(draft.get(name, 0.0) for name in names.ARDUPILOT_CUSTOM[n])]
    if not empty:
        draft.block(
            f"{about} is mounted at angles that no number of ArduPilot's stands for, and both custom rotations "
            "(CUST_ROT1_*, CUST_ROT2_*) hold angles already: set those to 0 that nothing uses, or mount the compass "
            "square",
            about,
        )
        return None
    return empty[0]


def _offset_usable(draft: Draft, about: Subject, parts: losses.Parts) -> bool:
    length = float(np.linalg.norm(parts.offset)) / UT_PER_MGAUSS
    limit = float(draft.parameters.get("COMPASS_OFFS_MAX", COMPASS_OFFS_MAX))
    if length > limit:
        draft.block(
            f"{about}: the offset is {length:.0f} mGauss long, more than COMPASS_OFFS_MAX = {limit:.0f}; the vehicle "
            "would refuse to arm. Move the compass away from iron and magnets and repeat",
            about,
        )
        return False
    return True


def _set_values(draft: Draft, about: Subject, roles: Mapping[Role, str], parts: losses.Parts) -> None:
    sd = parts.sd
    for axis, role in enumerate(names.OFFSET):
        draft.set_real(
            roles[role],
            float(-parts.offset[axis] / UT_PER_MGAUSS),
            Rank.OFFSET,
            f"offset of {about}, {AXES[axis]} axis of the body (added)",
            about=about,
            sd=float(sd[axis] / UT_PER_MGAUSS) or None,
            unit="mGauss",
        )
    for k, role in enumerate((*names.SCALE, *names.CROSS)):
        diagonal = k < 3
        draft.set_real(
            roles[role],
            float(parts.diagonal[k] if diagonal else parts.cross[k - 3]),
            Rank.SCALE if diagonal else Rank.CROSS,
            f"{'diagonal' if diagonal else 'off-diagonal'} term of the matrix of {about}",
            about=about,
            sd=float(sd[3 + k]) or None,
        )


def _carry_motors(
    draft: Draft, about: Subject, roles: Mapping[Role, str], fit: FitResult, matrix: Array, turn: Array
) -> None:
    """The motor term is added behind the matrix, so it is carried into the new one: ``M' X M^-1 MOT``."""
    kind = int(draft.parameters.get(roles[Role.MOTOR_TYPE], 0))
    old = np.array([float(draft.parameters.get(roles[role], 0.0)) for role in names.MOTOR])
    if kind not in (1, 2) or not old.any():
        return
    in_force = ardupilot.calibration_in_force(draft.parameters, Sensor.MAG, about.instance).matrix
    mounting = body_from_raw(ardupilot.calibration_in_force, roles, draft.parameters, about)
    new = matrix @ turn @ np.linalg.solve(in_force @ mounting.T, old)
    for axis, role in enumerate(names.MOTOR):
        draft.set_real(
            roles[role],
            float(new[axis]),
            Rank.SETTING,
            f"the motor compensation of {about}, carried over to its new matrix",
            about=about,
            unit="mGauss" if kind == 1 else "mGauss/A",
        )
    if kind == 2 and not fit.native.get("without_motors", False):
        draft.warn(
            f"{about}: the field of the idle current ({np.linalg.norm(new):.2g} mGauss per A) is part of the new "
            "offset and is compensated a second time; calibrate without load"
        )
