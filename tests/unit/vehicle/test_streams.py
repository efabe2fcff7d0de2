from __future__ import annotations

import asyncio
from collections.abc import Iterable
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.service.link.endpoint import parse_endpoint
from mavcal.service.vehicle.streams import request_streams
from tests.unit.vehicle.fake import FakeVehicle, ack, delay_answers

IMU, IMU2 = 26, 116


class Streamer:
    """Takes interval requests and sends SCALED_IMU messages as time passes."""

    def __init__(self, fake: FakeVehicle, *, refuse: set[int] = frozenset(), never: set[int] = frozenset()) -> None:
        self.fake = fake
        self.refuse, self.never = refuse, never
        self.intervals = {IMU: -1, IMU2: 40_000}
        self.share = 1.0
        self.vehicle_speed = 1.0
        self._due: dict[int, float] = {}
        self._advance = fake.advance
        fake.link.respond = self.respond
        fake.advance = self.advance  # type: ignore[method-assign]

    def respond(self, message: Any) -> Iterable[Any]:
        if message.get_type() != "COMMAND_LONG":
            return []
        number = int(message.param1)
        if message.command == 510:
            return [ack(510, 0), dialect.MAVLink_message_interval_message(number, self.intervals.get(number, 0))]
        if message.command == 511:
            if number in self.refuse:
                return [ack(511, 2)]
            self.intervals[number] = int(message.param2)
            return [ack(511, 0)]
        return []

    def advance(self, seconds: float) -> None:
        self._advance(seconds)
        now = self.fake.clock.now * self.vehicle_speed
        for number, interval in self.intervals.items():
            if interval <= 0 or number in self.never:
                continue
            step = interval / 1e6 / self.share
            due = max(self._due.get(number, 0.0), now - seconds * self.vehicle_speed)
            while due <= now:
                make = {IMU: dialect.MAVLink_scaled_imu_message, IMU2: dialect.MAVLink_scaled_imu2_message}[number]
                self.fake.hear(make(int(due * 1000), *[0] * 10))
                due += step
            self._due[number] = due


def requests(fake: FakeVehicle) -> list[tuple[int, int]]:
    return [(int(m.param1), int(m.param2)) for m in fake.link.sent_of("COMMAND_LONG") if m.command == 511]


async def test_streams_are_measured_in_the_vehicles_time_and_put_back(ardupilot: FakeVehicle) -> None:
    streamer = Streamer(ardupilot)
    streamer.vehicle_speed = 10.0
    report = await ardupilot.run(request_streams(ardupilot.vehicle, {IMU: 50.0, IMU2: 50.0}))
    assert report.rates[IMU].measured_hz == pytest.approx(50.0, rel=0.02)
    assert report.rates[IMU].wall_hz == pytest.approx(500.0, rel=0.05)
    assert report.previous == {IMU: -1, IMU2: 40_000}
    assert report.slowdown == 1.0
    assert await ardupilot.run(report.restore()) == ()
    assert streamer.intervals == {IMU: -1, IMU2: 40_000}


async def test_parameters_three_to_seven_of_the_request_are_zero(ardupilot: FakeVehicle) -> None:
    Streamer(ardupilot)
    await ardupilot.run(request_streams(ardupilot.vehicle, {IMU: 50.0}))
    (request,) = [m for m in ardupilot.link.sent_of("COMMAND_LONG") if m.command == 511]
    assert [getattr(request, f"param{k}") for k in range(1, 8)] == [IMU, 20_000, 0, 0, 0, 0, 0]


async def test_a_stream_that_is_acknowledged_and_never_comes_is_missing(ardupilot: FakeVehicle) -> None:
    Streamer(ardupilot, never={IMU2})
    report = await ardupilot.run(request_streams(ardupilot.vehicle, {IMU: 50.0, IMU2: 50.0}))
    assert report.rates[IMU2].result == 0
    assert report.missing == (IMU2,)
    assert report.capacity_bytes_per_s is None


async def test_a_refused_stream_is_in_the_report_and_not_put_back(ardupilot: FakeVehicle) -> None:
    Streamer(ardupilot, refuse={IMU2})
    report = await ardupilot.run(request_streams(ardupilot.vehicle, {IMU: 50.0, IMU2: 400.0}))
    assert report.rates[IMU2].result == 2
    assert report.rates[IMU2].measured_hz == pytest.approx(25.0, rel=0.05)  # the old rate stays
    assert set(report.previous) == {IMU}


async def test_our_own_simulated_vehicle_that_wants_for_processor_time_is_asked_for_no_less(
    ardupilot: FakeVehicle,
) -> None:
    streamer = Streamer(ardupilot)
    streamer.share = 0.4
    ardupilot.link.endpoint = parse_endpoint("sim:ardupilot")
    report = await ardupilot.run(request_streams(ardupilot.vehicle, {IMU: 50.0, IMU2: 50.0}, measure_s=2.0))
    assert report.capacity_bytes_per_s is None
    assert report.rates[IMU].wall_hz == pytest.approx(20.0, rel=0.1)
    assert requests(ardupilot) == [(IMU, 20_000), (IMU2, 20_000)]


@pytest.mark.parametrize("measure_s", [2.0, 0.9])
async def test_a_vehicle_that_always_answers_slowly_is_asked_for_no_less(
    ardupilot: FakeVehicle, measure_s: float
) -> None:
    streamer = Streamer(ardupilot)
    ardupilot.link.bytes_per_s = 4000.0
    delay_answers(ardupilot, lambda: 0.8)
    report = await ardupilot.run(request_streams(ardupilot.vehicle, {IMU: 50.0, IMU2: 50.0}, measure_s=measure_s))
    assert streamer.intervals == {IMU: 20_000, IMU2: 20_000}
    assert report.capacity_bytes_per_s is None


async def test_a_slow_serial_port_is_never_asked_for_more_than_it_carries(ardupilot: FakeVehicle) -> None:
    Streamer(ardupilot)
    ardupilot.link.endpoint = parse_endpoint("serial:/dev/ttyUSB0:9600")
    report = await ardupilot.run(request_streams(ardupilot.vehicle, {IMU: 50.0, IMU2: 50.0}))
    assert report.capacity_bytes_per_s == 960.0
    assert all(interval > 100_000 for _, interval in requests(ardupilot))


async def test_cancelling_half_way_puts_back_what_was_changed(ardupilot: FakeVehicle) -> None:
    streamer = Streamer(ardupilot)
    task = asyncio.ensure_future(request_streams(ardupilot.vehicle, {IMU: 50.0, IMU2: 50.0}, measure_s=60.0))
    for _ in range(60):
        for _ in range(12):
            await asyncio.sleep(0)
        ardupilot.advance(0.05)
    assert streamer.intervals == {IMU: 20_000, IMU2: 20_000}
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await ardupilot.run(ended(task))
    assert streamer.intervals == {IMU: -1, IMU2: 40_000}


async def ended(task: asyncio.Future[Any]) -> None:
    await task
