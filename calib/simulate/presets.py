"""Motions by name: those that the calibration methods need."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.simulate.motion import Leg, hold, ramp, spin, turn, weave

Array = NDArray[np.float64]

FACES: Mapping[str, Rotation] = MappingProxyType(
    {
        "level": Rotation.identity(),
        "left": Rotation.from_euler("x", -90, degrees=True),
        "right": Rotation.from_euler("x", 90, degrees=True),
        "nose_down": Rotation.from_euler("y", -90, degrees=True),
        "nose_up": Rotation.from_euler("y", 90, degrees=True),
        "back": Rotation.from_euler("x", 180, degrees=True),
    }
)
"""Attitudes of the six faces by MAVLink's names: lying on its left side, the left side is down."""

_MOVE = 2.0  # s, from one pose to the next
_SETTLE = 0.5  # s, still before and after what counts
_TABLE_RATE = np.radians(90.0)  # rad/s, of the turntable
_TURNS = 10  # of the thread


@dataclass(frozen=True, eq=False)
class MotionPreset:
    """Legs, and the attitude in which they begin."""

    legs: tuple[Leg, ...]
    start: Rotation


@dataclass(frozen=True)
class MotionOptions:
    """Options of a motion; None: the motion's own value.

    `duration` is the length in seconds of a rest, a tumble, a warm-up or a figure of eight. For the others it is that
    of every pose, ring and turn. `poses` are the oblique ones beside the six faces. `fixture_sd` is the tilt of every
    held face about each horizontal axis, degrees. `back`: faces and poses are visited again in reverse order, so that
    temperature and pose are not confounded.
    """

    duration: float | None = None
    poses: int = 10
    fixture_sd: float = 0.0
    back: bool = False

    def __post_init__(self) -> None:
        length = 1.0 if self.duration is None else self.duration
        if not (np.isfinite(length) and length > 0.0 and self.poses >= 0 and 0.0 <= self.fixture_sd < 45.0):
            raise InvalidInputError(
                f"a duration is positive, poses and the tilt of the fixture (below 45 deg) are not negative: "
                f"{self.duration}, {self.poses}, {self.fixture_sd}"
            )


Maker = Callable[[MotionOptions, np.random.Generator], MotionPreset]


def rest(options: MotionOptions, rng: np.random.Generator) -> MotionPreset:
    """Level and still."""
    return MotionPreset((hold(options.duration or 60.0, "level"),), _held([FACES["level"]], options, rng)[0])


def six_faces(options: MotionOptions, rng: np.random.Generator) -> MotionPreset:
    """The six faces in turn, labelled by their names."""
    return _visited(list(FACES), _held(list(FACES.values()), options, rng), options)


def poses(options: MotionOptions, rng: np.random.Generator) -> MotionPreset:
    """The six faces and oblique poses, all labelled."""
    oblique = [Rotation.from_quat(q / np.linalg.norm(q)) for q in rng.normal(size=(options.poses, 4))]
    names = [*FACES, *(f"pose{k + 1}" for k in range(options.poses))]
    return _visited(names, _held([*FACES.values(), *oblique], options, rng), options)


def tumble(options: MotionOptions, rng: np.random.Generator) -> MotionPreset:
    """A motion through all directions, never still: yaw, pitch and roll at incommensurate speeds and random phases."""
    phase = rng.uniform(0.0, 2.0 * np.pi, 3)
    speeds = np.array([0.61803, 0.41421, 1.17320])

    def angles(t: Array) -> tuple[Array, Array]:
        p = t[:, None] * speeds + phase
        value = np.column_stack([p[:, 0], 1.4 * np.sin(p[:, 1]), p[:, 2]])
        slope = np.tile(speeds, (len(t), 1))
        slope[:, 1] *= 1.4 * np.cos(p[:, 1])
        return value, slope

    return MotionPreset((weave(options.duration or 120.0, angles),), Rotation.identity())


def figure_eight(options: MotionOptions, rng: np.random.Generator) -> MotionPreset:
    """A figure of eight from the wrist, slowly turning: two periods of roll to one of yaw, with pitch between."""
    w = 2.0 * np.pi / 4.0
    phase = float(rng.uniform(0.0, 2.0 * np.pi))

    def angles(t: Array) -> tuple[Array, Array]:
        value = [1.2 * np.sin(w * t) + 0.15 * t, 0.9 * np.sin(0.71 * w * t + phase), 1.3 * np.sin(2.0 * w * t)]
        slope = [
            1.2 * w * np.cos(w * t) + 0.15,
            0.9 * 0.71 * w * np.cos(0.71 * w * t + phase),
            2.6 * w * np.cos(2.0 * w * t),
        ]
        return np.column_stack(value), np.column_stack(slope)

    return MotionPreset((weave(options.duration or 60.0, angles),), Rotation.identity())


def rings(options: MotionOptions, rng: np.random.Generator) -> MotionPreset:
    """One whole turn about the vertical on each of the six faces, labelled by the face."""
    seconds = options.duration or 20.0
    legs: list[Leg] = []
    attitudes = _held(list(FACES.values()), options, rng)
    for k, (name, attitude) in enumerate(zip(FACES, attitudes, strict=True)):
        vertical = attitude.apply([0.0, 0.0, 2.0 * np.pi / seconds], inverse=True)
        legs += _spun_up(vertical, seconds, name)
        if k + 1 < len(attitudes):
            done = attitude * Rotation.from_rotvec(vertical * _SETTLE)  # the ramps add half a second of turning
            legs.append(turn((done.inv() * attitudes[k + 1]).as_rotvec(), _MOVE))
    return MotionPreset(tuple(legs), attitudes[0])


def turntable(options: MotionOptions, rng: np.random.Generator) -> MotionPreset:
    """Each axis down on a turntable that turns at +90 deg/s and then at -90 deg/s; labels ``x+ x- y+ y- z+ z-``."""
    seconds = options.duration or 20.0
    legs: list[Leg] = []
    axes = {"x": "nose_down", "y": "right", "z": "level"}
    attitudes = _held([FACES[face] for face in axes.values()], options, rng)
    for k, (letter, attitude) in enumerate(zip(axes, attitudes, strict=True)):
        rate = np.asarray(attitude.apply([0.0, 0.0, _TABLE_RATE], inverse=True), dtype=np.float64)
        legs += [*_spun_up(rate, seconds, f"{letter}+"), *_spun_up(-rate, seconds, f"{letter}-")]
        if k + 1 < len(attitudes):
            legs.append(turn((attitude.inv() * attitudes[k + 1]).as_rotvec(), _MOVE))
    return MotionPreset(tuple(legs), attitudes[0])


def thread(options: MotionOptions, rng: np.random.Generator) -> MotionPreset:
    """Hung level on a thread: ten whole turns one way, from rest to rest, and ten back; labels ``z+ z-``."""
    seconds = options.duration or 20.0
    start = _held([FACES["level"]], options, rng)[0]
    whole = 2.0 * np.pi * _TURNS * np.asarray(start.apply([0.0, 0.0, 1.0], inverse=True), dtype=np.float64)
    there, back = turn(whole, seconds, "z+"), turn(-whole, seconds, "z-")
    return MotionPreset((hold(_SETTLE), there, hold(_SETTLE), back, hold(_SETTLE)), start)


def warm_up(options: MotionOptions, rng: np.random.Generator) -> MotionPreset:
    """Level and still for twenty minutes, while the temperature moves."""
    return MotionPreset((hold(options.duration or 1200.0),), _held([FACES["level"]], options, rng)[0])


MOTIONS: Mapping[str, Maker] = MappingProxyType(
    {
        "rest": rest,
        "six-faces": six_faces,
        "poses": poses,
        "tumble": tumble,
        "rings": rings,
        "turntable": turntable,
        "thread": thread,
        "warm-up": warm_up,
        "figure-eight": figure_eight,
    }
)
"""Every motion by its name."""


def motion_of(name: str, options: MotionOptions, rng: np.random.Generator) -> MotionPreset:
    """The motion called `name`; `rng` draws oblique poses, phases and the fixture's tilt.

    Raises
    ------
    InvalidInputError
        If no motion has that name.
    """
    if name not in MOTIONS:
        raise InvalidInputError(f"a motion is one of {', '.join(MOTIONS)}, not {name!r}")
    return MOTIONS[name](options, rng)


def _held(attitudes: Sequence[Rotation], options: MotionOptions, rng: np.random.Generator) -> list[Rotation]:
    """`attitudes` as a fixture holds them, each slightly tilted about both horizontal axes."""
    if options.fixture_sd == 0.0:
        return list(attitudes)
    tilts = np.radians(options.fixture_sd) * rng.normal(size=(len(attitudes), 2))
    return [Rotation.from_rotvec([a, b, 0.0]) * attitude for (a, b), attitude in zip(tilts, attitudes, strict=True)]


def _visited(names: Sequence[str], attitudes: Sequence[Rotation], options: MotionOptions) -> MotionPreset:
    seconds = options.duration or 5.0
    if options.back:
        names, attitudes = [*names, *names[-2::-1]], [*attitudes, *attitudes[-2::-1]]
    legs = [hold(seconds, names[0])]
    for name, (before, after) in zip(names[1:], pairwise(attitudes), strict=True):
        legs += [hold(_SETTLE), turn((before.inv() * after).as_rotvec(), _MOVE), hold(_SETTLE), hold(seconds, name)]
    return MotionPreset(tuple(legs), attitudes[0])


def _spun_up(rate: Array, seconds: float, label: str) -> list[Leg]:
    """From rest to a steady turn at `rate` (3,) and back."""
    return [ramp(np.zeros(3), rate, _SETTLE), spin(rate, seconds, label), ramp(rate, np.zeros(3), _SETTLE)]
