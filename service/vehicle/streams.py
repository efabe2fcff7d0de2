"""Streams: asked for, measured, and put back as they were.

An acknowledgement does not mean that a stream comes (PX4 accepts some and never sends them), nor at which rate
(intervals are rounded): what counts is what is measured.
"""

from __future__ import annotations

import asyncio
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from pymavlink.dialects.v20 import ardupilotmega as dialect

from calib.wire import Frame, decode
from service.errors import CommandRefused, CommandTimeout, LinkError, VehicleError
from service.link import Batch
from service.vehicle import commands
from service.vehicle.boot_time import boot_time
from service.vehicle.identity import Autopilot

if TYPE_CHECKING:
    from service.vehicle.vehicle import Vehicle

_INTERVAL = dialect.MAVLINK_MSG_ID_MESSAGE_INTERVAL
DEFAULT_INTERVAL = 0
"""Interval that means: as the firmware would without us."""


@dataclass(frozen=True)
class StreamRate:
    """One stream as asked for and as it comes.

    Parameters
    ----------
    result
        MAV_RESULT of the request; None if it was not acknowledged.
    measured_hz
        Messages per second of the vehicle's time (of the wall clock for messages without a time stamp).
    wall_hz
        Messages per second of the wall clock.
    """

    message_id: int
    requested_hz: float
    result: int | None
    measured_hz: float
    wall_hz: float

    @property
    def delivered(self) -> bool:
        """True if anything comes."""
        return self.wall_hz > 0


@dataclass
class StreamReport:
    """What became of a request for streams; ``await restore()`` puts the old intervals back.

    `previous` are the intervals in us as they were before: -1 off, 0 the firmware's default (also where the vehicle
    did not say).
    """

    vehicle: Vehicle
    rates: Mapping[int, StreamRate]
    previous: Mapping[int, int]

    @property
    def missing(self) -> tuple[int, ...]:
        """Messages that were asked for and do not come."""
        return tuple(message_id for message_id, rate in self.rates.items() if not rate.delivered)

    async def restore(self) -> tuple[int, ...]:
        """Put the old intervals back; returns the messages for which that could not be confirmed."""
        failed = []
        for message_id, interval in self.previous.items():
            try:
                await set_interval(self.vehicle, message_id, interval)
            except (VehicleError, LinkError):
                failed.append(message_id)
        return tuple(failed)


async def set_interval(vehicle: Vehicle, message_id: int, interval_us: float) -> None:
    """SET_MESSAGE_INTERVAL: -1 off, 0 default. Parameters 3 to 7 must be 0 (ArduPilot refuses others)."""
    await vehicle.command(commands.SET_MESSAGE_INTERVAL, (message_id, interval_us))


async def get_interval(vehicle: Vehicle, message_id: int) -> int | None:
    """The interval in us as the vehicle says it (-1 off, 0 unknown to it), or None if it does not say."""
    ask = [(commands.GET_MESSAGE_INTERVAL, (message_id,)), (commands.REQUEST_MESSAGE, (_INTERVAL, message_id))]
    if vehicle.identity.autopilot is Autopilot.PX4:
        ask.reverse()

    def match(frame: Frame) -> int | None:
        message = decode(frame)
        return int(message.interval_us) if message.message_id == message_id else None

    with vehicle.waits.expect({_INTERVAL}, match) as answer:
        for command_id, params in ask:
            try:
                await vehicle.command(command_id, params, retries=1)
            except (CommandRefused, CommandTimeout):
                continue
            interval = await answer.within(1.0)
            if interval is not None:
                return interval
    return None


async def request_streams(
    vehicle: Vehicle, requested_hz: Mapping[int, float], *, measure_s: float = 2.0
) -> StreamReport:
    """Ask for streams, then measure what comes.

    A refusal does not raise: it is in the report, and the stream may come all the same. If this is cancelled half
    way, what was already changed is put back.

    Parameters
    ----------
    vehicle
        Whom to ask.
    requested_hz
        Rate for each message id; 0 switches it off.
    measure_s
        How long to watch. 0 leaves every rate at 0.
    """
    previous: dict[int, int] = {}
    results: dict[int, int | None] = {}
    report = StreamReport(vehicle, {}, previous)
    try:
        for message_id, rate in requested_hz.items():
            previous[message_id] = await get_interval(vehicle, message_id) or DEFAULT_INTERVAL
            results[message_id] = await _ask(vehicle, message_id, rate)
        wall, own = await measure(vehicle, tuple(requested_hz), measure_s)
    except BaseException:
        await asyncio.shield(report.restore())
        raise
    rates = {
        message_id: StreamRate(message_id, rate, results[message_id], own[message_id], wall[message_id])
        for message_id, rate in requested_hz.items()
    }
    return StreamReport(vehicle, rates, previous)


async def _ask(vehicle: Vehicle, message_id: int, rate: float) -> int | None:
    try:
        await set_interval(vehicle, message_id, 1e6 / rate if rate > 0 else -1)
    except CommandRefused as exc:
        return exc.result
    except CommandTimeout:
        return None
    return commands.ACCEPTED


class _Meter:
    """Counts one message, and the span of its own time stamps."""

    def __init__(self) -> None:
        self.count = 0
        self.first = self.last = 0.0

    def see(self, frame: Frame) -> None:
        stamp = boot_time(frame) or 0.0
        self.first = self.first if self.count else stamp
        self.last = stamp
        self.count += 1

    def rate(self, wall_rate: float) -> float:
        span = self.last - self.first
        return (self.count - 1) / span if self.count > 2 and span > 0 else wall_rate


async def measure(
    vehicle: Vehicle, message_ids: Sequence[int], seconds: float
) -> tuple[dict[int, float], dict[int, float]]:
    """Rates per second of the wall clock, and per second of the vehicle's own time."""
    meters = {message_id: _Meter() for message_id in message_ids}

    def count(frames: Sequence[Frame], _batch: Batch) -> None:
        for frame in frames:
            meters[frame.message_id].see(frame)

    forget = vehicle.subscribe(frozenset(message_ids), count)
    began = vehicle.clock()
    try:
        if seconds > 0:
            await vehicle.waits.sleep(seconds)
    finally:
        forget()
    elapsed = vehicle.clock() - began
    wall = {key: meter.count / elapsed if elapsed > 0 else 0.0 for key, meter in meters.items()}
    return wall, {key: meter.rate(wall[key]) for key, meter in meters.items()}
