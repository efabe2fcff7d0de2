"""Steps."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mavcal.calib.gap.effects import by_id
from mavcal.calib.gap.effects.events import RAMP_S, likeliest_ramps, likeliest_steps, step_moments
from mavcal.calib.recording import Sensor

from .conftest import make
from .recovery import fitted, noisy


@pytest.mark.parametrize("moment", [4.0, 35.21, 66.0])
def test_a_step_is_found_where_it_is(moment):
    trace = make(Sensor.MAG)
    step = np.array([0.6, -0.2, 0.4])
    change = np.outer(trace.t >= moment, step)
    found, beta, sd = fitted(by_id()["mag_step"], noisy(trace, change, 0.2, 6))
    assert found == pytest.approx(moment, abs=0.15)
    assert (np.abs(beta - step) < 4.5 * 0.2 * sd).all()


def test_two_steps_are_both_among_the_candidates_whatever_drifts():
    trace = make(Sensor.ACCEL)
    change = np.outer((trace.t > 20.0) & (trace.t < 50.0), [0.5, 0.0, 0.0]) + 0.001 * trace.t[:, None]
    found = by_id()["accel_step"].shape.screen(trace, noisy(trace, change, 0.02, 7).residual)
    assert np.abs(found - 20.0).min() < 0.1
    assert np.abs(found - 50.0).min() < 0.1


def test_rows_that_were_not_observed_move_no_step():
    trace = make(Sensor.MAG)
    noise = noisy(trace, np.outer(trace.t >= 30.0, [1.0, 0.0, 0.0]), 0.1, 8)
    spoilt = noise.measured.copy()
    spoilt[1000:1500] = 400.0
    holed = dataclasses.replace(noise, measured=spoilt, observed=(trace.t < 10.0) | (trace.t >= 15.0))
    assert np.abs(by_id()["mag_step"].shape.screen(holed, holed.residual) - 30.0).min() < 0.1


def stepped(hole):
    """A level that changes at 30 s, the samples within `hole` seconds about it missing: these are zero."""
    trace = make(Sensor.MAG)
    seen = np.abs(trace.t - 30.0) > 0.5 * hole
    noise = np.random.default_rng(1).normal(0.0, 0.3, trace.ideal.shape)
    residual = np.where(seen[:, None], noise + np.outer(trace.t > 30.0, [0.0, 0.0, 5.0]), 0.0)
    return dataclasses.replace(trace, observed=seen), residual


def test_a_ramp_that_was_recorded_is_tried_where_the_level_changes():
    found = likeliest_ramps(*stepped(0.0))
    assert np.abs(found - 30.0).min() < 0.1


def test_beside_a_hole_a_jump_is_tried_and_no_ramp():
    trace, residual = stepped(2.0 * RAMP_S)
    assert np.abs(likeliest_steps(trace, residual) - 30.0).min() < RAMP_S + 0.1
    ramps = likeliest_ramps(trace, residual)
    assert len(ramps)
    assert not (np.abs(ramps - 30.0) < 1.4 * RAMP_S).any()


def test_with_no_ramp_at_all_the_first_moment_is_left():
    trace, residual = stepped(0.0)
    gaps = dataclasses.replace(trace, observed=np.arange(len(trace.t)) % 4 == 0)
    np.testing.assert_array_equal(likeliest_ramps(gaps, residual), step_moments(gaps)[:1])
