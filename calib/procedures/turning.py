"""Body rates of the vehicle, tick by tick, by the first gyro."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from mavcal.calib.fit import AXES
from mavcal.calib.procedures.roster import TickChannels
from mavcal.calib.recording import Array, Sensor

TURNING = math.radians(5.0)
"""Rate, rad/s, above which the vehicle is turning; at rest the offset-corrected gyro errs by less."""

WOBBLE = 0.25
"""Largest fraction of the rate about other axes during a turn about one axis."""

WOBBLE_AT_LEAST = math.radians(5.0)
"""The same limit for slow turns, rad/s: hand wobble."""


@dataclass(frozen=True, eq=False)
class Spin:
    """Mean rate (3,) in the body over a tick that lasts `seconds`, rad/s."""

    rate: Array
    seconds: float

    def about(self, axis: Array) -> float:
        """Rate about the unit vector `axis`, right-handed, rad/s."""
        return float(self.rate @ axis)

    def steady_about(self, axis: Array) -> bool:
        """Whether it turns, and about `axis` alone."""
        along = self.about(axis)
        across = float(np.linalg.norm(self.rate - along * axis))
        return abs(along) > TURNING and across <= max(WOBBLE * abs(along), WOBBLE_AT_LEAST)


class SpinWatch:
    """Follows the first participating gyro; its offset is its reading at rest.

    `body` are the rotations from the raw frame of every gyro to the body.
    """

    def __init__(self, body: Mapping[int, Array]) -> None:
        self._body = body
        self._offsets: dict[int, tuple[Array, int]] = {}

    def update(self, frame: TickChannels, instances: Iterable[int], seconds: float, *, resting: bool) -> Spin | None:
        """Take a tick; `resting` ones determine the offset. None: no gyro gave samples."""
        means = {i: frame[Sensor.GYRO, i].values.mean(axis=0) for i in instances if (Sensor.GYRO, i) in frame}
        for instance, mean in means.items():
            total, n = self._offsets.get(instance, (np.zeros(3), 0))
            if resting and (n == 0 or np.linalg.norm(mean - total / n) < 0.5 * TURNING):
                self._offsets[instance] = (total + mean, n + 1)
        for instance, mean in means.items():
            total, n = self._offsets.get(instance, (np.zeros(3), 0))
            return Spin(self._body[instance] @ (mean - total / max(n, 1)), seconds)
        return None

    @property
    def offset(self) -> float:
        """Length of the largest offset at rest, rad/s; 0 as long as none is known."""
        return max((float(np.linalg.norm(total)) / n for total, n in self._offsets.values()), default=0.0)

    @property
    def rested(self) -> bool:
        """Whether the offset at rest is known."""
        return bool(self._offsets)


@dataclass(frozen=True)
class Turned:
    """A direction of turning: about body axis 0, 1 or 2, with the sign of the rate."""

    axis: int
    sign: float

    @property
    def vector(self) -> Array:
        """Unit vector (3,) about which it is right-handed."""
        return np.asarray(self.sign * np.eye(3)[self.axis], dtype=np.float64)

    @property
    def name(self) -> str:
        """Name as in labels."""
        return f"{AXES[self.axis]}{'+' if self.sign > 0.0 else '-'}"


def way(direction: Array, axis: Array) -> str:
    """A right-handed turn about `axis` of a vehicle whose body direction `direction` points down, seen from above."""
    return "clockwise" if float(direction @ axis) > 0.0 else "counter-clockwise"
