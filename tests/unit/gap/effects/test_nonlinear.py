"""An accelerometer whose readings bend."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mavcal.calib.gap.effects import by_id
from mavcal.calib.recording import Sensor

from .conftest import make
from .recovery import amplitudes, noisy

EFFECT = by_id()["accel_nonlinearity"]


def launched(factor: float):
    """A tumble whose forces are `factor` times those of gravity."""
    trace = make(Sensor.ACCEL)
    return dataclasses.replace(trace, measured=factor * trace.measured, ideal=factor * trace.ideal)


def test_a_reading_that_bends_is_recovered_axis_by_axis():
    trace = launched(4.0)
    bend = np.array([2e-4, -3e-4, 5e-5])
    beta, sd, _ = amplitudes(EFFECT, noisy(trace, bend * trace.ideal**2, 0.02, 3), np.nan)
    assert (np.abs(beta - bend) < 4.0 * 0.02 * sd).all()
    assert (0.02 * sd < 2e-6).all()


@pytest.mark.parametrize("factor", [1.0, 2.4])
def test_forces_near_gravity_do_not_excite_it(factor):
    reason, need = EFFECT.missing(launched(factor))
    assert "the specific force reaches" in reason
    assert "25 m/s2" in need


def test_forces_far_beyond_gravity_do():
    assert EFFECT.missing(launched(4.0)) is None


def test_nothing_observed_is_nothing_excited():
    trace = launched(4.0)
    assert EFFECT.missing(dataclasses.replace(trace, observed=np.zeros_like(trace.observed))) is not None
