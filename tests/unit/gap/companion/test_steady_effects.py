"""An effect of a nominal flight is expected in another flight only if the nominal flight supports it."""

from __future__ import annotations

import dataclasses

import numpy as np

from mavcal.calib.gap.companion.baselines import simulated_baseline_of
from mavcal.calib.gap.companion.steady_effects import steady_effects
from mavcal.calib.gap.problem import MinimumGain, ReferenceInfo, ReferenceKind
from mavcal.calib.gap.search.thresholds import GainThresholds
from mavcal.calib.recording import Sensor
from tests.unit.gap.synthetic import problem_of

ALPHA = 0.005
LEAST = {Sensor.ACCEL: 100.0, Sensor.GYRO: 100.0}
FEW = MinimumGain(LEAST, LEAST, LEAST, LEAST, drift_entry=LEAST)


def names(problem):
    return [one.effect.id for one in steady_effects(problem, ALPHA, GainThresholds(FEW)).supported]


def misaligned(trace):
    return trace.ideal @ np.array([[0.0, 0.0, 0.0], [0.02, 0.0, 0.0], [0.0, 0.01, 0.0]])


def test_an_effect_below_the_error_of_the_reference_is_not_carried():
    rng = np.random.default_rng
    assert names(problem_of(rng(1), (Sensor.GYRO,), misaligned)) == ["gyro_misalignment"]
    loose = ReferenceInfo(ReferenceKind.ESTIMATOR, 0.5, gyro_sd=(0.05,) * 9, field_sd=(0.1,) * 3)
    assert names(problem_of(rng(1), (Sensor.GYRO,), misaligned, reference=loose)) == []


def test_an_effect_that_takes_the_readings_further_away_is_not_carried():
    """A reference with noise above what it follows: its fast part is too large, its slow part is right."""
    rng = np.random.default_rng(4)
    plain = problem_of(rng, (Sensor.ACCEL,))
    trace = plain.traces[0]
    slow = 0.5 * np.sin(2.0 * np.pi * 0.03 * trace.t)[:, None] * np.array([1.0, 0.8, 0.0]) - np.array([0.0, 0.0, 9.8])
    fast = 0.05 * rng.standard_normal(trace.ideal.shape)
    measured = slow + 0.4 * fast + 5e-4 * rng.standard_normal(trace.ideal.shape)
    blurred = dataclasses.replace(trace, ideal=slow + fast, measured=measured, sigma=None)
    found = steady_effects(dataclasses.replace(plain, traces=(blurred,)), ALPHA, GainThresholds(FEW))
    assert "accel_scale" in [one.effect.id for one in found.doubted]
    assert "accel_scale" not in [one.effect.id for one in found.supported]


def test_an_error_of_the_simulators_own_reference_raises_no_threshold():
    """It is taken off its readings, where the noise is learned, and says nothing of another flight."""
    loose = ReferenceInfo(ReferenceKind.ESTIMATOR, 0.5, gyro_sd=(0.05,) * 9, field_sd=(0.1,) * 3)
    problem = problem_of(np.random.default_rng(1), (Sensor.GYRO,), misaligned, reference=loose)
    found = simulated_baseline_of(problem, ALPHA)
    assert [effect.id for effect in found.own] == ["gyro_misalignment"]
    assert (found.effects, found.uncertain, found.gains[Sensor.GYRO]) == ((), (), 0.0)
    left = found.added_to_ideal(problem.traces)[0].residual
    assert left.std() < 0.5 * problem.traces[0].residual.std()
