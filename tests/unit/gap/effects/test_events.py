"""Steps."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from calib.gap.effects import by_id
from calib.recording import Sensor

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
