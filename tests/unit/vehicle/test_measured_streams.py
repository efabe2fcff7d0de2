"""What is measured of streams, and what is concluded from it."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.calib import wire
from mavcal.service.link.capacity import LOSSY
from mavcal.service.vehicle import request_streams
from mavcal.service.vehicle.streams import (
    LATE_S,
    REMEMBERED_S,
    _interval_us,
    _late_anyway,
    _late_s,
    _loses_anyway,
    _Meter,
    _remembered,
    _Seen,
    _smaller,
    _watch,
    get_interval,
    measure,
)
from tests.unit.vehicle.fake import FakeVehicle, ack, delay_answers

IMU = 26


def imu(at_s: float) -> Any:
    return dialect.MAVLink_scaled_imu_message(int(at_s * 1000), *[0] * 10)


def frame(message: Any) -> wire.Frame:
    (only,) = wire.FrameParser().feed(wire.encode(message, 1, 1, 0))
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
    meter = _Meter()
    for stamp in stamps:
        meter.see(frame(imu(stamp)))
    assert meter.count == len(stamps)
    assert meter.rate(7.0) == pytest.approx(rate)


def test_a_message_without_a_stamp_is_counted_by_the_wall_clock() -> None:
    meter = _Meter()
    for _ in range(3):
        meter.see(frame(dialect.MAVLink_heartbeat_message(2, 3, 0, 0, 3, 3)))
    assert (meter.first, meter.last) == (0.0, 0.0)
    assert meter.rate(7.0) == 7.0


async def test_what_comes_while_it_is_watched_is_counted_and_nothing_afterwards(ardupilot: FakeVehicle) -> None:
    forgotten: list[bool] = []
    ardupilot.link.subscribe = lambda *_: lambda: forgotten.append(True)  # type: ignore[method-assign]
    watching = asyncio.ensure_future(measure(ardupilot.vehicle, (IMU, 116), 2.0))
    await asyncio.sleep(0)
    for k in range(5):
        ardupilot.hear(imu(10.0 + k / 10))
    await asyncio.sleep(0)
    assert not watching.done()
    ardupilot.advance(2.0)
    wall, own = await watching
    assert wall == {IMU: 2.5, 116: 0.0}
    assert own == {IMU: pytest.approx(10.0), 116: 0.0}
    assert forgotten == [True]


async def test_watching_for_no_time_counts_nothing_and_waits_for_nothing(ardupilot: FakeVehicle) -> None:
    assert await asyncio.wait_for(measure(ardupilot.vehicle, (IMU,), 0.0), 5.0) == ({IMU: 0.0}, {IMU: 0.0})


@pytest.mark.parametrize(
    ("received", "lost", "loss"), [(0, 0, 0.0), (8, 2, 0.2), (10, 0, 0.0), (0, 3, 1.0), (10, -2, 0.0), (1, -2, 0.0)]
)
async def test_the_loss_is_the_share_of_what_was_sent_meanwhile(
    ardupilot: FakeVehicle, received: int, lost: int, loss: float
) -> None:
    link = ardupilot.link
    link.received, link.lost, link.bytes_per_s = 1000, 500, 77.0
    watching = asyncio.ensure_future(_watch(ardupilot.vehicle, (IMU,), 1.0))
    await asyncio.sleep(0)
    link.received, link.lost = 1000 + received, 500 + lost
    ardupilot.advance(1.0)
    seen = await watching
    assert (seen.loss, seen.bytes_per_s) == (pytest.approx(loss), 77.0)


# --- concluding


@pytest.mark.parametrize(
    ("wall", "own", "speed"),
    [
        ({1: 100.0}, {1: 10.0}, 10.0),
        ({1: 5.0}, {1: 10.0}, 1.0),  # a slow link does not slow the vehicle down
        ({1: 0.0, 2: 30.0}, {1: 10.0, 2: 10.0}, 3.0),
        ({1: 4.0}, {1: 0.0}, 1.0),
        ({1: 0.5}, {1: 0.125}, 4.0),
        ({}, {}, 1.0),
    ],
)
def test_how_fast_the_vehicles_time_goes(wall: dict[int, float], own: dict[int, float], speed: float) -> None:
    assert _Seen(wall, own, 0.0, 0.0).speed == speed


@pytest.mark.parametrize(
    ("before", "relieved", "anyway"),
    [(0.5, 0.3, True), (0.5, 0.2, False), (0.5, 0.25, False), (LOSSY, 1.0, False), (LOSSY / 2, 1.0, False)],
)
def test_a_link_that_loses_hardly_less_is_bad_and_not_slow(before: float, relieved: float, *, anyway: bool) -> None:
    assert _loses_anyway(_Seen({}, {}, before, 0.0), _Seen({}, {}, relieved, 0.0)) is anyway


@pytest.mark.parametrize(("one", "other", "smaller"), [(None, None, None), (2.0, None, 2.0), (3.0, 1.0, 1.0)])
def test_the_smaller_of_two_capacities_counts(one: float | None, other: float | None, smaller: float | None) -> None:
    assert _smaller(one, other) == smaller


@pytest.mark.parametrize(("rate", "interval"), [(50.0, 20_000.0), (0.5, 2e6), (0.0, -1), (1.0, 1e6)])
def test_a_rate_of_zero_switches_a_stream_off(rate: float, interval: float) -> None:
    assert _interval_us(rate) == interval


@pytest.mark.parametrize(("age", "known"), [(0.0, 900.0), (REMEMBERED_S, 900.0), (REMEMBERED_S + 0.1, None)])
async def test_what_a_link_carried_is_remembered_for_a_while(
    ardupilot: FakeVehicle, age: float, known: float | None
) -> None:
    assert _remembered(ardupilot.vehicle) is None
    ardupilot.vehicle.carried = (900.0, ardupilot.clock.now)
    ardupilot.clock.now += age
    assert _remembered(ardupilot.vehicle) == known


@pytest.mark.parametrize(
    ("delay", "idle", "late", "anyway"),
    [
        (0.5, 0.1, 0.3, True),
        (0.5, 0.45, 0.3, False),  # it has become quick again
        (0.5, 0.1, LATE_S, True),
        (2.0, 0.1, LATE_S + 0.1, False),  # a full buffer takes longer to empty
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
