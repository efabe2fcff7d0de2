"""What is measured of streams, and what is concluded from it."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.calib.wire.codec import encode
from mavcal.calib.wire.frames import Frame, FrameParser
from mavcal.service.vehicle.arrivals import LONGEST_S, OTHERS_S, START_S, Meter, watch
from mavcal.service.vehicle.intervals import get_interval
from mavcal.service.vehicle.streams import (
    LATE_S,
    _interval_us,
    _late_anyway,
    _late_s,
    _smaller,
    request_streams,
)
from tests.unit.vehicle.fake import FakeVehicle, ack, delay_answers

IMU = 26


def imu(at_s: float) -> Any:
    return dialect.MAVLink_scaled_imu_message(int(at_s * 1000), *[0] * 10)


def frame(message: Any) -> Frame:
    (only,) = FrameParser().feed(encode(message, 1, 1, 0))
    return only


def answering(fake: FakeVehicle) -> None:
    """Every question about an interval is answered."""

    def respond(message: Any) -> Iterable[Any]:
        if message.get_type() != "COMMAND_LONG":
            return []
        number = int(message.param1 if message.command == 510 else message.param2)
        return [ack(message.command, 0), dialect.MAVLink_message_interval_message(number, 40_000)]

    fake.link.respond = respond


def asked(fake: FakeVehicle) -> list[int]:
    return [message.command for message in fake.link.sent_of("COMMAND_LONG")]


# --- counting


@pytest.mark.parametrize(
    ("stamps", "rate"),
    [
        ([], 7.0),
        ([1.0], 7.0),
        ([1.0, 1.5], 7.0),  # one interval alone is no rate
        ([1.0, 1.5, 2.0], 2.0),
        ([4.0, 4.1, 4.2, 4.5], 6.0),
        ([2.0, 2.0, 2.0], 7.0),  # its clock stands
        ([3.0, 2.0, 1.0], 7.0),  # it restarted
    ],
)
def test_a_rate_is_counted_by_the_messages_own_stamps_where_they_tell_one(stamps: list[float], rate: float) -> None:
    meter = Meter()
    for stamp in stamps:
        meter.see(frame(imu(stamp)), 0.0)
    assert meter.count == len(stamps)
    assert meter.rate(7.0) == pytest.approx(rate)


def test_a_message_without_a_stamp_is_counted_by_the_wall_clock() -> None:
    meter = Meter()
    for at in range(3):
        meter.see(frame(dialect.MAVLink_heartbeat_message(2, 3, 0, 0, 3, 3)), float(at))
    assert meter.span == 2.0
    assert (meter.first, meter.last) == (0.0, 0.0)
    assert meter.rate(7.0) == 7.0


def test_microseconds_are_stamps_as_well() -> None:
    """RAW_IMU, which ArduPilot sends of its first unit, has no ``time_boot_ms``."""
    meter = Meter()
    for at in (1.0, 1.5, 2.0):
        meter.see(frame(dialect.MAVLink_raw_imu_message(int(at * 1e6), *[0] * 9)), 0.0)
    assert meter.rate(7.0) == pytest.approx(2.0)


@pytest.mark.parametrize(
    ("delays", "queued"),
    [
        (lambda _t: 0.3, 0.0),
        (lambda t: 0.1 * t, 0.1),
        (lambda t: 0.4 - t % 0.5 if t % 0.5 < 0.4 else 0.0, 0.0),  # our process runs in a fifth of the time
        (lambda t: 0.5 if 1.5 < t < 1.9 else 0.0, 0.0),  # held up once
        (lambda t: 0.3 - 0.1 * t, 0.0),
    ],
)
def test_a_buffer_fills_if_even_the_youngest_samples_are_older_and_older(
    delays: Callable[[float], float], queued: float
) -> None:
    meter = Meter()
    for k in range(100):
        meter.see(frame(imu(5.0 + k / 50)), 100.0 + k / 50 + delays(k / 50))
    assert meter.queued() == pytest.approx(queued, abs=0.01)


async def watched(fake: FakeVehicle, starts: dict[int, float | None], seconds: float) -> tuple[float, dict[int, float]]:
    """How long streams of 50 Hz are watched that begin at these times, and their rates."""
    began = fake.clock.now
    advance = fake.advance
    make = {IMU: dialect.MAVLink_scaled_imu_message, 116: dialect.MAVLink_scaled_imu2_message}

    def passing(step: float) -> None:
        advance(step)
        for message_id, start in starts.items():
            if start is not None and fake.clock.now - began >= start:
                fake.hear(make[message_id](round(fake.clock.now * 1000), *[0] * 10))

    fake.advance = passing  # type: ignore[method-assign]
    seen = await fake.run(watch(fake.vehicle, tuple(starts), seconds, tuple(starts)), step=0.02)
    return fake.clock.now - began, dict(seen.own_hz)


@pytest.mark.parametrize(
    ("starts", "took"),
    [
        ({IMU: 0.0}, 2.0),
        ({IMU: 3.0}, 5.0),
        ({IMU: 0.0, 116: 1.0}, 3.0),
        ({IMU: 0.0, 116: None}, OTHERS_S),
        ({IMU: None}, START_S),
    ],
)
async def test_each_stream_is_watched_from_its_first_sample_on(
    ardupilot: FakeVehicle, starts: dict[int, float | None], took: float
) -> None:
    seconds, rates = await watched(ardupilot, starts, 2.0)
    assert seconds == pytest.approx(took, abs=0.15)
    for message_id, start in starts.items():
        assert rates[message_id] == (0.0 if start is None else pytest.approx(50.0, rel=0.02))


async def test_a_clock_that_stands_is_not_waited_for_for_good(ardupilot: FakeVehicle) -> None:
    advance = ardupilot.advance

    def passing(step: float) -> None:
        advance(step)
        ardupilot.hear(imu(5.0))

    ardupilot.advance = passing  # type: ignore[method-assign]
    began = ardupilot.clock.now
    await ardupilot.run(watch(ardupilot.vehicle, (IMU,), 2.0, (IMU,)), step=0.05)
    assert ardupilot.clock.now - began < LONGEST_S + 2.5


async def test_watching_for_no_time_counts_nothing_and_waits_for_nothing(ardupilot: FakeVehicle) -> None:
    seen = await asyncio.wait_for(watch(ardupilot.vehicle, (IMU,), 0.0, (IMU,)), 5.0)
    assert (seen.own_hz, seen.wall_hz, seen.loss, seen.bytes_per_s) == ({IMU: 0.0}, {IMU: 0.0}, 0.0, 0.0)


@pytest.mark.parametrize(("received", "lost", "loss"), [(8, 2, 0.2), (10, 0, 0.0), (10, -2, 0.0)])
async def test_the_loss_is_the_share_of_what_was_sent_meanwhile(
    ardupilot: FakeVehicle, received: int, lost: int, loss: float
) -> None:
    link = ardupilot.link
    link.received, link.lost = 1000, 500
    watching = asyncio.ensure_future(watch(ardupilot.vehicle, (IMU,), 1.0))
    await asyncio.sleep(0)
    ardupilot.hear(imu(1.0))
    await asyncio.sleep(0)
    link.received, link.lost = 1001 + received, 500 + lost
    link.bytes_received += 77
    ardupilot.clock.now += 1.0
    ardupilot.vehicle.tick()
    seen = await watching
    assert (seen.loss, seen.bytes_per_s) == (pytest.approx(loss), pytest.approx(77.0))


# --- concluding


@pytest.mark.parametrize(("one", "other", "smaller"), [(None, None, None), (2.0, None, 2.0), (3.0, 1.0, 1.0)])
def test_the_smaller_of_two_capacities_counts(one: float | None, other: float | None, smaller: float | None) -> None:
    assert _smaller(one, other) == smaller


@pytest.mark.parametrize(("rate", "interval"), [(50.0, 20_000.0), (0.5, 2e6), (0.0, -1), (1.0, 1e6)])
def test_a_rate_of_zero_switches_a_stream_off(rate: float, interval: float) -> None:
    assert _interval_us(rate) == interval


@pytest.mark.parametrize(
    ("delay", "idle", "late", "anyway"),
    [
        (0.5, 0.1, 0.3, True),
        (0.5, 0.45, 0.3, False),  # it has become quick again
        (0.5, 0.1, LATE_S, True),
        (2.0, 0.1, LATE_S + 0.1, True),
        (2.0, 0.1, 0.0, False),
    ],
)
async def test_answers_that_stay_late_are_not_delayed_by_the_streams(
    ardupilot: FakeVehicle, delay: float, idle: float, late: float, *, anyway: bool
) -> None:
    answering(ardupilot)
    delay_answers(ardupilot, lambda: delay)
    assert await ardupilot.run(_late_anyway(ardupilot.vehicle, (IMU,), idle, late)) is anyway


@pytest.mark.parametrize(
    ("delays", "since", "late"),
    [
        ([0.8] * 4, 0.0, 0.7),
        ([0.9, 0.9, 0.7, 0.9], 0.0, 0.6),  # the quickest of them
        ([0.8, 0.1], 0.0, 0.0),  # once by chance
        ([0.3] * 4, 0.0, 0.2),  # not late, but later and later
        ([0.3], 100.0, 0.0),  # by so little after so long a time
    ],
)
async def test_how_long_answers_wait_behind_the_streams(
    ardupilot: FakeVehicle, delays: list[float], since: float, late: float
) -> None:
    answering(ardupilot)
    left = list(delays)

    def delay() -> float:
        last = ardupilot.link.sent[-1]
        return left.pop(0) if last.get_type() == "COMMAND_LONG" and last.command == 510 else 0.0

    delay_answers(ardupilot, delay)
    began = ardupilot.clock.now - since
    found = await ardupilot.run(_late_s(ardupilot.vehicle, (IMU,), 0.1, began), step=0.01)
    assert found == pytest.approx(late, abs=0.03)
    assert left == []


# --- asking


@pytest.mark.parametrize(("px4_", "order"), [(False, [510, 512]), (True, [512, 510])])
async def test_each_firmware_is_asked_in_the_way_that_it_answers_first(
    ardupilot: FakeVehicle, px4: FakeVehicle, *, px4_: bool, order: list[int]
) -> None:
    """Where the first way is refused the second one is tried, and an interval of another message is no answer."""
    fake = px4 if px4_ else ardupilot

    def respond(message: Any) -> Iterable[Any]:
        if message.get_type() != "COMMAND_LONG" or message.command not in (510, 512):
            return []
        if message.command == order[0]:
            return [ack(message.command, 3)]
        tell = dialect.MAVLink_message_interval_message
        return [ack(message.command, 0), tell(116, 1), tell(IMU, 40_000)]

    fake.link.respond = respond
    fake.link.sent.clear()
    assert await fake.run(get_interval(fake.vehicle, IMU)) == 40_000
    assert asked(fake) == order


async def test_an_interval_that_nobody_tells_is_waited_for_for_a_second_each(ardupilot: FakeVehicle) -> None:
    ardupilot.link.respond = lambda m: [ack(m.command, 0)] if m.get_type() == "COMMAND_LONG" else []
    began = ardupilot.clock.now
    assert await ardupilot.run(get_interval(ardupilot.vehicle, IMU)) is None
    assert 1.9 < ardupilot.clock.now - began < 2.5


async def test_streams_that_nobody_watches_are_asked_for_and_not_measured(ardupilot: FakeVehicle) -> None:
    answering(ardupilot)
    began = ardupilot.clock.now
    report = await ardupilot.run(request_streams(ardupilot.vehicle, {IMU: 50.0}, measure_s=0.0))
    assert ardupilot.clock.now - began < 0.5
    assert (report.rates[IMU].measured_hz, report.rates[IMU].wall_hz, report.rates[IMU].result) == (0.0, 0.0, 0)
    assert report.capacity_bytes_per_s is None
    assert asked(ardupilot).count(510) == 1  # how it was before, and nothing to see how long answers take
