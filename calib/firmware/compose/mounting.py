"""A magnetometer whose mounting differs from what the vehicle's parameters say.

The magnetometer procedure leaves its finding in ``quality["orientation"]``: ``verdict`` (a
:class:`calib.mag.orientation.MountingVerdict`), ``name`` and ``matrix``, the rotation from what is taken for the body
now to the true body.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.firmware.compose.draft import Draft, Subject
from mavcal.calib.firmware.options import to_confirm
from mavcal.calib.firmware.rotations import rotation_words
from mavcal.calib.fit import FitResult
from mavcal.calib.mag.orientation import MountingVerdict

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class MountingRotation:
    """Rotation (3, 3) that is missing between the stated and the true body frame."""

    name: str
    matrix: Array


def ask_for_mounting(
    draft: Draft, autopilot: str, about: Subject, turn: MountingRotation, change: tuple[str, int, int]
) -> None:
    """Say in words that a rotation parameter changes (name, old, new); nothing is written before that is confirmed."""
    name, old, new = change
    stated = rotation_words(autopilot, old)
    found = f"compass {about.instance + 1} is mounted turned by {turn.name}"
    if stated != "none":
        found += f" against what {name} says ({stated})"
    step = f"{name} changes from {old} ({stated}) to {new} ({rotation_words(autopilot, new)})"
    if draft.options.confirm_mounting:
        draft.warn(f"{found}, as confirmed: {step}", first=True)
    else:
        draft.block(f"{found}: {step}. Look at it. {to_confirm('confirm_mounting')}")


def mounting_turn(draft: Draft, about: Subject, fit: FitResult) -> MountingRotation | None:
    """The rotation to put right; None: the mounting is as stated, or nothing was found out about it."""
    found = fit.quality.get("orientation")
    if not found:
        return None
    verdict = MountingVerdict(found["verdict"])
    if verdict == MountingVerdict.UNEXPLAINED:
        draft.block(
            f"{about}: no right-angle mounting makes its field agree with the accelerometer. Calibrate the "
            "accelerometer first; if it stays, the compass is mounted at an odd angle: set its rotation",
            about,
        )
    elif verdict == MountingVerdict.AMBIGUOUS:
        draft.warn(f"{about}: its movement does not show whether it is mounted as stated; tilt further to all sides")
    elif verdict == MountingVerdict.ROTATED:
        return MountingRotation(str(found["name"]).replace("_", " "), np.array(found["matrix"], dtype=np.float64))
    return None
