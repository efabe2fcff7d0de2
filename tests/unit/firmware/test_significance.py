"""Root mean squares over what a covariance tells, by hand.

A change is the difference of two estimates: its variance is twice that of one.
"""

from __future__ import annotations

import numpy as np
import pytest

from mavcal.calib.firmware.significance import agreed, level_agreement, within
from mavcal.calib.recording import Sensor

QUANTILES = {1: 3.841, 2: 5.991, 3: 7.815}
"""95 % of chi-squared by its degrees of freedom (any table)."""


@pytest.mark.parametrize("parts", QUANTILES)
def test_the_border_is_the_95_percent_quantile_of_the_number_of_parts(parts):
    for share, agrees in ((0.999, True), (1.001, False)):
        change = np.full(parts, np.sqrt(2.0 * share * QUANTILES[parts] / parts) * 0.5)
        found = within([(change, 0.25 * np.eye(parts))])
        assert (found is not None) == agrees
        if agrees:
            assert found == pytest.approx(np.sqrt(share * QUANTILES[parts] / parts))


@pytest.mark.long
def test_of_repeated_calibrations_one_in_twenty_is_written():
    rng = np.random.default_rng(4711)
    root = np.array([[1.0, 0.0, 0.0], [0.4, 0.8, 0.0], [-0.3, 0.2, 0.5]])
    first, again = (rng.standard_normal((20000, 3)) @ root.T for _ in range(2))
    written = sum(within([(a - b, root @ root.T)]) is None for a, b in zip(first, again, strict=True))
    assert written == pytest.approx(1000, abs=4.0 * np.sqrt(950.0))


def test_parts_of_several_kinds_are_judged_together():
    first = np.array([0.3, 0.0]), 0.09 * np.eye(2)  # 1 sd of the estimate in one of two
    second = np.array([4.0]), np.array([[4.0]])  # 2 of them
    assert within([first, second]) == pytest.approx(np.sqrt(5.0 / 2.0 / 3.0))
    assert within([first, None]) is None
    assert within([]) is None


def test_correlated_elements_are_judged_along_their_axes():
    covariance = np.array([[1.0, 0.6], [0.6, 1.0]])
    change = np.array([1.0, -1.0])
    assert within([(change, covariance)]) == pytest.approx(np.sqrt((2.0 / 0.8) / 2.0))


def test_what_is_held_fixed_may_differ_by_rounding_only():
    covariance = np.diag([1.0, 0.0])
    one = pytest.approx(0.5 / np.sqrt(2.0))  # the other is no part
    assert within([(np.array([0.5, 0.9e-6]), covariance)]) == one
    assert within([(np.array([0.5, -1.1e-6]), covariance)]) is None
    assert within([(np.zeros(2), np.zeros((2, 2)))]) is None


def test_two_elements_that_are_tied_are_one_part_and_cannot_part():
    tied = np.ones((2, 2))
    assert within([(np.array([1.5, 1.5]), tied)]) == pytest.approx(1.5 / np.sqrt(2.0))
    assert within([(np.array([1.5, 1.5 + 1e-3]), tied)]) == pytest.approx(1.5 / np.sqrt(2.0), rel=1e-3)
    assert within([(np.array([1.5, 1.5 + 1e-2]), tied)]) is None
    small = np.array([0.01, 0.011])
    assert within([(small, tied)]) == pytest.approx(0.0105 / np.sqrt(2.0))  # 7e-4 sd across: below a thousandth


def test_the_sentence_says_by_how_many_standard_deviations():
    found = agreed(Sensor.GYRO, 1, "gyro 2", [(np.array([2.0]), np.array([[2.0]]))])
    assert found is not None
    assert (found.sensor, found.instance, found.deviation) == (Sensor.GYRO, 1, pytest.approx(1.0))
    assert found.text == "gyro 2 agrees with what is in force: differs by 1.0 sd, not written"
    assert agreed(Sensor.GYRO, 1, "gyro 2", [None]) is None
    level = level_agreement(np.array([0.02, 0.0]), np.array([0.02, 0.04]))
    assert level is not None
    assert (level.sensor, level.instance, level.deviation) == (Sensor.ACCEL, 0, pytest.approx(0.5))
    assert level.text.startswith("level agrees")
