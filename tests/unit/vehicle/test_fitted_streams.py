"""Rates are lowered for a link that carries less, and for nothing else that makes samples late."""

from __future__ import annotations

import itertools

import pytest

from mavcal.service.vehicle.streams import FRESH_S, MEASURE_S, REMEMBERED_S, demand_streams, request_streams
from tests.unit.vehicle.fake import FakeVehicle
from tests.unit.vehicle.port import IMU, IMU2, RAW, Ported, requests

WISH = {IMU: 50.0, IMU2: 50.0, RAW: 50.0}
FULL_BYTES_PER_S = 50 * (36 + 36 + 41)
"""About what three streams at 50 Hz need with their frames."""


async def granted(fake: FakeVehicle, limit: float = 60.0) -> float:
    """The share of the rates that is left in the end; also what the report says of it."""
    report = await fake.run(request_streams(fake.vehicle, WISH), step=0.01, limit=limit)
    last = dict(requests(fake))
    share = min(20_000 / interval for interval in last.values())
    assert (report.capacity_bytes_per_s is None) == (share == 1.0)
    return share


@pytest.mark.parametrize("start_s", [0.0, 0.97, 3.0])
@pytest.mark.parametrize("awake", [1.0, 0.2])
async def test_a_vehicle_that_begins_late_is_asked_for_no_less(
    ardupilot: FakeVehicle, start_s: float, awake: float
) -> None:
    """Whatever share of a core our own process gets: stamps and sequence numbers say that nothing is missing."""
    Ported(ardupilot, start_s=start_s, awake=awake)
    began = ardupilot.clock.now
    assert await granted(ardupilot) == 1.0
    assert len(requests(ardupilot)) == len(WISH)
    assert ardupilot.vehicle.carried is None
    # an answer takes two turns of a process that is held up
    assert ardupilot.clock.now - began < start_s + MEASURE_S + (0.5 if awake == 1.0 else 12.0)


async def test_streams_are_watched_for_two_seconds_of_the_vehicles_time_from_their_first_sample_on(
    ardupilot: FakeVehicle,
) -> None:
    Ported(ardupilot, start_s=1.5)
    report = await ardupilot.run(request_streams(ardupilot.vehicle, WISH), step=0.01)
    assert [rate.measured_hz for rate in report.rates.values()] == pytest.approx([50.0] * 3, rel=0.02)
    assert [rate.wall_hz for rate in report.rates.values()] == pytest.approx([50.0] * 3, rel=0.05)


@pytest.mark.parametrize("speed", [0.6, 1.0, 4.0])
async def test_a_simulated_vehicle_slower_or_faster_than_the_wall_is_asked_for_no_less(
    ardupilot: FakeVehicle, speed: float
) -> None:
    Ported(ardupilot, speed=speed, start_s=0.5)
    assert await granted(ardupilot) == 1.0


@pytest.mark.sampled
@pytest.mark.parametrize("buffer_bytes", [512.0, 2048.0, 8192.0])
@pytest.mark.parametrize("carried", [0.4, 0.6, 0.87])
async def test_a_full_port_is_asked_for_what_it_carries(
    ardupilot: FakeVehicle, carried: float, buffer_bytes: float
) -> None:
    """Whatever its buffer: it holds samples back, or delays them more and more, or both."""
    Ported(ardupilot, bytes_per_s=carried * FULL_BYTES_PER_S, buffer_bytes=buffer_bytes, start_s=0.7)
    share = await granted(ardupilot)
    assert 0.4 * carried < share < 0.85 * carried
    (known, _at) = ardupilot.vehicle.carried
    assert known == pytest.approx(carried * FULL_BYTES_PER_S, rel=0.2)


async def test_a_very_slow_port_is_found_in_steps(ardupilot: FakeVehicle) -> None:
    Ported(ardupilot, bytes_per_s=960.0)
    share = await granted(ardupilot)
    assert 0.05 < share < 0.2
    steps = sorted({interval for _, interval in requests(ardupilot)})
    assert steps[0] == 20_000
    assert all(after <= 4.01 * before for before, after in itertools.pairwise(steps))


@pytest.mark.parametrize("loss", [0.05, 0.15, 0.3])
async def test_a_link_that_loses_as_much_of_less_is_asked_for_everything(ardupilot: FakeVehicle, loss: float) -> None:
    Ported(ardupilot, loss=loss)
    assert await granted(ardupilot) == 1.0
    assert ardupilot.vehicle.carried is None


async def test_a_vehicle_that_sends_as_small_a_share_of_less_is_slow_itself(ardupilot: FakeVehicle) -> None:
    Ported(ardupilot, share=0.5)
    assert await granted(ardupilot) == 1.0


async def test_a_link_that_has_become_better_is_asked_for_everything_at_the_next_measurement(
    ardupilot: FakeVehicle,
) -> None:
    port = Ported(ardupilot, bytes_per_s=0.5 * FULL_BYTES_PER_S)
    assert await granted(ardupilot) < 0.5
    port.bytes_per_s = 0.0
    assert await granted(ardupilot) == 1.0
    assert ardupilot.vehicle.carried is None


@pytest.mark.parametrize(
    ("age_s", "times"), [(0.0, 1), (FRESH_S - 1, 1), (FRESH_S + 1, 2), (2 * FRESH_S + 1, 4), (REMEMBERED_S + 1, None)]
)
async def test_what_was_not_measured_again_counts_for_less_and_less(
    ardupilot: FakeVehicle, age_s: float, times: int | None
) -> None:
    Ported(ardupilot)
    ardupilot.vehicle.carried = (800.0, ardupilot.clock.now)
    ardupilot.clock.now += age_s
    planned = demand_streams(ardupilot.vehicle, WISH)
    needed = sum(rate * size for rate, size in zip(planned.values(), (36, 36, 41), strict=True))
    assert needed < 0.75 * 800.0 * times if times is not None else planned == WISH


async def test_a_request_that_is_not_measured_trusts_only_what_was_seen_a_moment_ago(ardupilot: FakeVehicle) -> None:
    Ported(ardupilot)
    ardupilot.vehicle.carried = (1500.0, ardupilot.clock.now)
    report = await ardupilot.run(request_streams(ardupilot.vehicle, WISH, measure_s=0.0), step=0.01)
    assert report.capacity_bytes_per_s == 1500.0
    ardupilot.clock.now += FRESH_S + 1
    report = await ardupilot.run(request_streams(ardupilot.vehicle, WISH, measure_s=0.0), step=0.01)
    assert (report.capacity_bytes_per_s, ardupilot.vehicle.carried) == (None, None)
