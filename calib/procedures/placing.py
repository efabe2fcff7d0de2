"""A vehicle that is put down square on its faces: which face it is on, and how far from square."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from mavcal.calib.procedures.motion import StillWatch
from mavcal.calib.procedures.poses import DOWN, FACES, WEIGHTLESS, angle, any_of, down
from mavcal.calib.procedures.protocol import Pose, Prompt, PromptStep
from mavcal.calib.recording import Array, Sensor

SQUARE_WITHIN = math.radians(12.0)
"""A face that looks further off than this was not put down square: an uncalibrated accelerometer errs by less."""

PLACED_S = 3.0
"""What a prompt says of how long a face is needed at least, s."""

_DIRECTIONS = np.array([DOWN[face] for face in FACES])


@dataclass(frozen=True, eq=False)
class Facing:
    """The face that is nearest to the body direction `down` (3,), and how far that is from square, rad."""

    face: Pose
    down: Array
    off: float

    @property
    def square(self) -> bool:
        """Whether the vehicle lies square enough to count as on this face."""
        return self.off <= SQUARE_WITHIN


def down_direction(watch: StillWatch, body: Mapping[int, Array], instances: Iterable[int]) -> Array | None:
    """Direction of down in the body (3,), from the first of `instances` that shows gravity; None: none does.

    `body` are the rotations from the raw frame of every accelerometer to the body.
    """
    for instance in instances:
        latest = watch.latest.get((Sensor.ACCEL, instance))
        if latest is not None and np.linalg.norm(latest.mean) > WEIGHTLESS:
            return down(body[instance] @ latest.mean)
    return None


def facing(direction: Array) -> Facing:
    """Which face points down along `direction` (unit, body)."""
    nearest = int((_DIRECTIONS @ direction).argmax())
    return Facing(FACES[nearest], direction, angle(direction, _DIRECTIONS[nearest]))


def place(faces: tuple[Pose, ...], note: str, *, suffix: str = "") -> Prompt:
    """The prompt to put the vehicle down on the first of `faces`, or any other of them."""
    text = f"{note}Put the vehicle down square {any_of(faces)}{suffix}, and let go."
    return Prompt(PromptStep.PLACE, text, pose=faces[0], remaining=faces, hold_s=PLACED_S)
