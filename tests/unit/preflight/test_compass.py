"""Compasses at rest, in any attitude: what is turned, tilted or disturbed by how much."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from mavcal.calib.earth import EarthField
from mavcal.calib.preflight import limits
from mavcal.calib.preflight.check import Check, Verdict
from mavcal.calib.preflight.compass import Upright, compass_direction, compass_field, disturbed
from mavcal.calib.preflight.rest import Mean
from tests.examples import examples
from tests.fields import field_of

FIELD = field_of(48.0, math.radians(64.0), math.radians(5.0), norm_sd=0.2, model="WMM-2025")
LEVEL = Rotation.identity()
ANGLES = st.floats(-180.0, 180.0)


def mean(vector: np.ndarray, sd: float = 0.02) -> Mean:
    return Mean(np.asarray(vector, dtype=float), np.full(3, sd), np.full(3, 0.3), 0.0, 300, 6.0)


def reading(body: Rotation, *, turned: float = 0.0, factor: float = 1.0, field: EarthField = FIELD) -> Mean:
    """What a compass reads in this attitude (world from body), turned about the vehicle's own down by `turned` deg."""
    own = Rotation.from_rotvec(math.radians(turned) * down(body))
    return mean(factor * own.apply(body.inv().apply(field.north_east_down)))


def down(body: Rotation) -> np.ndarray:
    return body.inv().apply([0.0, 0.0, 1.0])


def upright(body: Rotation, *, north: bool = False, heading: float | None = None) -> Upright:
    north_there = body.inv().apply([1.0, 0.0, 0.0]) if north else None
    return Upright(down(body), north_there, None if heading is None else math.radians(heading))


def numbers(check: Check) -> dict[str, float]:
    """Every number of a check by what it is of, from its evidence."""
    lines = [line.rsplit(": ", 1) for line in check.evidence if "limit" in line]
    return {name: float(rest.split(" ")[0]) for name, rest in lines}


def number_of(check: Check, *tokens: str) -> float:
    """The one number of a check whose name has all of these in it."""
    (found,) = (value for name, value in numbers(check).items() if all(token in name for token in tokens))
    return found


def attitude(yaw: float, pitch: float, roll: float) -> Rotation:
    return Rotation.from_euler("ZYX", [yaw, pitch, roll], degrees=True)


@settings(max_examples=examples(25))
@given(ANGLES, st.floats(-50.0, 50.0), st.floats(-80.0, 80.0))
def test_compasses_that_read_the_field_agree_in_every_attitude(yaw: float, pitch: float, roll: float) -> None:
    body = attitude(yaw, pitch, roll)
    compasses = {0: reading(body), 1: reading(body)}
    found = compass_direction(compasses, upright(body, north=True, heading=yaw), FIELD, None)
    assert found.verdict is Verdict.PASS
    assert max(numbers(found).values()) < 0.05
    assert compass_field(compasses, (), FIELD).verdict is Verdict.PASS


@settings(max_examples=examples(25))
@given(ANGLES, st.floats(-40.0, 40.0), st.floats(-40.0, 40.0), st.floats(-170.0, 170.0))
def test_a_compass_that_is_turned_is_off_by_that_angle(yaw: float, pitch: float, roll: float, turned: float) -> None:
    body = attitude(yaw, pitch, roll)
    compasses = {0: reading(body), 2: reading(body, turned=turned)}
    found = compass_direction(compasses, upright(body, north=True, heading=yaw), FIELD, None)
    expected = pytest.approx(abs(turned), rel=0.01, abs=0.05)
    assert number_of(found, "heading", "1 and 3") == expected
    assert number_of(found, "heading", "compass 3", "vehicle's own") == expected
    assert number_of(found, "heading", "compass 3", "given") == expected
    assert number_of(found, "heading", "compass 1", "given") < 0.05
    assert number_of(found, "dip", "compass 3") < 0.05  # a turn changes no dip


@pytest.mark.parametrize(("tilt", "verdict"), [(5.0, Verdict.PASS), (10.5, Verdict.WARN), (25.0, Verdict.FAIL)])
def test_a_field_that_dips_otherwise_is_judged_by_how_far(tilt: float, verdict: Verdict) -> None:
    steeper = field_of(FIELD.norm, FIELD.inclination - math.radians(tilt), FIELD.declination)
    found = compass_direction({0: reading(LEVEL, field=steeper)}, upright(LEVEL), FIELD, None)
    assert found.verdict is verdict
    assert found.value == pytest.approx(tilt, abs=0.1)


def test_what_all_compasses_share_shows_against_a_known_heading_alone() -> None:
    compasses = {i: reading(LEVEL, turned=40.0) for i in (0, 1)}
    blind = compass_direction(compasses, upright(LEVEL), FIELD, None)
    assert blind.verdict is Verdict.PASS
    assert any("give it to check" in line for line in blind.evidence)
    known = compass_direction(compasses, upright(LEVEL, heading=0.0), FIELD, None)
    assert (known.verdict, known.value) == (Verdict.FAIL, pytest.approx(40.0, abs=0.1))
    assert not any("give it to check" in line for line in known.evidence)


def test_a_nose_that_points_up_has_no_heading() -> None:
    for pitch, compared in ((55.0, True), (85.0, False)):
        body = attitude(0.0, pitch, 0.0)
        found = numbers(compass_direction({0: reading(body)}, upright(body, heading=0.0), FIELD, None))
        assert any("heading" in name and "given" in name for name in found) is compared


def test_near_the_pole_a_heading_is_too_uncertain_to_judge() -> None:
    steep = field_of(58.0, math.radians(88.5))
    compasses = {0: reading(LEVEL, field=steep), 1: reading(LEVEL, field=steep, turned=20.0)}
    assert compass_direction(compasses, upright(LEVEL), steep, None).verdict is Verdict.UNKNOWN


def test_a_compass_of_the_wrong_strength_is_left_out_of_the_direction() -> None:
    compasses = {0: reading(LEVEL), 1: reading(LEVEL), 2: reading(LEVEL, factor=1.6, turned=90.0)}
    assert disturbed(compasses, FIELD) == {2}
    found = compass_direction(compasses, upright(LEVEL), FIELD, None)
    assert found.verdict is Verdict.PASS
    assert any(line.startswith("compass 3 is left out") for line in found.evidence)
    assert not any("compass 3" in name or "and 3" in name for name in numbers(found))


def test_where_nothing_is_left_to_compare_it_says_why() -> None:
    alone = {0: reading(LEVEL, factor=2.0)}
    found = compass_direction(alone, upright(LEVEL), FIELD, None)
    assert found.verdict is Verdict.UNKNOWN
    assert "compass 1 " in found.reason
    assert "strength" in found.reason
    nowhere = compass_direction({0: reading(LEVEL)}, upright(LEVEL), None, None)
    assert nowhere.verdict is Verdict.UNKNOWN
    assert "dip" in nowhere.reason
    assert "strength" not in nowhere.reason


def test_without_a_position_compasses_are_still_compared_with_each_other() -> None:
    compasses = {0: reading(LEVEL), 1: reading(LEVEL, turned=30.0)}
    found = compass_direction(compasses, upright(LEVEL, north=True, heading=0.0), None, None)
    assert set(numbers(found)) == {"heading between compasses 1 and 2"}
    assert found.verdict is Verdict.FAIL


@pytest.mark.parametrize(("there", "motion"), [(None, None), (upright(LEVEL), "the vehicle was moved")])
def test_without_a_vertical_no_direction_is_judged(there: Upright | None, motion: str | None) -> None:
    found = compass_direction({0: reading(LEVEL, turned=90.0)}, there, FIELD, motion)
    assert found.verdict is Verdict.UNKNOWN
    assert (motion or "no accelerometer") in found.reason


def test_a_compass_that_was_not_heard_is_no_pass() -> None:
    assert compass_direction({}, upright(LEVEL), FIELD, None).verdict is Verdict.UNKNOWN
    assert compass_field({}, (), FIELD).reason == "No compass was heard."
    assert "only 3 samples" in compass_field({}, ("only 3 samples of mag 1 came",), FIELD).reason


@pytest.mark.parametrize(
    ("factor", "verdict"), [(1.0, Verdict.PASS), (1.15, Verdict.PASS), (1.23, Verdict.WARN), (0.5, Verdict.FAIL)]
)
def test_the_strength_is_compared_with_the_model(factor: float, verdict: Verdict) -> None:
    found = compass_field({0: reading(LEVEL), 1: reading(LEVEL, factor=factor)}, (), FIELD)
    assert found.verdict is verdict
    assert found.value == pytest.approx(abs(factor - 1.0) * FIELD.norm, abs=1e-9)
    if verdict is Verdict.PASS:
        assert "48.0 uT (WMM-2025)" in found.reason


@pytest.mark.parametrize(
    ("strength", "verdict"),
    [
        (limits.WEAKEST_FIELD, Verdict.UNKNOWN),
        (limits.STRONGEST_FIELD, Verdict.UNKNOWN),
        (limits.WEAKEST_FIELD - 13.0, Verdict.FAIL),
        (limits.STRONGEST_FIELD + 13.0, Verdict.FAIL),
    ],
)
def test_without_a_position_only_what_is_nowhere_on_earth_fails(strength: float, verdict: Verdict) -> None:
    found = compass_field({0: mean(np.array([0.0, 0.0, strength]))}, (), None)
    assert found.verdict is verdict
    assert ("cannot be compared" in found.reason) is (verdict is Verdict.UNKNOWN)
