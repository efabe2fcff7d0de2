from __future__ import annotations

import asyncio
from collections.abc import Iterable
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.service.link import parse_endpoint
from mavcal.service.vehicle import request_streams
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


@pytest.mark.parametrize("measure_s", [2.0, 0.9])
async def test_a_link_that_holds_everything_up_is_asked_for_less(ardupilot: FakeVehicle, measure_s: float) -> None:
    streamer = Streamer(ardupilot)
    streamer.share = 0.4
    ardupilot.link.bytes_per_s = 1500.0
    report = await ardupilot.run(request_streams(ardupilot.vehicle, {IMU: 50.0, IMU2: 50.0}, measure_s=measure_s))
    assert report.capacity_bytes_per_s == 1500.0
    first, second = requests(ardupilot)[:2], requests(ardupilot)[2:]
    assert first == [(IMU, 20_000), (IMU2, 20_000)]
    assert all(interval > 60_000 for _, interval in second)
    assert report.slowdown > 3
    await ardupilot.run(report.restore())
    assert streamer.intervals == {IMU: -1, IMU2: 40_000}


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
async def test_a_link_that_is_just_full_is_relieved_so_that_answers_come(
    ardupilot: FakeVehicle, measure_s: float
) -> None:
    """Every sample arrives, and each answer waits behind them: reading a parameter takes seconds then."""
    streamer = Streamer(ardupilot)
    ardupilot.link.bytes_per_s = 4000.0
    busy = lambda: any(0 < interval <= 20_000 for interval in streamer.intervals.values())  # noqa: E731
    delay_answers(ardupilot, lambda: 1.2 if busy() else 0.0)
    report = await ardupilot.run(request_streams(ardupilot.vehicle, {IMU: 50.0, IMU2: 50.0}, measure_s=measure_s))
    assert report.capacity_bytes_per_s == 4000.0
    assert all(interval > 20_000 for interval in streamer.intervals.values())
    # and what was seen is remembered for the next request
    ardupilot.link.sent.clear()
    await ardupilot.run(request_streams(ardupilot.vehicle, {IMU: 50.0, IMU2: 50.0}))
    assert all(interval > 20_000 for _, interval in requests(ardupilot))


async def test_what_a_full_link_carries_counts_in_the_vehicles_time(ardupilot: FakeVehicle) -> None:
    """Rates are asked for in it: a simulated vehicle twice as fast sends twice the bytes a second of ours."""
    streamer = Streamer(ardupilot)
    streamer.vehicle_speed = 2.0
    ardupilot.link.bytes_per_s = 4000.0
    busy = lambda: any(0 < interval <= 20_000 for interval in streamer.intervals.values())  # noqa: E731
    delay_answers(ardupilot, lambda: 1.2 if busy() else 0.0)
    report = await ardupilot.run(request_streams(ardupilot.vehicle, {IMU: 50.0, IMU2: 50.0}))
    assert report.capacity_bytes_per_s == pytest.approx(2000.0, rel=0.05)


async def test_a_port_that_fills_slowly_is_relieved_before_it_is_full(ardupilot: FakeVehicle) -> None:
    """An eighth more than it carries: a buffer of 8 kB then delays every answer by 1.4 s, half a minute later."""
    streamer = Streamer(ardupilot)
    ardupilot.link.bytes_per_s = 4000.0
    waiting_s, at = 0.0, ardupilot.clock.now

    def queue() -> float:
        nonlocal waiting_s, at
        passed, at = ardupilot.clock.now - at, ardupilot.clock.now
        both = all(0 < interval <= 20_000 for interval in streamer.intervals.values())
        waiting_s = max(waiting_s + (0.125 if both else -0.125) * passed, 0.0)
        return waiting_s

    delay_answers(ardupilot, queue)
    report = await ardupilot.run(request_streams(ardupilot.vehicle, {IMU: 50.0, IMU2: 50.0}))
    assert report.capacity_bytes_per_s == 4000.0
    assert all(interval > 20_000 for interval in streamer.intervals.values())


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


async def test_answers_that_are_as_late_with_fewer_samples_slow_nothing_down(ardupilot: FakeVehicle) -> None:
    """Another program keeps the link busy from now on: fewer samples would not help."""
    streamer = Streamer(ardupilot)
    ardupilot.link.bytes_per_s = 4000.0
    busy = False

    def delay() -> float:
        nonlocal busy
        busy = busy or all(interval == 20_000 for interval in streamer.intervals.values())
        return 0.2 if busy else 0.0

    delay_answers(ardupilot, delay)
    report = await ardupilot.run(request_streams(ardupilot.vehicle, {IMU: 50.0, IMU2: 50.0}))
    assert streamer.intervals == {IMU: 20_000, IMU2: 20_000}
    assert (report.capacity_bytes_per_s, report.slowdown) == (None, 1.0)


async def test_a_link_that_loses_as_much_whatever_it_carries_is_bad_and_not_slow(ardupilot: FakeVehicle) -> None:
    streamer = Streamer(ardupilot)
    ardupilot.link.bytes_per_s = 1500.0
    advance = ardupilot.advance

    def losing(seconds: float) -> None:
        advance(seconds)
        ardupilot.link.received += 8
        ardupilot.link.lost += 2

    ardupilot.advance = losing  # type: ignore[method-assign]
    report = await ardupilot.run(request_streams(ardupilot.vehicle, {IMU: 50.0, IMU2: 50.0}))
    # what relieves the link is sent at once, and then again until it is confirmed
    assert [interval > 20_000 for _, interval in requests(ardupilot)] == [False] * 2 + [True] * 4 + [False] * 2
    assert streamer.intervals == {IMU: 20_000, IMU2: 20_000}
    assert (report.capacity_bytes_per_s, report.slowdown) == (None, 1.0)


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
