"""Poses: recognised from gravity, counted, and the next one that carries most information.

Of a vehicle that is put down square: which face it lies on, and how far from square.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mavcal.calib.procedures.motion import StillWatch
from mavcal.calib.procedures.protocol import Pose, Prompt, PromptStep, Tilt
from mavcal.calib.recording import Array, Sensor

FACES = (Pose.LEVEL, Pose.LEFT, Pose.RIGHT, Pose.NOSE_DOWN, Pose.NOSE_UP, Pose.BACK)

DOWN = {
    Pose.LEVEL: (0.0, 0.0, 1.0),
    Pose.LEFT: (0.0, -1.0, 0.0),
    Pose.RIGHT: (0.0, 1.0, 0.0),
    Pose.NOSE_DOWN: (1.0, 0.0, 0.0),
    Pose.NOSE_UP: (-1.0, 0.0, 0.0),
    Pose.BACK: (0.0, 0.0, -1.0),
}
"""The body direction (FRD) that points down in each face."""

TEXTS = {
    Pose.LEVEL: "level",
    Pose.LEFT: "on its left side",
    Pose.RIGHT: "on its right side",
    Pose.NOSE_DOWN: "nose down",
    Pose.NOSE_UP: "nose up",
    Pose.BACK: "on its back",
    Pose.OBLIQUE: "tilted",
}

FACE_WITHIN = math.radians(22.0)
"""Angle, rad, to a face beyond which a pose is oblique: half of the angle between a face and the edge between two
faces."""

WEIGHTLESS = 1.0
"""Least reading of an accelerometer, m/s2, that shows the vertical; with less it is dead or in free fall."""

APART = math.radians(20.0)
"""Angle, rad, below which two oblique poses count as one."""

_FACE_DIRECTIONS = np.array([DOWN[face] for face in FACES])
_CANDIDATES = np.array([v for v in itertools.product((-1.0, 0.0, 1.0), repeat=3) if np.count_nonzero(v) > 1])
_CANDIDATES /= np.linalg.norm(_CANDIDATES, axis=1)[:, None]
SQUARE_WITHIN = math.radians(12.0)
"""Angle, rad, above which a face was not put down square: an uncalibrated accelerometer errs by less."""

PLACED_S = 3.0
"""Least time of a face that a prompt states, s."""

_DIRECTIONS = np.array([DOWN[face] for face in FACES])


def any_of(poses: Sequence[Pose]) -> str:
    """The poses in words, for a prompt: the person chooses the order while several are left.

    >>> any_of([Pose.LEVEL, Pose.NOSE_UP])
    'level, nose up, in any order'
    >>> any_of([Pose.NOSE_UP])
    'nose up'
    """
    words = ", ".join(TEXTS[pose] for pose in poses)
    return f"{words}, in any order" if len(poses) > 1 else words


def down(specific_force: Array) -> Array:
    """Unit vector of the body direction that points down: at rest the specific force points up.

    `specific_force` must be larger than :data:`WEIGHTLESS`.
    """
    return np.asarray(-specific_force / np.linalg.norm(specific_force), dtype=np.float64)


def angle(a: Array, b: Array) -> float:
    """Between two unit vectors, rad."""
    return math.acos(float(np.clip(a @ b, -1.0, 1.0)))


def recognise(direction: Array) -> Pose:
    """The face that `direction` (unit, points down) belongs to, or an oblique pose.

    >>> recognise(np.array([0.1, 0.0, 0.995]))
    <Pose.LEVEL: 'level'>
    """
    along = _FACE_DIRECTIONS @ direction
    nearest = int(along.argmax())
    return FACES[nearest] if along[nearest] >= math.cos(FACE_WITHIN) else Pose.OBLIQUE


def remaining(taken: Iterable[Array], obliques: int) -> tuple[Pose, ...]:
    """Faces without a direction in `taken`, and the oblique poses still missing of `obliques`."""
    directions = list(taken)
    poses = {recognise(d) for d in directions}
    faces = tuple(face for face in FACES if face not in poses)
    return faces + (Pose.OBLIQUE,) * max(0, obliques - len(distinct_obliques(directions)))


def distinct_obliques(directions: Iterable[Array]) -> list[Array]:
    """The oblique directions that lie at least :data:`APART` from each other."""
    kept: list[Array] = []
    for direction in directions:
        if recognise(direction) == Pose.OBLIQUE and all(angle(direction, k) >= APART for k in kept):
            kept.append(direction)
    return kept


def suggest(taken: Sequence[Array]) -> tuple[float, float, float]:
    """Oblique direction with the most information on the cross terms, as the body direction to point down.

    A cross term ``c_ij`` changes the length of ``C u`` by ``2 c_ij u_i u_j``, so a pose and its opposite are
    equivalent. A pose near a taken one would not count as new, so it is suggested only if there is no other.
    """
    seen = _crosses(np.array(taken).reshape(-1, 3))
    information = seen.T @ seen + 1e-3 * np.eye(3)
    asked = _crosses(_CANDIDATES)
    gain = np.einsum("ki,ij,kj->k", asked, np.linalg.inv(information), asked)
    nearest = (_CANDIDATES @ np.array(taken).reshape(-1, 3).T).max(axis=1, initial=-1.0)
    fresh = nearest < math.cos(APART)
    gain = np.where(fresh, gain, -nearest)
    best = _CANDIDATES[int(np.round(gain, 6).argmax())]
    return float(best[0]), float(best[1]), float(best[2])


def tilts(taken: Iterable[Array], obliques: int) -> tuple[Tilt, ...]:
    """The oblique poses of `taken`, then the missing ones of `obliques` in order of their information."""
    kept = distinct_obliques(taken)
    asked: list[tuple[float, float, float]] = []
    while len(kept) + len(asked) < obliques:
        asked.append(suggest([*kept, *(np.array(one) for one in asked)]))
    done = tuple(Tilt((float(x), float(y), float(z)), taken=True) for x, y, z in kept)
    return done + tuple(Tilt(one, taken=False) for one in asked)


def _crosses(directions: Array) -> Array:
    x, y, z = directions.T
    return np.column_stack([x * y, x * z, y * z])


@dataclass(frozen=True, eq=False)
class Facing:
    """The face nearest to the body direction `down` (3,), and its angle from square, rad."""

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
    """The face that points down along `direction` (unit, body)."""
    nearest = int((_DIRECTIONS @ direction).argmax())
    return Facing(FACES[nearest], direction, angle(direction, _DIRECTIONS[nearest]))


def place(faces: tuple[Pose, ...], note: str, *, suffix: str = "") -> Prompt:
    """The prompt to put the vehicle down on the first of `faces`, or any other of them."""
    text = f"{note}Put the vehicle down square {any_of(faces)}{suffix}, and let go."
    return Prompt(PromptStep.PLACE, text, pose=faces[0], remaining=faces, hold_s=PLACED_S)
