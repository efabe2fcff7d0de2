"""Sensors that saw the vehicle turn during the check: a turn of one sensor alone is its fault."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from mavcal.calib.preflight.rest import block_means
from mavcal.calib.recording import Array, Channel, Recording, Sensor, Stage
from mavcal.calib.stats.windows import finite_rows

TURNED_DEG: Final = 5.0
"""Change of a direction, deg, beyond noise, which every live sensor of that kind follows by many steps."""
RATE_DEG_S: Final = 5.0
"""The same for a rate, deg/s; a lasting rate of twice as much is a steady turn."""
_LEAST = 5


@dataclass(frozen=True)
class ObservedMovement:
    """Angle by which the attitude, the force or the field turned (deg), and the largest rate (deg/s), by sensor."""

    turned: dict[tuple[Sensor, int], float]
    rates: dict[int, float]
    attitude: float = 0.0

    def movement_seen_by_others(self, key: tuple[Sensor, int]) -> str:
        """Sentence on a turn that this sensor should have followed; empty: none beyond the noise."""
        kind, _ = key
        angles = {other: angle for other, angle in self.turned.items() if other != key and angle > TURNED_DEG}
        rates = {i: rate for i, rate in self.rates.items() if (Sensor.GYRO, i) != key and rate > RATE_DEG_S}
        siblings = [i for of, i in angles if of == kind] if kind != Sensor.GYRO else sorted(rates)
        kinds = {of for of, _ in angles} | ({Sensor.GYRO} if rates else set())
        by_attitude = self.attitude > TURNED_DEG
        if kind == Sensor.GYRO:  # the attitude follows the gyroscopes: it is no witness of its own
            sure = bool(kinds - {Sensor.GYRO}) and (len(kinds) > 1 or by_attitude)
        elif kind == Sensor.ACCEL:  # a turn about the vertical changes no force
            sure = bool(siblings) and (len(kinds) > 1 or len(siblings) > 1)
        else:
            sure = len(kinds) > 1 or len(siblings) > 1 or (bool(rates) and by_attitude)
        if not sure:
            return ""
        largest = max([*angles.values(), self.attitude, 0.0])
        return f"the vehicle turned by {largest:.0f} deg" if largest > TURNED_DEG else "the vehicle turned"

    @property
    def text(self) -> str | None:
        """Movement seen by the compasses, as a reason; None: they saw none."""
        fields = [angle for (of, _), angle in self.turned.items() if of == Sensor.MAG and angle > 0.0]
        agreed = len(fields) > 1 or any(rate > RATE_DEG_S for rate in self.rates.values())
        if not fields or min(fields) < TURNED_DEG or not agreed:
            return None
        return f"the vehicle was turned: its field turned by {min(fields):.0f} deg meanwhile"


def movement(recording: Recording) -> ObservedMovement:
    """Turn that the sensors show."""
    turned = {}
    for kind in (Sensor.ACCEL, Sensor.MAG):
        for instance in recording.instances(kind):
            channel = _finite(recording, kind, instance)
            if channel is not None:
                turned[kind, instance] = _turned(block_means(channel))
    rates = {}
    for instance in recording.instances(Sensor.GYRO):
        channel = _finite(recording, Sensor.GYRO, instance)
        if channel is not None:
            blocks = np.degrees(block_means(channel))
            change = float(np.linalg.norm(blocks - blocks.mean(axis=0), axis=1).max())
            rates[instance] = max(change, 0.5 * float(np.linalg.norm(blocks.mean(axis=0))))
    attitudes = recording.find(Sensor.ATTITUDE)
    return ObservedMovement(turned, rates, _attitude(attitudes[0]) if attitudes else 0.0)


def _finite(recording: Recording, sensor: Sensor, instance: int) -> Channel | None:
    found = [c for c in recording.find(sensor, instance) if c.stage != Stage.DEBIASED]
    if not found:
        return None
    longest = max(found, key=len)
    channel = longest.take(finite_rows(longest.values))
    return channel if len(channel) >= _LEAST else None


def _turned(vectors: Array) -> float:
    """Largest angle from the first block, deg."""
    lengths = np.linalg.norm(vectors, axis=1)
    usable = vectors[lengths > 0.0] / lengths[lengths > 0.0, None]
    if len(usable) < 2:
        return 0.0
    return math.degrees(float(np.arccos(np.clip(usable @ usable[0], -1.0, 1.0)).max()))


def _attitude(channel: Channel) -> float:
    q = channel.values[finite_rows(channel.values)]
    if len(q) < 2:
        return 0.0
    return math.degrees(2.0 * float(np.arccos(np.clip(np.abs(q @ q[0]), 0.0, 1.0)).max()))
