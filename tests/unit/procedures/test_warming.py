"""How far the units warmed up, how fast they still do, and when that ends."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mavcal.calib.procedures.thermal import Warmth
from mavcal.calib.recording import Channel, Sensor, Stage

MINUTE = 60.0


def frame(t, *temperatures):
    """One reading of every unit; None: it gave none."""
    return {
        (Sensor.TEMPERATURE, unit): Channel(
            Sensor.TEMPERATURE, unit, np.array([t]), np.array([[float(value)]]), "degC", Stage.RAW, "S"
        )
        for unit, value in enumerate(temperatures)
        if value is not None
    }


def followed(curve, seconds, *, units=(0,), over=MINUTE, step=1.0):
    warmth = Warmth(over)
    for t in np.arange(0.0, seconds + 1e-9, step):
        warmth.update(frame(t, *(curve(t) for _ in units)), units)
    return warmth


def approaching(t, start=20.0, end=50.0, tau=200.0):
    return end - (end - start) * math.exp(-t / tau)


def test_the_range_is_that_of_the_unit_that_moved_least():
    warmth = Warmth(MINUTE)
    for t, (one, other) in enumerate([(20.0, 30.0), (28.0, 33.0), (24.0, 31.0)]):
        warmth.update(frame(t, one, other), (0, 1))
    assert warmth.moved == 3.0
    assert warmth.now == {0: 24.0, 1: 31.0}


def test_only_what_was_kept_counts_for_the_span():
    warmth = Warmth(MINUTE)
    for t, value in enumerate([20.0, 25.0, 40.0]):
        warmth.update(frame(t, value), (0,))
        if value < 30.0:
            warmth.keep(frame(t, value))
    assert (warmth.moved, warmth.span) == (20.0, 5.0)


def test_a_unit_that_falls_out_counts_no_more():
    warmth = Warmth(MINUTE)
    warmth.update(frame(0.0, 20.0, 30.0), (0, 1))
    warmth.update(frame(1.0, 29.0, 31.0), (0, 1))
    assert warmth.moved == 1.0
    warmth.update(frame(2.0, 29.0), (0,))
    assert warmth.moved == 9.0
    assert warmth.now == {0: 29.0}


def test_nothing_moved_before_anything_was_read():
    warmth = Warmth(MINUTE)
    assert (warmth.moved, warmth.span, warmth.rate) == (0.0, 0.0, 0.0)
    assert warmth.settles(1.0) is None
    assert not warmth.is_steady(100.0)


def test_the_rate_is_that_of_the_last_minute():
    warmth = followed(lambda t: 20.0 + (0.5 * t if t < 100.0 else 50.0 + 0.1 * (t - 100.0)), 200.0)
    assert warmth.rate == pytest.approx(0.1)
    assert followed(lambda t: 60.0 - 0.2 * t, 30.0).rate == pytest.approx(-0.2)


def test_two_readings_of_one_time_have_no_rate():
    warmth = Warmth(MINUTE)
    for value in (20.0, 21.0):
        warmth.update(frame(5.0, value), (0,))
    assert warmth.rate == 0.0


@pytest.mark.parametrize(("seconds", "is_steady"), [(59.0, False), (60.0, True)])
def test_a_whole_minute_is_needed_to_call_it_settled(seconds, is_steady):
    assert followed(lambda t: 30.0, seconds).is_steady(0.1) is is_steady


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(("per_minute", "is_steady"), [(0.19, True), (0.21, False)])
def test_a_rate_below_the_bound_is_settled_either_way(sign, per_minute, is_steady):
    assert followed(lambda t: 30.0 + sign * per_minute * t / 60.0, 90.0).is_steady(0.2) is is_steady


@pytest.mark.parametrize(("start", "end"), [(20.0, 50.0), (70.0, 30.0)])
def test_where_a_body_ends_and_when_is_told_from_how_its_rate_falls(start, end):
    tau, bound, at = 200.0, 1.0, 150.0
    warmth = followed(lambda t: approaching(t, start, end, tau), at)
    told = warmth.settles(bound)
    left, final = told.left, told.at
    assert final == pytest.approx(end, abs=0.6)
    # the mean rate over the last minute falls below the bound when the curve itself says so
    mean = abs(approaching(at, start, end, tau) - approaching(at - 60.0, start, end, tau))
    assert left == pytest.approx(tau * math.log(mean / bound), rel=0.02)


def test_a_body_that_is_below_the_bound_needs_no_time():
    left = followed(approaching, 1500.0).settles(1.0).left
    assert left == 0.0


@pytest.mark.parametrize(
    "curve",
    [
        lambda t: 20.0 + 0.1 * t,  # as fast as ever
        lambda t: 20.0 + 1e-3 * t**2,  # faster and faster
        lambda t: 20.0 + 5.0 * math.sin(math.pi * t / 60.0),  # it turned within the minute
        lambda t: 20.0,
    ],
)
def test_a_rate_that_does_not_fall_tells_no_end(curve):
    assert followed(curve, 120.0).settles(1.0) is None


@pytest.mark.parametrize(("seconds", "told"), [(29.0, False), (31.0, True)])
def test_half_a_minute_is_needed_to_tell_the_end(seconds, told):
    assert (followed(approaching, seconds).settles(1.0) is not None) is told


@pytest.mark.parametrize("knee", [0.0, 10.0, 25.0, 40.0])
def test_no_end_is_told_that_is_far_from_the_true_one(knee):
    """A vehicle that is switched on, or a curve that has hardly bent: 124 degC was said where 58 were true."""

    def curve(t):
        return 11.3 + 47.4 * (1.0 - np.exp(-np.maximum(t - knee, 0.0) / 55.0))

    for seconds in np.arange(20.0, 300.0, 10.0):
        told = followed(curve, seconds).settles(0.2)
        if told is not None:
            assert abs(told.at - 58.7) <= max(3.0 * told.spread, 2.0), (seconds, told)
