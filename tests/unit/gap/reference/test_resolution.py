"""Lattices of numbers: found where there is one, and declared as far as the simulator rounds too."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mavcal.calib.gap.effects import by_id
from mavcal.calib.gap.reference.resolution import levels_of, noise_of, step_of, steps_of, with_simulated_step
from mavcal.calib.recording import Channel, Sensor, Stage
from tests.unit.gap.synthetic import SIGMA, problem_of

Q = 0.02


def rounded(values, q):
    return np.round(values / q) * q


def a_trace(q, seed=1):
    (trace,) = problem_of(np.random.default_rng(seed), (Sensor.ACCEL,)).traces
    return dataclasses.replace(trace, measured=rounded(trace.measured, q) if q else trace.measured)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("q", [1e-3, 0.02, 0.5, 9.80665 / 2048.0])
def test_a_step_is_found(q, seed):
    values = rounded(np.random.default_rng(seed).normal(3.0, 2.0 * q, 2000), q)
    found = levels_of(values)
    assert found is not None
    assert found.step == pytest.approx(q, rel=1e-6)
    assert found.error < 0.01


@pytest.mark.parametrize("seed", range(20))
def test_noise_that_nobody_rounded_lies_on_no_lattice(seed):
    assert levels_of(np.random.default_rng(seed).normal(size=2000)) is None


def test_a_value_that_never_changes_has_no_step():
    assert levels_of(np.full(100, 3.0)) is None
    assert step_of(np.zeros((100, 3))) == 0.0


def test_few_levels_count_only_if_each_occurs_again():
    assert levels_of(np.array([0.0, 1.0, 2.0])) is None
    assert levels_of(np.tile([0.0, 1.0, 2.0], 4)) is not None


def test_noise_is_that_of_one_sample():
    assert noise_of(np.random.default_rng(0).normal(0.0, 0.7, 20_000)) == pytest.approx(0.7, rel=0.03)
    assert noise_of(np.full(10, 1.0)) == 0.0


def test_the_coarsest_instance_counts():
    rng, t = np.random.default_rng(3), np.arange(500) / 100.0
    channels = [
        Channel(Sensor.GYRO, i, t, rounded(rng.normal(size=(500, 3)), q), "rad/s", Stage.RAW, f"gyro{i}")
        for i, q in enumerate((0.01, 0.04))
    ]
    assert steps_of(channels) == pytest.approx({Sensor.GYRO: 0.04})


def test_a_step_that_the_simulator_shares_is_declared_and_no_gap():
    trace = a_trace(Q)
    shared = with_simulated_step(trace, Q)
    assert shared.quantum == pytest.approx(Q)
    assert by_id()["accel_quantisation"].detect(trace) is not None
    assert by_id()["accel_quantisation"].detect(shared) is None


def test_a_coarser_step_of_the_real_sensor_is_not_declared():
    coarse = with_simulated_step(a_trace(10.0 * Q), Q)
    assert coarse.quantum == pytest.approx(Q)
    found = by_id()["accel_quantisation"].detect(coarse)
    assert found is not None
    assert found.values == pytest.approx((10.0 * Q,) * 3, rel=1e-3)


def test_a_finer_step_of_the_real_sensor_is_declared_as_it_is():
    assert with_simulated_step(a_trace(Q), 10.0 * Q).quantum == pytest.approx(Q)


def test_a_sensor_that_is_not_rounded_stays_as_it_is():
    trace = a_trace(0.0)
    assert with_simulated_step(trace, Q) is trace
    assert with_simulated_step(a_trace(Q), 0.0).quantum == 0.0
    declared = dataclasses.replace(trace, quantum=SIGMA[Sensor.ACCEL])
    assert with_simulated_step(declared, Q) is declared
