from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.recording import Rounding
from mavcal.calib.simulate import SensorErrors

TRUTH = np.array([[1.0, -2.0, 3.0], [0.5, 0.0, -0.25]])
WRONG = SensorErrors(
    bias=np.array([0.1, -0.2, 0.3]),
    matrix=np.array([[1.02, 0.01, -0.02], [0.0, 0.97, 0.03], [0.005, 0.0, 1.1]]),
    t_ref=25.0,
    temperature=np.array([[0.01, 1e-4], [-0.02, 0.0], [0.0, 2e-4]]),
)


def generator():
    return np.random.default_rng(7)


def test_an_ideal_sensor_reads_the_truth():
    np.testing.assert_array_equal(SensorErrors().read(TRUTH, 10.0, generator()).values, TRUTH)


def test_the_correction_undoes_bias_matrix_and_drift():
    temperature = np.array([40.0, -10.0])
    reading = WRONG.read(TRUTH, 10.0, generator(), temperature=temperature).values
    assert reading[0, 0] == pytest.approx(1.02 - 0.02 - 0.06 + 0.1 + 0.15 + 0.0225)
    np.testing.assert_allclose(WRONG.correction.apply(reading, temperature), TRUTH, atol=1e-12)


def test_scale_with_temperature_multiplies_everything_before_it():
    errors = dataclasses.replace(WRONG, temperature_scale=np.array([1e-3, 0.0, -2e-3]))
    grown = errors.systematic(TRUTH, np.array([35.0, 15.0]))
    plain = WRONG.systematic(TRUTH, np.array([35.0, 15.0]))
    np.testing.assert_allclose(grown / plain, [[1.01, 1.0, 0.98], [0.99, 1.0, 1.02]])
    noisy = SensorErrors(noise_density=1.0, temperature_scale=0.05)
    hot, cold = (noisy.read(TRUTH, 4.0, generator(), temperature=np.full(2, t)).values for t in (45.0, 25.0))
    np.testing.assert_allclose(hot, 2.0 * cold)


def test_g_sensitivity_adds_what_the_force_makes():
    G = np.arange(9.0).reshape(3, 3) * 1e-3
    force = np.array([[0.0, 0.0, -9.8], [9.8, 0.0, 0.0]])
    reading = SensorErrors(g_sensitivity=G).systematic(TRUTH, force=force) - TRUTH
    np.testing.assert_allclose(reading, [-9.8 * G[:, 2], 9.8 * G[:, 0]])


def test_the_range_comes_before_the_resolution():
    sensor = SensorErrors(full_scale=2.3, resolution=0.5)
    np.testing.assert_allclose(
        sensor.discrete(np.array([[2.4, -9.0, 1.25], [-1.25, 0.2, 1.24]])).values, [[2.5, -2.5, 1.5], [-1.5, 0.0, 1.0]]
    )


def test_truncation_leaves_middles_of_bins_and_a_double_zero_bin():
    sensor = SensorErrors(resolution=0.1, rounding=Rounding.TOWARD_ZERO)
    reading = sensor.discrete(np.array([[0.26, -0.26, 0.09]]))
    np.testing.assert_allclose(reading.values, [[0.25, -0.25, 0.0]])
    np.testing.assert_array_equal(reading.zero_bin, [[False, False, True]])


@given(st.integers(0, 1000), st.integers(1, 300))
def test_the_same_seed_makes_the_same_noise(seed, count):
    sensor = SensorErrors(noise_density=0.1, bias_instability=0.2, random_walk=0.3)
    first, again = (sensor.random(count, 10.0, np.random.default_rng(seed)) for _ in range(2))
    np.testing.assert_array_equal(first, again)
    assert first.shape == (count, 3)


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({"bias": [0.0, np.nan, 0.0]}, "bias of a sensor is finite"),
        ({"bias": [1.0, 2.0]}, "shape"),
        ({"matrix": np.ones((3, 3))}, "plane"),
        ({"matrix": "x"}, "shape"),
        ({"noise_density": -1.0}, "noise_density"),
        ({"resolution": -1.0}, "resolution"),
        ({"full_scale": 0.0}, "range"),
        ({"t_ref": np.inf}, "finite"),
        ({"temperature": [[1.0, 2.0]] * 2}, "temperature"),
        ({"instability_poles": [0.0, 1.0]}, "poles"),
    ],
)
def test_impossible_sensors_are_refused(fields, said):
    with pytest.raises(InvalidInputError, match=said):
        SensorErrors(**fields)
