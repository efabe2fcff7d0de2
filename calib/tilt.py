"""Attitude for display, from gyroscope and accelerometer, where the vehicle streams no estimate of its own."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mavcal.calib import STANDARD_GRAVITY

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]

CORRECTION_S = 0.7
"""Time constant with which gravity corrects the integrated rate, s."""
LONGEST_STEP_S = 0.5
"""Longest pause, s, over which the rate is integrated; after a longer one gravity alone sets the attitude."""
STEADY = 0.3
"""Fraction of g by which the specific force may differ from g and still show the vertical."""
_DOWN = np.array([0.0, 0.0, 1.0])


class TiltFilter:
    """A complementary filter: rates are integrated, and the vertical follows gravity. The heading is free.

    For pictures only: it has no covariance, and no estimate of a calibration rests on it.
    """

    def __init__(self) -> None:
        self._body: Rotation | None = None  # to north-east-down
        self._t = math.nan

    @property
    def attitude(self) -> tuple[float, float, float, float] | None:
        """Quaternion w x y z, body to north-east-down; None: nothing was seen yet."""
        if self._body is None:
            return None
        x, y, z, w = self._body.as_quat().tolist()
        return w, x, y, z

    def feed(self, t: float, force: Array, rate: Array) -> None:
        """Take the mean specific force (3,) m/s2 and rate (3,) rad/s of the body up to time `t`, s."""
        step = t - self._t
        self._t = t
        length = float(np.linalg.norm(force))
        steady = length > 0.0 and abs(length / STANDARD_GRAVITY - 1.0) < STEADY
        if self._body is None or not 0.0 <= step <= LONGEST_STEP_S:
            if steady:
                self._body = _held_with(-force / length)
            return
        self._body = self._body * _turn(rate * step)
        if steady:
            held = self._body.inv().apply(_DOWN)
            share = 1.0 - math.exp(-step / CORRECTION_S)
            self._body = self._body * _turn(-share * np.cross(held, -force / length))


def _held_with(down: Array) -> Rotation:
    """The attitude nearest to level, heading north, in which the body direction `down` points down."""
    axis = np.cross(down, _DOWN)
    sine = float(np.linalg.norm(axis))
    angle = math.atan2(sine, float(down @ _DOWN))
    unit = axis / sine if sine > 1e-9 else np.array([1.0, 0.0, 0.0])
    return _turn(angle * unit)


def _turn(vector: Array) -> Rotation:
    # A statement waits for an import in another thread; the attribute `scipy.spatial.transform` may be incomplete.
    from scipy.spatial.transform import Rotation

    return Rotation.from_rotvec(vector)
