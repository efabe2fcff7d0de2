from __future__ import annotations

import pytest

from mavcal.service.link import parse_endpoint
from mavcal.service.link.capacity import (
    SHARE,
    bytes_needed,
    frame_bytes,
    nominal_capacity,
    plan_rates,
    seen_capacity,
    slowdown,
)

ASKED = {27: 50.0, 116: 50.0, 105: 50.0, 245: 1.0}
SIZES = {key: frame_bytes(key) for key in ASKED}


def test_sizes_are_those_on_the_wire() -> None:
    assert frame_bytes(27) == 41
    assert frame_bytes(105) == 75
    assert frame_bytes(27, signed=True) == 54
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


def test_a_link_that_loses_or_holds_up_everything_is_too_slow() -> None:
    full = dict(ASKED)
    assert seen_capacity(ASKED, full, 0.0, 9000.0) is None
    assert seen_capacity(ASKED, full, 0.3, 4000.0) == 4000.0
    assert seen_capacity(ASKED, {27: 20.0, 116: 22.0, 105: 19.0, 245: 1.0}, 0.0, 4000.0) == 4000.0


def test_a_stream_that_never_comes_or_is_rounded_by_the_firmware_is_not_the_links_fault() -> None:
    assert seen_capacity(ASKED, {**ASKED, 116: 0.0}, 0.0, 6000.0) is None
    assert seen_capacity({26: 200.0}, {26: 124.0}, 0.0, 6000.0) is None
    assert slowdown(ASKED, {**ASKED, 116: 0.0}) == 1.0
