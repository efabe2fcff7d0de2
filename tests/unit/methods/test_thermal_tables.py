"""Tables of one device are pooled, and what holding one out says of slope, polynomial and clamping."""

from __future__ import annotations

import numpy as np
import pytest

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.methods import METHODS
from mavcal.calib.methods.thermal import outside_of
from mavcal.calib.recording import Channel, Identity, Recording, Sensor, Stage

SLOPE = np.array([0.004, -0.021, 0.024])  # m/s2 per degC


def table(seed, low, high, offset, *, bend=0.0, walk=0.0):
    rng = np.random.default_rng(seed)
    n = 4000
    t = np.arange(float(n))
    warmth = low + (high - low) * 0.5 * (1.0 - np.cos(2.0 * np.pi * t / n))
    d = (warmth - 20.0)[:, None]
    values = offset + d * SLOPE + bend * d**3 + 0.02 * rng.normal(size=(n, 3))
    values = values + walk * np.cumsum(rng.normal(size=(n, 3)), axis=0) / np.sqrt(n)
    accel = Channel(Sensor.ACCEL, 0, t, values, "m/s2", Stage.RAW, "table")
    return Recording((accel, Channel(Sensor.TEMPERATURE, 0, t, warmth[:, None], "degC", Stage.RAW, "table")))


def test_tables_of_one_device_are_one_curve_with_an_offset_each():
    tables = [table(1, 5.0, 17.0, np.array([0.1, 0.2, -9.8])), table(2, 6.0, 22.0, np.array([-9.7, 0.1, 0.3]))]
    (fit,) = METHODS["thermal-poly"].run_pooled(tables, {"tref": 12.0})
    assert fit.n_samples == 8000
    assert fit.model.polynomial.t_max == pytest.approx(22.0, abs=0.1)
    at = fit.model.polynomial(np.array([8.0, 20.0]))
    assert np.allclose((at[1] - at[0]) / 12.0, SLOPE, atol=0.002)
    assert any("2 tables, each with an offset of its own" in text for text in fit.warnings)


def test_a_slope_is_taken_where_it_predicts_better_outside_the_range():
    tables = [
        table(3, 5.0, 15.0, np.array([0.1, 0.2, -9.8]), walk=0.05),
        table(4, 6.0, 30.0, np.array([-9.7, 0.1, 0.3]), walk=0.05),
    ]
    (fit,) = METHODS["thermal-poly"].run_pooled(tables, {"tref": 12.0})
    held = fit.quality["held_out"]
    assert held["degree"] == 1
    assert held["slope"] < 0.5 * held["polynomial"]
    assert fit.model.polynomial.coefficients.shape == (3, 1)
    assert held["clamped"] > held["slope"]
    assert any("a slope is fitted. Firmwares clamp instead, which leaves" in text for text in fit.warnings)


def test_a_bent_drift_keeps_its_polynomial():
    tables = [table(5, 0.0, 30.0, np.zeros(3), bend=1e-4), table(6, 2.0, 36.0, np.ones(3), bend=1e-4)]
    (fit,) = METHODS["thermal-poly"].run_pooled(tables, {"tref": 20.0})
    assert fit.quality["held_out"]["degree"] == 3
    assert fit.model.polynomial.coefficients[:, 2] == pytest.approx(1e-4, rel=0.1)


def test_tables_of_the_same_range_have_nothing_to_hold_out():
    pair = []
    for seed in (7, 8):
        recording = table(seed, 5.0, 25.0, np.zeros(3))
        pair.append((recording.channel(Sensor.ACCEL), recording.channel(Sensor.TEMPERATURE).values[:, 0]))
    assert outside_of(pair, 3) is None


def test_logs_and_tables_do_not_pool():
    one = table(9, 5.0, 25.0, np.zeros(3))
    log = Recording(one.channels, identity=Identity(autopilot="ardupilot"))
    with pytest.raises(InvalidInputError, match="logs and tables do not pool"):
        METHODS["thermal-poly"].run_pooled([one, log])


def test_slopes_of_tables_are_pooled_too():
    tables = [table(1, 5.0, 17.0, np.zeros(3)), table(2, 6.0, 22.0, np.ones(3))]
    (fit,) = METHODS["thermal-linear"].run_pooled(tables)
    assert fit.method == "thermal-linear"
    assert fit.model.polynomial.coefficients[:, 0] == pytest.approx(SLOPE, abs=0.001)
