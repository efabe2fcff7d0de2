"""Turns magnetometer fits into PX4's parameters (FLIGHT_CONTROLLERS 1.4).

``b = L R S (m + p COMP - OFF)``: the offset is *subtracted*, in Gauss, in the *sensor's* frame, which is that of the
raw stream. The whole symmetric matrix can be stored, if it differs enough from the neutral one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.firmware import losses, names
from mavcal.calib.firmware.compose.announce import compass_usable, field_plausible, lose_compass_mounting
from mavcal.calib.firmware.compose.draft import Draft, Rank, Subject
from mavcal.calib.firmware.compose.fitted import Pair
from mavcal.calib.firmware.compose.mounting import (
    MountingRotation,
    angle_names,
    ask_for_mounting,
    by_angles,
    mounting_turn,
    set_angles,
)
from mavcal.calib.firmware.compose.px4 import set_row
from mavcal.calib.firmware.compose.px4_memory import Vector, neutral_model, placed, representable, row_of, set_vector
from mavcal.calib.firmware.names import Role
from mavcal.calib.firmware.px4 import parameters as px4
from mavcal.calib.firmware.px4.parameters import UT_PER_GAUSS
from mavcal.calib.firmware.rotations import rotation_matrix, rotation_words
from mavcal.calib.fit import FitResult
from mavcal.calib.mag.free_rotation import Euler

Array = NDArray[np.float64]

EARTH_FIELD = 50.0
"""Field strength, uT, for the cost of a loss if the field is unknown."""


def compose_magnetometers(draft: Draft, pairs: Sequence[Pair]) -> None:
    """Plan every magnetometer that was fitted."""
    for pair in pairs:
        if pair.at_rest is not None and set_row(draft, pair.about):
            _compose_one(draft, pair.about, pair.at_rest)
    if pairs and int(draft.parameters.get("SENS_MAG_AUTOCAL", 0)) != 0:
        draft.set_integer(
            "SENS_MAG_AUTOCAL", 0, Rank.SESSION, "PX4 would write its own estimate of the offsets", session=True
        )


def _compose_one(draft: Draft, about: Subject, fit: FitResult) -> None:
    if not compass_usable(draft, about, fit, "PX4's offsets are in Gauss"):
        return
    roles = row_of(draft, about)
    if not _mounting_as_captured(draft, about, roles):
        return
    internal = int(draft.get(roles[Role.ROTATION], -1)) < 0
    before = neutral_model(draft.parameters, about).matrix
    stated = px4.level_adjustment(draft.parameters).T @ before
    turn = mounting_turn(draft, "px4", about, fit, stated, follows="SENS_BOARD_ROT" if internal else "")
    after = before if turn is None else _set_rotation(draft, about, roles, turn, before)
    if after is None:
        return
    parts = losses.split(fit)
    if not field_plausible(draft, about, fit, parts):
        return
    wanted = {
        names.OFFSET: Vector(
            about, names.OFFSET, parts.offset / UT_PER_GAUSS, parts.sd[:3] / UT_PER_GAUSS, "gauss", f"offset of {about}"
        ),
        names.SCALE: Vector(about, names.SCALE, parts.diagonal, parts.sd[3:6], "", f"scale of {about}"),
        names.CROSS: Vector(about, names.CROSS, parts.cross, parts.sd[6:], "", f"off-diagonal term of {about}"),
    }
    stored = {triple: representable(vector) for triple, vector in wanted.items()}
    for triple, vector in wanted.items():
        set_vector(draft, vector, stored[triple])
    _lose(draft, about, fit, parts, wanted, stored)
    lose_compass_mounting(draft, about, fit, before, after)


def _lose(
    draft: Draft,
    about: Subject,
    fit: FitResult,
    parts: losses.Parts,
    wanted: Mapping[names.Triple, Vector],
    stored: Mapping[names.Triple, Array],
) -> None:
    """Announce the vectors that are too near to neutral to be taken."""
    radius, ratio = fit.quality.get("radius"), fit.quality.get("field_ratio")
    field = float(radius) / float(ratio) if radius and ratio else EARTH_FIELD
    xy, xz, yz = stored[names.CROSS]
    matrix = np.diag(stored[names.SCALE]) + np.array([[0, xy, xz], [xy, 0, yz], [xz, yz, 0]])
    dropped = [
        what
        for what, triple in (("scale", names.SCALE), ("cross terms", names.CROSS))
        if not np.allclose(stored[triple], wanted[triple].values, rtol=1e-6, atol=1e-7)
    ]
    if dropped:
        cost = losses.largest_error(matrix, parts.symmetric, field)
        draft.lose(
            about,
            " and ".join(dropped),
            cost,
            "uT",
            f"{about}: {' and '.join(dropped)} within 0.01 of neutral never reach PX4's memory; up to "
            f"{cost:.2f} uT stay",
        )
    missing = stored[names.OFFSET] - wanted[names.OFFSET].values
    if not np.allclose(missing, 0.0, rtol=0, atol=1e-6):
        cost = UT_PER_GAUSS * float(np.linalg.norm(matrix @ missing))
        draft.lose(
            about,
            "offset",
            cost,
            "uT",
            f"{about}: an offset of less than 0.005 gauss never reaches PX4's memory; {cost:.2f} uT stay",
        )


def _mounting_as_captured(draft: Draft, about: Subject, roles: Mapping[Role, str]) -> bool:
    """Whether the row has, or will have, the mounting assumed in the capture: that of the row by order."""
    if placed(draft, about, draft.parameters) == about:
        return True
    by_order = px4.calibration_names(draft.parameters, about.sensor, about.instance)[Role.ROTATION]
    name = roles[Role.ROTATION]
    taken, stated = (int(draft.parameters.get(each, -1)) for each in (by_order, name))
    if taken == stated:
        return True
    if taken >= px4.ROTATION_CUSTOM or draft.parameters.get(roles[Role.ID], 0):
        draft.block(
            f"{about} was turned as if it were mounted as {by_order} says ({taken}), but its own row is another and "
            f"{name} is {stated}. Set {by_order} to {stated}, and calibrate again",
            about,
        )
        return False
    draft.set_integer(name, taken, Rank.ROTATION, f"{about} is mounted as {by_order} says", about=about)
    return True


def _set_rotation(
    draft: Draft, about: Subject, roles: Mapping[Role, str], turn: MountingRotation, before: Array
) -> Array | None:
    """Plan the mounting after `turn` of `before` (L R); returns the one in force (3, 3), None if impossible.

    The level adjustment L of the board acts behind the sensor's own rotation R: ``L R' = T L R``.
    """
    name = roles[Role.ROTATION]
    number = int(draft.get(name, -1))
    if number < 0:
        draft.block(
            f"{about} is internal and follows SENS_BOARD_ROT, but its field is turned by {turn.name} against the "
            "accelerometer: the board's orientation is wrong, or the sensor is external and not known as such",
            about,
        )
        return None
    level = px4.level_adjustment(draft.parameters)
    # right angles are not turned by the level, a degree or two, which they do not know
    wanted = level.T @ turn.matrix @ before if turn.covariance is not None else turn.matrix @ level.T @ before
    new, custom = turn.number("px4", wanted), angle_names(roles)
    if new is None:
        euler, own = by_angles(turn, wanted)
        ask_for_mounting(
            draft,
            "px4",
            about,
            turn,
            (name, number, px4.ROTATION_CUSTOM),
            f"{rotation_words('px4', px4.ROTATION_CUSTOM)}: {euler}",
        )
        _set_number(draft, about, name, px4.ROTATION_CUSTOM, turn)  # angles beside another number would become custom
        set_angles(draft, about, custom, euler, needs_reboot=False, hidden=False)
        return np.asarray(level @ own)
    ask_for_mounting(draft, "px4", about, turn, (name, number, new))
    if px4.by_angles(draft.parameters, roles):
        set_angles(draft, about, custom, Euler(0.0, 0.0, 0.0), needs_reboot=False, hidden=False)
    _set_number(draft, about, name, new, turn)
    return np.asarray(level @ rotation_matrix("px4", new))


def _set_number(draft: Draft, about: Subject, name: str, number: int, turn: MountingRotation) -> None:
    draft.set_integer(name, number, Rank.ROTATION, f"{about} is mounted {turn.words}", about=about)
