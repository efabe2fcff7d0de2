from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mavcal.service.link.capacity import (
    SHARE,
    Arrivals,
    bytes_needed,
    frame_bytes,
    helped,
    lowered,
    nominal_capacity,
    plan_rates,
    samples,
    seen_capacity,
    slowdown,
    unlimited,
)
from mavcal.service.link.endpoint import FORMS, parse_endpoint
from tests.examples import examples

ASKED = {27: 50.0, 116: 50.0, 105: 50.0, 245: 1.0}
SIZES = {key: frame_bytes(key) for key in ASKED}


def test_sizes_are_those_on_the_wire() -> None:
    assert frame_bytes(27) == 41
    assert frame_bytes(105) == 75
    assert frame_bytes(999999) == 267


def test_a_fast_link_changes_nothing() -> None:
    assert plan_rates(ASKED, None) == ASKED
    assert plan_rates(ASKED, 100_000.0) == ASKED


def test_a_slow_radio_gets_what_it_carries_and_keeps_the_state_messages() -> None:
    planned = plan_rates(ASKED, 3000.0)
    assert planned[245] == 1.0
    assert bytes_needed(planned, SIZES) <= SHARE * 3000.0
    assert planned[27] == planned[116] == planned[105]
    assert slowdown(ASKED, planned) == pytest.approx(50.0 / planned[27])
    assert 3 < slowdown(ASKED, planned) < 6


def test_nothing_is_planned_below_once_a_second() -> None:
    assert plan_rates(ASKED, 50.0)[27] == 1.0


def test_the_given_sizes_count() -> None:
    planned = plan_rates({1: 10.0}, 200.0, {1: 40})
    assert planned[1] == pytest.approx((0.7 * 200 - 100) / 40)


@pytest.mark.parametrize(
    ("url", "capacity"),
    [
        ("serial:/dev/ttyUSB0:57600", 5760.0),
        ("serial:/dev/serial/by-id/usb-Cube:57600", None),
        ("serial:/dev/ttyACM0:57600", None),
    ],
)
def test_what_a_serial_port_carries_at_most(url: str, capacity: float | None) -> None:
    assert nominal_capacity(parse_endpoint(url)) == capacity
    assert nominal_capacity(parse_endpoint("udpin:0.0.0.0:14550")) is None


def seen(own: dict[int, float], loss: float = 0.0, bytes_per_s: float = 900.0, queued: float = 0.0) -> Arrivals:
    return Arrivals(own, own, loss, bytes_per_s, dict.fromkeys(own, queued))


def test_a_link_that_loses_or_holds_up_everything_is_too_slow() -> None:
    assert seen_capacity(ASKED, seen(ASKED), late=False) is None
    assert seen_capacity(ASKED, seen(ASKED, 0.3, 4000.0), late=False) == 4000.0
    came = {27: 20.0, 116: 22.0, 105: 19.0, 245: 1.0}
    assert seen_capacity(ASKED, seen(came, 0.0, 4000.0), late=False) == 4000.0


def test_a_stream_that_never_comes_or_is_rounded_by_the_firmware_is_not_the_links_fault() -> None:
    assert seen_capacity(ASKED, seen({**ASKED, 116: 0.0}), late=True) is None
    assert seen_capacity({26: 200.0}, seen({26: 124.0}), late=True) is None
    assert slowdown(ASKED, {**ASKED, 116: 0.0}) == 1.0


@pytest.mark.parametrize(
    ("own", "queued", "late", "slow"),
    [
        (50.0, 0.0, True, False),  # answers are late, and no sample is: somebody else keeps us waiting
        (50.0, 0.1, False, False),  # samples come later and later, and answers at once: the vehicle's time is slower
        (50.0, 0.1, True, True),
        (44.0, 0.0, True, True),  # a full buffer
        (44.0, 0.0, False, False),
    ],
)
def test_a_buffer_that_fills_delays_both_samples_and_answers(
    own: float, queued: float, *, late: bool, slow: bool
) -> None:
    found = seen_capacity({27: 50.0}, seen({27: own}, queued=queued), late=late)
    assert (found is not None) is slow


def test_what_the_vehicle_sent_counts_and_not_what_was_lost_on_the_way() -> None:
    assert seen_capacity({27: 50.0}, seen({27: 37.0}, loss=0.09), late=False) is None
    assert seen_capacity({27: 50.0}, seen({27: 37.0}), late=False) == 900.0


def test_no_rate_is_cut_to_less_than_a_quarter_at_once() -> None:
    asked = {27: 50.0, 245: 2.0}
    assert lowered(asked, 300.0) == {27: 12.5, 245: 2.0}
    assert lowered(asked, 4000.0) == plan_rates(asked, 4000.0)
    assert lowered(asked, None) == asked


@pytest.mark.parametrize(
    ("before", "after", "good"),
    [
        (seen({27: 50.0}, loss=0.3), seen({27: 20.0}, loss=0.16), False),
        (seen({27: 50.0}, loss=0.3), seen({27: 20.0}, loss=0.15), True),
        (seen({27: 20.0}), seen({27: 8.0}), False),  # as small a share of less
        (seen({27: 20.0}), seen({27: 20.0}), True),
        (seen({27: 20.0}), seen({27: 20.0}, bytes_per_s=1100.0), False),  # it carries more than was said
        (seen({}), seen({}), True),
    ],
)
def test_asking_for_less_has_helped_if_the_link_does_better_then(
    before: Arrivals, after: Arrivals, *, good: bool
) -> None:
    assert helped({27: 50.0}, before, {27: 20.0}, after) is good


def test_capacity_counts_in_the_vehicles_time() -> None:
    twice = Arrivals({27: 50.0}, {27: 100.0}, 0.0, 4000.0, {})
    assert (twice.speed, twice.own_bytes_per_s) == (2.0, 2000.0)
    assert Arrivals({27: 50.0}, {27: 30.0}, 0.0, 4000.0, {}).speed == 1.0  # a slow link does not slow a vehicle down


@pytest.mark.parametrize(("refused", "left"), [((), (27, 116)), ((27,), (116,))])
def test_samples_are_what_is_fast_and_not_refused(refused: tuple[int, ...], left: tuple[int, ...]) -> None:
    assert samples({27: 50.0, 116: 25.0, 245: 2.0}, refused) == left


def test_a_request_that_just_fits_is_granted_and_one_byte_more_is_not() -> None:
    """70 % of 1000 bytes a second, less 100 for what comes unasked, are 600."""
    assert plan_rates({1: 10.0, 2: 2.0}, 1000.0, {1: 50, 2: 50}) == {1: 10.0, 2: 2.0}
    planned = plan_rates({1: 10.0, 2: 2.0}, 1000.0, {1: 51, 2: 50})
    assert planned == {1: pytest.approx(500 / 51), 2: 2.0}  # what is as slow as 2 Hz is state


def test_a_radio_that_carries_not_even_the_state_still_brings_every_sample_stream_once_a_second() -> None:
    assert plan_rates({1: 50.0, 2: 1.0}, 150.0, {1: 40, 2: 90}) == {1: 1.0, 2: 1.0}
    assert plan_rates({2: 2.0}, 150.0, {2: 90}) == {2: 2.0}  # nothing but state


SIZED = st.dictionaries(st.sampled_from([24, 26, 27, 29, 105, 116, 245]), st.floats(0.5, 400.0), min_size=1)


@settings(max_examples=examples(50))
@given(SIZED, st.floats(200.0, 1e5))
def test_rates_fit_or_are_the_slowest_and_no_stream_is_favoured(asked: dict[int, float], capacity: float) -> None:
    planned = plan_rates(asked, capacity)
    sizes = {key: frame_bytes(key) for key in asked}
    assert planned.keys() == asked.keys()
    assert all(planned[key] <= max(asked[key], 1.0) for key in asked)
    slowed = {key: planned[key] / asked[key] for key in asked if asked[key] > 2.0 and planned[key] > 1.0}
    assert slowed == {} or max(slowed.values()) == pytest.approx(min(slowed.values()))
    if all(rate > 1.0 for key, rate in planned.items() if asked[key] > 2.0):
        fits = bytes_needed(planned, sizes) <= 0.7 * capacity - 100.0 + 1e-6
        assert fits or all(rate <= 2.0 for rate in asked.values())


@settings(max_examples=examples(50))
@given(SIZED, st.floats(200.0, 1e5), st.floats(1.0, 3.0))
def test_a_faster_link_never_slows_a_stream(asked: dict[int, float], capacity: float, factor: float) -> None:
    slow, fast = plan_rates(asked, capacity), plan_rates(asked, factor * capacity)
    assert all(fast[key] >= slow[key] - 1e-9 for key in asked if asked[key] >= 1.0)


@pytest.mark.parametrize(("loss", "carried"), [(0.1, None), (0.101, 900.0)])
def test_a_tenth_may_be_lost(loss: float, carried: float | None) -> None:
    assert seen_capacity(ASKED, seen(ASKED, loss), late=False) == carried


@pytest.mark.parametrize(
    ("asked", "came", "carried"),
    [
        ({27: 50.0}, {27: 40.0}, None),  # four fifths are not yet held up
        ({27: 50.0}, {27: 39.9}, 900.0),
        (
            {27: 50.0, 29: 50.0},
            {27: 30.0, 29: 41.0},
            None,
        ),  # one comes as asked for: it is carried
        ({27: 51.0}, {27: 20.0}, None),  # firmwares round what is faster than 50 Hz
        ({27: 2.0}, {27: 1.0}, None),  # state says nothing
        ({27: 50.0}, {}, None),
    ],
)
def test_a_link_is_slow_if_every_telling_stream_is_held_up(
    asked: dict[int, float], came: dict[int, float], carried: float | None
) -> None:
    assert seen_capacity(asked, seen(came), late=False) == carried


def test_the_slowest_stream_says_how_long_it_takes() -> None:
    assert slowdown({1: 50.0, 2: 10.0}, {1: 25.0, 2: 2.0}) == 5.0
    assert slowdown({1: 50.0}, {1: 60.0}) == 1.0  # nobody is faster than planned
    assert slowdown({}, {}) == 1.0


def test_only_a_simulated_vehicle_carries_whatever_is_asked_for() -> None:
    assert unlimited(parse_endpoint("sim:px4"))
    assert not any(unlimited(parse_endpoint(url)) for url in FORMS if not url.startswith("sim:"))
