"""Who is blamed where compasses, the model and the vehicle's heading disagree."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mavcal.calib.preflight.check import Verdict
from mavcal.calib.preflight.compass import compass_direction, compass_field, set_declination
from tests.fields import field_of

from .test_compass import FIELD, LEVEL, Upright, down, reading, upright


def turned_vehicle(heading_deg: float) -> Upright:
    """A level vehicle that takes true north for so many degrees beside it."""
    north = np.array([math.cos(math.radians(heading_deg)), math.sin(math.radians(heading_deg)), 0.0])
    return Upright(down(LEVEL), north, None)


def test_of_three_compasses_the_majority_tells() -> None:
    for odd in range(3):
        there = {i: reading(LEVEL, turned=30.0 * (i == odd)) for i in range(3)}
        found = compass_direction(there, upright(LEVEL), FIELD, None)
        assert (found.verdict, found.suspects) == (Verdict.FAIL, (f"compass {odd + 1}",))


def test_of_two_compasses_nothing_tells_unless_a_heading_is_given() -> None:
    for bent in range(2):
        there = {i: reading(LEVEL, turned=30.0 * (i == bent)) for i in range(2)}
        both = compass_direction(there, upright(LEVEL), FIELD, None)
        assert both.suspects == ("compass 1", "compass 2")
        assert "the true heading" in both.remedy
        given = compass_direction(there, upright(LEVEL, heading=0.0), FIELD, None)
        assert given.suspects == (f"compass {bent + 1}",)


def test_the_vehicles_heading_is_a_witness_against_the_compass_that_it_follows_alone() -> None:
    there = {0: reading(LEVEL, turned=30.0), 1: reading(LEVEL)}
    against = compass_direction(there, upright(LEVEL, north=True), FIELD, None, followed=0)
    assert against.suspects == ("compass 1",)
    followed = compass_direction(there, turned_vehicle(30.0), FIELD, None, followed=0)
    assert followed.suspects == ("compass 1", "compass 2")  # the first one is wrong, and the vehicle believes it


@pytest.mark.parametrize("count", [1, 2, 3])
def test_a_wrong_declination_is_no_compass(count: int) -> None:
    wrong = {"COMPASS_AUTODEC": 0, "COMPASS_DEC": FIELD.declination + 0.6}
    there = {i: reading(LEVEL) for i in range(count)}
    for vehicle in (upright(LEVEL, north=True), turned_vehicle(math.degrees(0.6)), turned_vehicle(-math.degrees(0.6))):
        declination = set_declination("ardupilot", wrong, FIELD)
        found = compass_direction(there, vehicle, FIELD, None, declination=declination)
        assert (found.verdict, found.suspects) == (Verdict.FAIL, ("declination",))
        assert "COMPASS_AUTODEC" in found.remedy


@pytest.mark.parametrize(
    ("autopilot", "parameters", "off"),
    [
        ("ardupilot", {"COMPASS_AUTODEC": 1, "COMPASS_DEC": 0.6}, None),
        ("ardupilot", {}, None),
        ("ardupilot", {"COMPASS_AUTODEC": 0, "COMPASS_DEC": FIELD.declination}, 0.0),
        ("px4", {"EKF2_DECL_TYPE": 3, "EKF2_MAG_DECL": 60.0}, None),
        ("px4", {"EKF2_DECL_TYPE": 2, "EKF2_MAG_DECL": math.degrees(FIELD.declination) - 20.0}, 20.0),
    ],
)
def test_a_declination_counts_where_it_is_set_by_hand(
    autopilot: str, parameters: dict[str, float], off: float | None
) -> None:
    found = set_declination(autopilot, parameters, FIELD)
    assert (None if found is None else found.value) == (None if off is None else pytest.approx(off, abs=1e-9))
    assert set_declination(autopilot, parameters, None) is None


def test_where_all_compasses_agree_the_vehicles_own_heading_is_off() -> None:
    there = {i: reading(LEVEL) for i in range(2)}
    found = compass_direction(there, turned_vehicle(40.0), FIELD, None)
    assert found.verdict == Verdict.FAIL
    assert "the vehicle's own heading" in found.suspects
    assert not any(suspect.startswith("compass") for suspect in found.suspects)


def test_a_position_far_off_is_a_suspect_of_its_own() -> None:
    elsewhere = field_of(30.0, FIELD.inclination, FIELD.declination)
    found = compass_field({i: reading(LEVEL) for i in range(3)}, (), elsewhere)
    assert (found.verdict, found.suspects[0]) == (Verdict.FAIL, "position")
    assert "position" in found.remedy
    alone = compass_field({0: reading(LEVEL)}, (), elsewhere)
    assert alone.suspects == ("compass 1", "position")
    steeper = field_of(FIELD.norm, math.radians(20.0), FIELD.declination)
    dip = compass_direction({i: reading(LEVEL) for i in range(3)}, upright(LEVEL), steeper, None)
    assert dip.suspects[0] == "position"


def test_a_field_that_is_nowhere_on_earth_is_no_matter_of_the_position() -> None:
    assert compass_field({0: reading(LEVEL, factor=2.0)}, (), FIELD).suspects == ("compass 1",)
    everywhere = compass_field({i: reading(LEVEL, factor=2.0) for i in range(2)}, (), FIELD)
    assert everywhere.suspects == ("surroundings",)


def test_one_that_reads_another_strength_alone_is_named() -> None:
    found = compass_field({0: reading(LEVEL), 1: reading(LEVEL, factor=1.4)}, (), FIELD)
    assert found.suspects == ("compass 2",)


def test_a_pass_names_what_was_compared_and_nothing_else() -> None:
    two = compass_direction({i: reading(LEVEL) for i in (0, 2)}, upright(LEVEL), FIELD, None, installed=3)
    assert all(token in two.reason for token in ("2 of", "3 compasses", "dip", "heading", "model", "each other"))
    one = compass_direction({0: reading(LEVEL)}, upright(LEVEL), FIELD, None)
    assert all(token in one.reason for token in ("only compass", "dip", "heading", "model"))
    assert not any(token in one.reason for token in ("each other", "vehicle's own"))
