"""One ring: a vehicle that stands on a face and is turned once around, and what the compasses read meanwhile."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from mavcal.calib.mag.free_rotation import angle_between
from mavcal.calib.mag.orientation import ASKEW, RIGHT_ANGLES, FittedRotation, MountingVerdict
from mavcal.calib.procedures.mag_track import mounting_quality
from mavcal.calib.procedures.pool import Pool
from mavcal.calib.procedures.poses import DOWN
from mavcal.calib.procedures.protocol import Pose
from mavcal.calib.procedures.roster import TickChannels
from mavcal.calib.procedures.turning import Spin
from mavcal.calib.recording import Array, Channel, Sensor

FEWEST = 40
"""Samples of a ring below which it goes on: nine degrees apart."""

ONCE_AROUND = 2.0 * math.pi


class RingTrack:
    """Collects the compasses' samples of one turn."""

    def __init__(self, face: Pose) -> None:
        self.face = face
        self.down = np.array(DOWN[face])
        self.angle = 0.0
        """Turned so far, rad, signed."""
        self._pool = Pool((Sensor.MAG,))

    def add(self, frame: TickChannels, spin: Spin) -> None:
        """Take a tick of a clean turn about the vertical."""
        self._pool.add(frame)
        self.angle += spin.about(self.down) * spin.seconds

    def channel(self, instance: int) -> Channel | None:
        """What one compass read; None: nothing."""
        return self._pool.get((Sensor.MAG, instance))

    def complete(self, instances: tuple[int, ...]) -> bool:
        """Whether it has gone round with samples enough of every compass."""
        counts = [len(channel) if (channel := self.channel(i)) is not None else 0 for i in instances]
        return abs(self.angle) >= ONCE_AROUND and min(counts, default=0) >= FEWEST


def mounting_in(rotation: Array, covariance: Array) -> dict[str, Any]:
    """The mounting that `rotation` means, as ``quality["orientation"]`` of a compass has it.

    `rotation` (3, 3) turns what the stated mounting calls body into the body; `covariance` (3, 3), rad^2, is that of
    small turns of the body. A rotation within 5 degrees of one by right angles means that one.
    """
    fitted = FittedRotation(rotation, covariance)
    askew, nearest = min((angle_between(m.matrix, rotation), k) for k, m in enumerate(RIGHT_ANGLES))
    best = RIGHT_ANGLES[nearest]
    verdict, message = MountingVerdict.AS_STATED, "mounted as stated"
    if askew > ASKEW:
        verdict = MountingVerdict.BY_ANGLES
        message = (
            f"mounted turned by {fitted.euler}, {math.degrees(askew):.0f} deg from the nearest right-angle mounting "
            f"({best.name})"
        )
    elif nearest:
        verdict, message = MountingVerdict.ROTATED, f"mounted turned by {best.name} against what is stated"
    return mounting_quality(verdict, best, fitted, message)
