from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from mavcal.calib.recording import Channel, Sensor, Stage
from mavcal.calib.thermal.quality import (
    attitude_quality,
    common_warnings,
    declined_warnings,
    fit_message,
    or_none,
    remedy_for,
    two_way_warnings,
)
from mavcal.calib.thermal.sweeps import ThermometerLag

ALL, NONE = np.ones(3, dtype=bool), np.zeros(3, dtype=bool)
Z = np.array([False, False, True])


def data(**more):
    fields = {"constant": NONE, "quantised": False, "ignored": 0, "unsorted": 0, "spiked": 0}
    return SimpleNamespace(**{**fields, "t_min": 10.04, "t_max": 45.0, "samples": 1000, **more})


def channel(sensor=Sensor.GYRO, unit="rad/s"):
    return Channel(sensor, 0, np.arange(2.0), np.zeros((2, 3)), unit, Stage.RAW, "IMU", quantum=0.001)


def test_a_fit_says_of_which_axes_and_over_what():
    said = fit_message("slope", data(), ~Z)
    assert all(token in said for token in ("slope", " x, y ", "10.0 to", "45.0 degC", "1000 rows"))
    assert "no axis" in fit_message("slope", data(), NONE)


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ({}, ()),
        ({"constant": Z}, ("z reads one constant value: not estimated",)),
        (
            {"constant": Z, "quantised": True},
            ("z reads one constant value: its drift is below one bin, not estimated",),
        ),
        ({"ignored": 3}, ("3 rows without finite numbers were left out",)),
        ({"unsorted": 2}, ("the time ran backwards 2 times: the rows were sorted by it",)),
        ({"spiked": 1}, ("1 rows lie far from all others (spikes) and were left out",)),
    ],
)
def test_what_does_not_count_is_said(more, said):
    assert common_warnings(data(**more), ~Z) == said


def test_an_axis_that_was_estimated_is_not_called_constant():
    assert common_warnings(data(constant=Z), ALL) == ()


def test_axes_that_are_declined_and_those_that_are_too_coarse_are_told_apart():
    wander, coarse = declined_warnings(~Z, Z, channel())
    assert wander.startswith("x, y wanders as much by itself")
    assert coarse == "z shows too few levels of 0.001 rad/s: its drift cannot be resolved"
    assert declined_warnings(NONE, NONE, channel()) == ()


@pytest.mark.parametrize(("seconds", "who"), [(20.0, "sensor lags"), (-20.0, "thermometer lags")])
def test_who_lags_whom_is_said(seconds, who):
    [said] = two_way_warnings(ThermometerLag(seconds, 2.0), None, None, ALL)
    assert who in said
    assert "20 +-" in said
    assert "2 s;" in said


CURVE = SimpleNamespace(drift=np.array([1.0, 1.0, 1.0]), drift_sd=np.array([1e-4, 5e-4, 2e-3]))


@pytest.mark.parametrize(
    ("difference", "sd", "named"),
    [
        ((0.5, 0.5, 0.5), 0.01, "x by 0.5, y by 0.5"),  # z is not estimated
        ((0.05, -0.5, 0.0), 0.01, "y by 0.5"),  # a twentieth of the drift is none
        ((0.5, 0.0, 0.0), 0.2, None),  # not beyond its own uncertainty
    ],
)
def test_what_warming_and_cooling_differ_by_is_said_where_it_matters(difference, sd, named):
    said = two_way_warnings(None, (np.array(difference), np.full(3, sd)), CURVE, ~Z)
    assert [named in text for text in said] == ([True] if named else [])


@pytest.mark.parametrize(
    ("constant", "coarse", "declined", "said"),
    [
        (Z, NONE, NONE, "finer resolution"),
        (NONE, Z, NONE, "finer resolution"),
        (NONE, NONE, Z, "up and down once more"),
        (NONE, NONE, NONE, "accel-thermal or accel-multi"),
        (~Z, ~Z, ~Z, "accel-thermal or accel-multi"),  # of the other axes
    ],
)
def test_what_would_determine_a_parameter_depends_on_why_it_is_open(constant, coarse, declined, said):
    assert said in remedy_for("poly1_z", data(constant=constant), coarse, declined)


def test_the_worst_axis_counts_for_the_attitude_if_it_is_estimated():
    gyro = attitude_quality(channel(), CURVE, ~Z)
    assert gyro == {"attitude_sd_deg_per_min": pytest.approx(np.degrees(60.0 * 5e-4))}
    accel = attitude_quality(channel(Sensor.ACCEL, "m/s2"), CURVE, ALL)
    assert accel == {"attitude_sd_deg": pytest.approx(np.degrees(2e-3 / 9.80665))}
    assert attitude_quality(channel(Sensor.MAG, "uT"), CURVE, ALL) == {}
    assert attitude_quality(channel(Sensor.GYRO, "counts"), CURVE, ALL) == {}


def test_what_is_not_known_is_none():
    assert or_none(np.array([1.0, 2.0, 3.0]), ~Z) == [1.0, 2.0, None]
