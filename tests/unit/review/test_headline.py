from __future__ import annotations

import re

import pytest

from mavcal.calib.recording import Sensor
from mavcal.calib.review.effect import SensorEffect
from mavcal.calib.review.headline import amount, headline_of, text_of


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
