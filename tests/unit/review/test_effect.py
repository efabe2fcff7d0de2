"""What a plan does for a sensor is what the two calibrations differ by."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavcal.calib.firmware.compose.plan import compose
from mavcal.calib.recording import Sensor
from mavcal.calib.review.effect import SensorEffect, amount, effects_of, heading_errors, headline_of, text_of
from mavcal.calib.review.picture import picture_of
from mavcal.calib.triad import TriadModel

HEADINGS = np.radians(np.arange(0.0, 360.0, 10.0))


@given(st.floats(-170.0, 170.0), st.floats(-1.3, 1.3))
def test_a_compass_turned_about_the_vertical_is_off_by_that_angle_when_level(angle, dip):
    c, s = math.cos(math.radians(angle)), math.sin(math.radians(angle))
    turned = TriadModel(matrix=np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]))
    errors = heading_errors(turned, TriadModel(), 50.0, dip, HEADINGS)
    np.testing.assert_allclose(errors[0], angle, atol=1e-9)


@given(st.floats(0.5, 10.0))
def test_a_hard_iron_is_off_most_where_the_field_is_across_it(offset):
    old = TriadModel(offset=np.array([offset, 0.0, 0.0]))
    errors = heading_errors(old, TriadModel(), 50.0, math.radians(60.0), np.radians(np.arange(0.0, 360.0, 0.5)))
    assert np.abs(errors[0]).max() == pytest.approx(math.degrees(math.asin(offset / 25.0)), rel=1e-3)


def test_two_equal_calibrations_differ_by_nothing():
    model = TriadModel(np.array([3.0, -4.0, 5.0]), np.diag([1.1, 0.9, 1.0]))
    assert np.abs(heading_errors(model, model, 50.0, 1.0, HEADINGS)).max() < 1e-9


def test_a_gyro_is_off_by_the_change_of_its_offset(ardupilot_parameters, ardupilot_fingerprint, make_fit):
    parameters = {**ardupilot_parameters, "INS_GYROFFS_X": 0.0, "INS_GYROFFS_Y": 0.0, "INS_GYROFFS_Z": 0.0}
    fit = make_fit(Sensor.GYRO, 0, offset=[0.01, -0.02, 0.005])
    (effect,) = effects_of([fit], compose([fit], parameters, ardupilot_fingerprint), parameters)
    assert effect.unit == "deg/s"
    assert effect.before == pytest.approx(math.degrees(0.02), rel=1e-5)
    assert effect.after == pytest.approx(math.degrees(1e-3), rel=1e-3)
    assert text_of(effect) == "rate at rest off by up to 1.1 deg/s now, good to 0.057 deg/s afterwards"
    assert headline_of([effect]) == "Rate at rest is wrong by up to 1.1 deg/s, and will be good to 0.057 deg/s."
    assert text_of(effect, done=True) == "rate at rest was off by up to 1.1 deg/s, good to 0.057 deg/s now"
    assert (
        headline_of([effect], done=True) == "Rate at rest was wrong by up to 1.1 deg/s, and is good to 0.057 deg/s now."
    )


def test_an_accelerometer_is_off_by_what_its_old_calibration_makes_of_gravity(
    ardupilot_parameters, ardupilot_fingerprint, make_fit
):
    fits = [make_fit(Sensor.ACCEL, i, offset=[0.3, -0.2, 0.15], matrix_sd=1e-4) for i in (0, 1)]
    plan = compose(fits, ardupilot_parameters, ardupilot_fingerprint)
    effects = effects_of(fits, plan, ardupilot_parameters)
    assert [effect.instance for effect in effects] == [0, 1]
    assert all(effect.before is not None and effect.before > 5 * effect.after > 0.0 for effect in effects)
    drawn = str(picture_of(effects, "told <b>"))
    assert drawn.count("before") >= 2
    assert all(f">{face}</text>" in drawn for face in ("+x", "-z")), "a face is called by its name, not its number"
    assert "told &lt;b&gt;" in drawn


def test_a_sensor_that_the_plan_leaves_alone_has_no_effect(ardupilot_parameters, ardupilot_fingerprint, make_fit):
    fit = make_fit(Sensor.GYRO, 0, offset=[0.01] * 3)
    plan = compose([fit], ardupilot_parameters, ardupilot_fingerprint)
    other = make_fit(Sensor.GYRO, 1, offset=[0.01] * 3)
    assert [effect.instance for effect in effects_of([fit, other], plan, ardupilot_parameters)] == [0]
    assert headline_of([]) == "This plan changes no sensor."
    assert picture_of([], "nothing") is None


def off(before, after=0.1, *, instance=0, quantity="rate at rest", unit="deg/s"):
    return SensorEffect(Sensor.GYRO, instance, quantity, unit, before, after, None)


def amounts(said):
    """Every number of a sentence with its unit."""
    return re.findall(r"[\d.]+ deg(?:/s)?", said)


def test_the_sensor_that_gains_most_is_named_first():
    """By how many times better it becomes, not by the number, which has another unit elsewhere."""
    heading = off(40.0, 20.0, quantity="heading", unit="deg")
    rate = headline_of([heading, off(1.0)])
    assert rate.startswith("Rate ")
    assert " 1 deg/s" in rate
    turned = headline_of([heading, off(0.11)])
    assert turned.startswith("Heading ")
    assert " 40 deg," in turned


def test_sensors_of_one_kind_are_told_by_the_worst_of_them():
    said = headline_of([off(1.0, 0.05), off(3.0, 0.2, instance=1), off(90.0, 60.0, quantity="heading", unit="deg")])
    assert said.startswith("Rate ")
    assert amounts(said) == ["3 deg/s", "0.2 deg/s"]


@pytest.mark.parametrize(("done", "verb"), [(False, "will be"), (True, "is")])
def test_what_was_never_calibrated_will_be_known(done, verb):
    effects = [off(None, 0.1), off(None, 0.3, instance=1)]
    for said, known_to in (
        (headline_of(effects, done=done), "0.3 deg/s"),
        (text_of(effects[0], done=done), "0.1 deg/s"),
    ):
        assert f" {verb} " in said
        assert amounts(said) == [known_to]


def test_one_that_is_known_goes_before_those_that_are_not():
    assert amounts(headline_of([off(None, 9.0), off(1.0, instance=1)])) == ["1 deg/s", "0.1 deg/s"]


def test_nothing_left_is_no_division_by_zero():
    assert amounts(headline_of([off(1.0, 0.0)])) == ["1 deg/s", "0 deg/s"]


@pytest.mark.parametrize(
    ("value", "said"), [(0.01234, "0.012 uT"), (99.4, "99 uT"), (100.0, "100 uT"), (1234.5, "1234 uT"), (0.0, "0 uT")]
)
def test_an_amount_has_two_digits_and_no_exponent(value, said):
    assert amount(value, "uT") == said
