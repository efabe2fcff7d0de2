"""One ring: a vehicle that stands on a face and is turned once around, and what the compasses read meanwhile."""

from __future__ import annotations

import math

import numpy as np

from mavcal.calib.mag.orientation import RIGHT_ANGLES, MountingVerdict
from mavcal.calib.procedures.mag_track import REFUSED_ASKEW
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


def mounting_in(rotation: Array) -> dict[str, object]:
    """The right-angle mounting that is nearest to `rotation`, as ``quality["orientation"]`` of a compass has it.

    `rotation` (3, 3) turns what the stated mounting calls body into the body; the angle that is left over beside the
    right-angle rotation is in ``askew_deg``.
    """
    best = max(RIGHT_ANGLES, key=lambda m: float(np.trace(m.matrix.T @ rotation)))
    askew = math.degrees(math.acos(float(np.clip(0.5 * (np.trace(best.matrix.T @ rotation) - 1.0), -1.0, 1.0))))
    verdict, message = MountingVerdict.AS_STATED, "mounted as stated"
    if askew > REFUSED_ASKEW:
        verdict = MountingVerdict.UNEXPLAINED
        message = (
            f"no right-angle mounting explains the compass: the best ({best.name}) is {askew:.0f} deg off; mount it "
            "square to the vehicle, or set its rotation by angles"
        )
    elif best is not RIGHT_ANGLES[0]:
        verdict, message = MountingVerdict.ROTATED, f"mounted turned by {best.name} against what is stated"
    return {
        "verdict": verdict.value,
        "name": best.name,
        "roll": best.roll,
        "pitch": best.pitch,
        "yaw": best.yaw,
        "matrix": best.matrix.tolist(),
        "message": message,
        "askew_deg": askew,
    }
