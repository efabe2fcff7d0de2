"""Magnetometers whose mounting differs from the vehicle's parameters.

The magnetometer procedure leaves its finding in ``quality["orientation"]``: ``verdict`` (a
:class:`calib.mag.orientation.MountingVerdict`), ``name`` and ``matrix``, the rotation from what is taken for the body
now to the true body. One that is by no right angles comes with its ``covariance`` and with ``askew_deg``, its angle
from the ``nearest`` right-angle one.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from mavcal.calib.firmware.compose.draft import Draft, Rank, Subject
from mavcal.calib.firmware.names import ROTATION_EULER, Role
from mavcal.calib.firmware.options import how, to_confirm
from mavcal.calib.firmware.rotations import ROTATIONS, euler_matrix, nearest_rotation, rotation_matrix, rotation_words
from mavcal.calib.fit import FitResult
from mavcal.calib.mag.free_rotation import Euler, angle_between, euler_angles
from mavcal.calib.mag.orientation import ASKEW, MountingVerdict
from mavcal.calib.recording import Array, Sensor

EXACT = 1e-6  # rad
DECIMALS = 2
"""Decimals of a written angle, degrees, beyond the accuracy of any fit."""
TOLERATED = 20.0
"""Largest angle, degrees, at which the stated mounting may be kept; the plan then states the misalignment."""


@dataclass(frozen=True, eq=False)
class MountingRotation:
    """Correction of a mounting: rotation (3, 3) from the stated body frame to the true one."""

    name: str
    matrix: Array
    covariance: Array | None = None
    """(3, 3) in rad^2 of small turns of the body; None: by right angles, and exact."""
    chosen: bool = False
    """The operator stated the mounting; `name` is then that of the mounting itself, not of what is missing."""

    @property
    def words(self) -> str:
        """The mounting as part of a sentence that begins "mounted"."""
        return f"as chosen ({self.name})" if self.chosen else f"turned by {self.name}"

    @property
    def tolerance(self) -> float:
        """Largest angle, rad, to a numbered rotation of the firmware that still counts as the same mounting."""
        return EXACT if self.covariance is None else ASKEW

    def number(self, autopilot: str, body_from_sensor: Array) -> int | None:
        """The firmware's number of the mounting `body_from_sensor` that results; None: it has none."""
        number, angle = nearest_rotation(autopilot, body_from_sensor)
        return number if angle <= self.tolerance else None


def by_angles(turn: MountingRotation, body_from_sensor: Array) -> tuple[Euler, Array]:
    """The angles to write for a mounting, and the rotation (3, 3) that they make."""
    exact = euler_angles(body_from_sensor, turn.covariance)
    roll, pitch, yaw = (round(angle, DECIMALS) + 0.0 for angle in exact.angles)
    return Euler(roll, pitch, yaw, exact.sd), euler_matrix(roll, pitch, yaw)


def set_angles(
    draft: Draft, about: Subject, names: tuple[str, ...], euler: Euler, *, needs_reboot: bool, hidden: bool
) -> None:
    """Plan three angles of a mounting, each with its standard deviation."""
    sds = euler.sd or (None, None, None)
    for name, word, angle, sd in zip(names, ("roll", "pitch", "yaw"), euler.angles, sds, strict=True):
        draft.set_real(
            name,
            angle,
            Rank.ROTATION,
            f"{about} is mounted at this {word}",
            about=about,
            sd=sd,
            unit="deg",
            needs_reboot=needs_reboot,
            hidden=hidden,
        )


def angle_names(roles: Mapping[Role, str]) -> tuple[str, ...]:
    """The parameters that hold the angles of one sensor alone, roll pitch yaw."""
    return tuple(roles[role] for role in ROTATION_EULER)


def ask_for_mounting(
    draft: Draft, autopilot: str, about: Subject, turn: MountingRotation, change: tuple[str, int, int], angles: str = ""
) -> None:
    """Block the plan until the change of a rotation parameter (name, old, new) is confirmed.

    `angles`: meaning of the new number if it is not in the firmware's table.
    """
    name, old, new = change
    stated = rotation_words(autopilot, old)
    found = f"compass {about.instance + 1} is mounted {turn.words}"
    if stated != "none" and not turn.chosen:
        found += f" against what {name} says ({stated})"
    step = f"{name} changes from {old} ({stated}) to {new} ({angles or rotation_words(autopilot, new)})"
    if draft.options.confirm_mounting:
        draft.warn(f"{found}, as confirmed: {step}", first=True)
    else:
        draft.block(f"{found}: {step}. Look at it. {to_confirm('confirm_mounting')}")


def mounting_turn(
    draft: Draft, autopilot: str, about: Subject, fit: FitResult, stated: Array, *, follows: str
) -> MountingRotation | None:
    """The rotation by which the stated mounting is wrong; None: it is right, or undetermined.

    `stated` (3, 3) takes the sensor to the body. `follows`: the parameter of the board that an internal compass
    follows; empty: the compass has its own.
    """
    chosen = draft.options.mountings.get((Sensor.MAG, about.instance))
    if chosen is not None:
        return _as_chosen(draft, (autopilot, chosen), about, fit, stated, follows)
    found = fit.quality.get("orientation")
    if not found:
        return None
    verdict = MountingVerdict(found["verdict"])
    matrix = np.array(found.get("matrix", np.eye(3)), dtype=np.float64)
    name = str(found.get("name", "")).replace("_", " ")
    if verdict == MountingVerdict.UNEXPLAINED:
        draft.block(
            f"{about}: no mounting makes its field agree with the accelerometer. Calibrate the accelerometer first",
            about,
        )
    elif verdict == MountingVerdict.MIRRORED:
        draft.block(f"{about}: {found.get('message', 'its axes are mirrored')}", about)
    elif verdict == MountingVerdict.AMBIGUOUS:
        draft.warn(f"{about}: its movement does not show whether it is mounted as stated; tilt further to all sides")
    elif verdict == MountingVerdict.ROTATED:
        return MountingRotation(name, matrix)
    elif verdict == MountingVerdict.BY_ANGLES:
        turn = MountingRotation(name, matrix, np.array(found["covariance"], dtype=np.float64))
        if found["nearest"] == "none" and float(found["askew_deg"]) <= TOLERATED:
            return _small_rotation(draft, about, turn, float(found["askew_deg"]), follows)
        return turn
    return None


def _as_chosen(
    draft: Draft, rotation: tuple[str, int], about: Subject, fit: FitResult, stated: Array, follows: str
) -> MountingRotation | None:
    """The rotation to the mounting that the operator chose, unless the data contradict it."""
    words, compass = rotation_words(*rotation), f"compass {about.instance + 1}"
    if follows:
        draft.block(f"{compass} follows {follows}: it has no mounting of its own that could be chosen.")
        return None
    if "orientation" not in fit.quality:
        draft.block(
            f"{compass}: this calibration took the mounting for granted, so none can be chosen now. "
            "Set its parameter, then calibrate again."
        )
        return None
    if rotation[1] >= len(ROTATIONS[rotation[0]]):
        draft.block(f"{compass}: this autopilot has no mounting rotation {rotation[1]} to choose.")
        return None
    turn = MountingRotation(words, rotation_matrix(*rotation) @ stated.T, chosen=True)
    found = fit.quality["orientation"] or {"verdict": MountingVerdict.AMBIGUOUS}
    if found["verdict"] == MountingVerdict.AMBIGUOUS:
        draft.warn(f"{compass}: its movement does not show how it is mounted; nothing proves the chosen {words}")
    else:
        seen = np.array(found.get("matrix", np.eye(3)), dtype=np.float64)
        apart = math.degrees(angle_between(seen, turn.matrix))
        if apart > TOLERATED:
            draft.block(
                f"{compass}: the chosen mounting ({words}) is {apart:.0f} deg from the one that its movement shows. "
                "Choose what it shows, or turn the vehicle again."
            )
            return None
    return turn if angle_between(turn.matrix, np.eye(3)) > EXACT else None


def _small_rotation(
    draft: Draft, about: Subject, turn: MountingRotation, askew: float, follows: str
) -> MountingRotation | None:
    """The correction of a small mounting error, which the operator must confirm; None if the stated mounting stays."""
    if follows:
        draft.warn(
            f"{about} is mounted {askew:.0f} deg askew (turned by {turn.name}) and follows {follows}: it has no angles "
            "of its own. Mount the board square, or calibrate the accelerometer if that is what is off"
        )
        return None
    if draft.options.confirm_mounting:
        return turn
    draft.warn(
        f"{about} is mounted {askew:.0f} deg askew, turned by {turn.name}: look at it; {how('confirm_mounting')} "
        "writes these angles"
    )
    return None
