from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from mavcal.calib.recording import Channel, Sensor, Stage
from mavcal.calib.thermal.thermometer import Thermometer

RATE = 0.5  # degC/s
TICK = 0.25


def rest_then_warm(t: np.ndarray) -> np.ndarray:
    return 22.0 + RATE * np.maximum(t - 30.3, 0.0)


def warming(t: np.ndarray) -> np.ndarray:
    return 75.0 - 53.0 * np.exp(-t / 100.0)


def repeated(
    curve: Callable[[np.ndarray], np.ndarray], t: np.ndarray, *, period: float = 1.0, bin_width: float = 0.01
) -> Channel:
    """A thermometer that is read once a `period` and sent at every time of `t`."""
    read = np.floor(curve(np.floor(t / period + 1e-9) * period) / bin_width) * bin_width
    return Channel(Sensor.TEMPERATURE, 0, t, read, "degC", Stage.RAW, "S")


def told(channel: Channel, **options: int) -> Thermometer:
    thermometer = Thermometer(**options)
    edges = np.arange(channel.t[0], channel.t[-1] + TICK, TICK)
    for start in edges:
        thermometer.add(channel.between(start, start + TICK))
    return thermometer


@pytest.mark.parametrize("begins", [0.0, 2.7, 12.41, 60.0])
def test_a_temperature_that_stands_and_then_moves_is_known_throughout(begins):
    t = np.arange(0.0, 150.0, 0.02)

    def curve(time):
        return 22.0 + RATE * np.maximum(time - begins, 0.0)

    error = told(repeated(curve, t)).at(t) - curve(t)
    read = t < t[-1] - 1.0  # what comes after the last reading is not known
    assert np.abs(error[read]).max() < RATE + 0.02  # the second in which it began to move
    assert np.sqrt(np.mean(error[read] ** 2)) < 0.05


def test_a_rest_in_the_middle_is_a_rest():
    def curve(time):
        return 22.0 + RATE * (np.minimum(time, 20.0) + np.maximum(time - 60.5, 0.0))

    t = np.arange(0.0, 100.0, 0.02)
    error = told(repeated(curve, t)).at(t) - curve(t)
    assert np.abs(error[(t > 22.0) & (t < 59.0)]).max() < 0.02


def test_the_first_value_may_be_old():
    t = np.arange(7.9, 60.0, 0.02)
    error = told(repeated(warming, t)).at(t) - warming(t)
    assert np.abs(error[t < 58.0]).max() < 0.03  # 0.4 degC if it were read where it was first seen


def test_a_value_after_lost_messages_may_be_old():
    t = np.arange(0.0, 60.0, 0.02)
    kept = t[(t < 20.1) | (t > 21.9)]
    error = told(repeated(warming, kept)).at(kept) - warming(kept)
    assert np.abs(error[kept < 58.0]).max() < 0.03


@pytest.mark.parametrize("loss", [0.02, 0.3])
def test_messages_that_are_lost_here_and_there_cost_little(loss):
    t = np.arange(0.0, 200.0, 0.02)
    t = t[np.random.default_rng(1).random(len(t)) > loss]
    error = told(repeated(warming, t)).at(t) - warming(t)
    assert np.abs(error[t < 198.0]).max() < 0.1
    assert np.sqrt(np.mean(error[t < 198.0] ** 2)) < 0.02


@pytest.mark.parametrize("period", [0.02, 0.1, 1.0, 5.0])
def test_any_period_of_reading_makes_a_curve_and_no_stairs(period):
    t = np.arange(0.0, 200.0, 0.02)
    error = told(repeated(warming, t, period=period)).at(t) - warming(t)
    assert np.abs(error[t < 194.0]).max() < 0.2  # a tick's mean at the start where it is read at every sample
    assert np.abs(error[(t > 5.0) & (t < 194.0)]).max() < 0.03


def test_wide_bins_are_joined_by_straight_lines_from_edge_to_edge():
    t = np.arange(0.0, 400.0, 0.02)
    error = told(repeated(warming, t, period=0.02, bin_width=0.5)).at(t) - warming(t)
    inside = (t > 20.0) & (t < 380.0)
    assert np.abs(error[inside]).max() < 0.25
    assert abs(error[inside].mean()) < 0.05  # the lower edges of the bins are 0.25 too low


def test_messages_that_each_carry_a_reading_are_taken_as_they_are():
    t = np.arange(0.0, 100.0, 1.0)
    thermometer = told(repeated(rest_then_warm, t))
    fine = np.arange(0.0, 99.0, 0.1)
    assert np.abs(thermometer.at(fine) - np.interp(fine, t, rest_then_warm(t))).max() < 0.02


def test_hours_of_readings_are_joined_and_the_rest_before_them_stays():
    t = np.arange(0.0, 400.0, 0.05)

    def curve(time):
        return 22.0 + 0.05 * np.maximum(time - 100.5, 0.0)

    thermometer = told(repeated(curve, t), limit=32)
    assert len(thermometer) <= 64
    error = thermometer.at(t) - curve(t)
    assert np.abs(error[t < 90.0]).max() < 0.02
    assert np.abs(error[t < 380.0]).max() < 0.5


def test_the_limits_are_those_of_the_values():
    thermometer = told(repeated(warming, np.arange(0.0, 10.0, 0.02)))
    assert thermometer.limits == pytest.approx((22.0, np.floor(warming(np.array([9.0]))[0] * 100) / 100))
