"""Live sensor samples of a vehicle, in small batches, for those who watch."""

from __future__ import annotations

import asyncio
import time
from collections import deque
from collections.abc import AsyncIterator, Sequence
from dataclasses import dataclass

from mavcal.calib.firmware.in_force.undo import Undo
from mavcal.calib.firmware.stream.assembler import Assembler
from mavcal.calib.recording import Channel, Recording, Sensor, Stage
from mavcal.calib.tilt import TiltFilter
from mavcal.calib.wire.frames import Frame
from mavcal.service.errors import DiskFull
from mavcal.service.jobs.calibrate.digest import field_of
from mavcal.service.vehicle.job_vehicle import JobVehicle
from mavcal.service.vehicle.vehicle import Vehicle

BATCH_S = 0.1
"""Period of the batches, wall seconds."""
LOSS_S = 10.0
"""Over so long the loss is counted."""
STALE_BATCHES = 10
"""Batches without the chosen message of a sensor after which another one is taken."""
SHOWN = (Sensor.ACCEL, Sensor.GYRO, Sensor.MAG, Sensor.TEMPERATURE)

Quaternion = tuple[float, float, float, float]


@dataclass(frozen=True, eq=False)
class LiveBatch:
    """Samples that have come since the last batch."""

    channels: tuple[Channel, ...]
    """As they are streamed; one channel a sensor and instance."""
    bare: tuple[Channel, ...]
    """Compasses without the calibration in force; none where that is not known."""
    attitude: Quaternion | None
    """Newest attitude, w x y z, body to north-east-down; None: none yet. It is the vehicle's own, or else from gravity
    and rates with a free heading."""
    field: float | None
    """Strength of the Earth's field by the World Magnetic Model, uT; None: the position is not known."""
    loss: float | None
    """Share of the vehicle's messages that were lost in the last 10 s; None: none has come."""


async def live_batches(vehicle: Vehicle) -> AsyncIterator[LiveBatch]:
    """Batches of the vehicle's stream until the reader stops; an empty batch while nothing comes.

    Raises
    ------
    FirmwareError
        If the autopilot is neither ArduPilot nor PX4.
    """
    adapter = JobVehicle(vehicle)
    known = {name: parameter.value for name, parameter in vehicle.parameters.items()}
    assembler, undo = Assembler(adapter.identity, known), Undo(adapter.identity, known)
    frames: list[Frame] = []

    def take(heard: Sequence[Frame], _disk: DiskFull | None) -> None:
        frames.extend(heard)

    field: float | None = None
    own: Quaternion | None = None
    tilt, losses, sources = TiltFilter(), _Losses(vehicle), OneSource()
    forget = adapter.subscribe(assembler.message_ids, take)
    try:
        while True:
            await asyncio.sleep(BATCH_S)
            heard, frames[:] = frames[:], []
            chunk, streamed = await asyncio.to_thread(_digested, heard, assembler, sources, tilt)
            own = _newest_attitude(chunk) or own
            if field is None and (model := field_of(chunk, time.time())) is not None:
                field = model.norm
            compasses = tuple(c for c in undo.feed(chunk).channels if c.sensor == Sensor.MAG and c.stage == Stage.RAW)
            yield LiveBatch(streamed, compasses, own or tilt.attitude, field, losses.share())
    finally:
        forget()


def _digested(
    heard: Sequence[Frame], assembler: Assembler, sources: OneSource, tilt: TiltFilter
) -> tuple[Recording, tuple[Channel, ...]]:
    """The channels in the frames, one a sensor; the tilt filter is fed with them."""
    chunk = assembler.feed([(None, frame) for frame in heard])
    streamed = sources.take(chunk.channels)
    _incline(tilt, streamed)
    return chunk, streamed


class _Losses:
    """Recent loss of a vehicle's messages, by their sequence numbers."""

    def __init__(self, vehicle: Vehicle) -> None:
        self._vehicle, self._way = vehicle, vehicle.way
        self._counted: deque[tuple[int, int]] = deque(maxlen=round(LOSS_S / BATCH_S))

    def share(self) -> float | None:
        """The recent loss; called once a batch."""
        vehicle = self._vehicle.unit
        if vehicle.way != self._way:
            self._way = vehicle.way
            self._counted.clear()
        now = vehicle.link.statistics(vehicle.system, vehicle.component)
        self._counted.append((now.received, now.lost))
        received, lost = (now.received - self._counted[0][0], now.lost - self._counted[0][1])
        return max(lost, 0) / (received + max(lost, 0)) if received > 0 else None


class OneSource:
    """One message for each sensor, where several carry it: they tell of the same moments, each in its own digits.

    The finest message of those that come often, preferably one without a bias subtracted. Another one is used only when
    it has not come for a while.
    """

    def __init__(self) -> None:
        self._chosen: dict[tuple[Sensor, int], tuple[str, int]] = {}
        """Message and batches since it has come."""

    def take(self, channels: Sequence[Channel]) -> tuple[Channel, ...]:
        """The channels of a batch to show."""
        found: dict[tuple[Sensor, int], list[Channel]] = {}
        for channel in channels:
            if channel.sensor in SHOWN and len(channel):
                found.setdefault((channel.sensor, channel.instance), []).append(channel)
        return tuple(c for key in sorted(found) if (c := self._one(key, found[key])) is not None)

    def _one(self, key: tuple[Sensor, int], candidates: Sequence[Channel]) -> Channel | None:
        chosen, absent = self._chosen.get(key, ("", STALE_BATCHES))
        same = next((channel for channel in candidates if channel.source == chosen), None)
        if same is None and absent < STALE_BATCHES:
            self._chosen[key] = (chosen, absent + 1)
            return None
        most = max(len(channel) for channel in candidates)
        often = [channel for channel in candidates if 2 * len(channel) >= most]
        best = same or min(often, key=lambda c: (c.stage is Stage.DEBIASED, c.quantum, -len(c)))
        self._chosen[key] = (best.source, 0)
        return best


def _incline(tilt: TiltFilter, streamed: Sequence[Channel]) -> None:
    """Let the filter see the first inertial unit."""
    found = {c.sensor: c for c in reversed(streamed) if c.sensor in {Sensor.ACCEL, Sensor.GYRO}}
    if len(found) == 2:
        accel, gyro = found[Sensor.ACCEL], found[Sensor.GYRO]
        tilt.feed(float(gyro.t[-1]), accel.values.mean(axis=0), gyro.values.mean(axis=0))


def _newest_attitude(chunk: Recording) -> Quaternion | None:
    found = [c for c in chunk.channels if c.sensor == Sensor.ATTITUDE and len(c)]
    if not found:
        return None
    w, x, y, z = max(found, key=lambda channel: float(channel.t[-1])).values[-1].tolist()
    return w, x, y, z
