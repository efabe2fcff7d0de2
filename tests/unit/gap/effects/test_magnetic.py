"""Magnetometers: against the field equation written out a second time."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from mavcal.calib.gap.effects import by_id, forward_models
from mavcal.calib.recording import Sensor
from tests.examples import examples

from .conftest import EARTH, make
from .recovery import amplitudes, noisy


def _body_from_ned(trace):
    w, x, y, z = trace.attitude.T
    return Rotation.from_quat(np.stack([x, y, z, w], axis=1)).inv()


def _recovered(effect_id, change, truth, seed=5, sigma=0.2):
    trace = make(Sensor.MAG)
    beta, sd, _ = amplitudes(by_id()[effect_id], noisy(trace, change(trace), sigma, seed), np.nan)
    assert (np.abs(beta - truth) < 4.0 * sigma * sd).all()
    assert (sigma * sd < 0.2 * np.abs(truth).max()).all()


def test_soft_iron():
    xx, yy, zz, xy, xz, yz = truth = np.array([0.05, -0.03, 0.02, 0.04, -0.06, 0.01])
    S = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    _recovered("mag_soft_iron", lambda trace: trace.field @ S, truth)


def test_motor_current():
    truth = np.array([0.3, -0.2, 0.4])
    _recovered("mag_motor_current", lambda trace: np.outer(trace.current, truth), truth)


def test_earth_field():
    truth = np.array([2.0, -1.0, 1.5])
    _recovered("mag_earth_field", lambda trace: _body_from_ned(trace).apply(EARTH + truth) - trace.field, truth)


def test_field_gradient():
    nn, ee, ne, nd, ed = truth = np.array([0.5, -0.3, 0.2, 0.4, -0.6])
    G = np.array([[nn, ne, nd], [ne, ee, ed], [nd, ed, -nn - ee]])

    def change(trace):
        return _body_from_ned(trace).apply((trace.place - trace.place.mean(axis=0)) @ G)

    _recovered("mag_field_gradient", change, truth)


@settings(max_examples=examples(15), deadline=None)
@given(st.lists(st.floats(-1.5, 1.5), min_size=3, max_size=3))
def test_a_turned_sensor_sees_the_same_place_turned(rotvec):
    turn = Rotation.from_rotvec(rotvec)
    here, there = make(Sensor.MAG, seconds=5.0), make(Sensor.MAG, seconds=5.0, turn=turn)
    for effect_id in ("mag_earth_field", "mag_field_gradient"):
        columns = by_id()[effect_id].columns
        np.testing.assert_allclose(columns(there, np.nan), columns(here, np.nan) @ turn.as_matrix().T, atol=1e-9)


@pytest.mark.parametrize(
    ("effect_id", "without", "says"),
    [
        ("mag_motor_current", {"current": None}, "no current"),
        ("mag_motor_current", {"current": np.full(7000, 3.0)}, "varies by 0 A"),
        ("mag_earth_field", {"attitude": None}, "attitude"),
        ("mag_field_gradient", {"place": None}, "position unknown"),
        ("mag_field_gradient", {"place": np.ones((7000, 3))}, "varies by 0 m"),
    ],
)
def test_what_is_not_recorded_or_does_not_vary_is_named(effect_id, without, says):
    effect, trace = by_id()[effect_id], make(Sensor.MAG)
    assert effect.missing(trace) is None
    lack = effect.missing(dataclasses.replace(trace, **without))
    assert lack is not None
    assert says in lack[0]


@pytest.mark.parametrize("lag", [0.0, 0.05, -0.1])
def test_a_current_may_be_late(lag):
    trace = make(Sensor.MAG)
    steady = dataclasses.replace(trace, current=12.0 + 5.0 * np.sin(1.5 * trace.t) + 2.0 * np.sin(4.0 * trace.t))
    late = 12.0 + 5.0 * np.sin(1.5 * (trace.t - lag)) + 2.0 * np.sin(4.0 * (trace.t - lag))
    effect = next(e for e in forward_models()["mag_motor_current"] if e.form == "~late")
    np.testing.assert_allclose(effect.signals(steady, lag)[0, 20:-20], late[20:-20], atol=2e-2)
    grid = effect.shape.grid(steady)
    assert grid[0] <= lag <= grid[-1]


def test_the_throttle_drives_the_field_where_no_current_was_recorded():
    effect = next(e for e in forward_models()["mag_motor_current"] if e.form == "~throttle")
    trace = dataclasses.replace(make(Sensor.MAG), current=None)
    assert effect.missing(trace) is None
    assert by_id()["mag_motor_current"].missing(trace) is not None
    truth = np.array([6.0, -4.0, 8.0])
    beta, sd, _ = amplitudes(effect, noisy(trace, np.outer(trace.throttle**1.5, truth), 0.2, 5), 1.5)
    assert (np.abs(beta - truth) < 4.0 * 0.2 * sd).all()
    steady = dataclasses.replace(trace, throttle=np.full(len(trace.t), 0.5))
    assert effect.missing(steady) is not None
    assert effect.missing(dataclasses.replace(trace, throttle=None)) is not None
