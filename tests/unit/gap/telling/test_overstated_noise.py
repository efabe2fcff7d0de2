from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mavcal.calib.gap import diagnose
from mavcal.calib.recording import Sensor
from tests.unit.gap.synthetic import SIGMA, problem_of


def declared(problem, factor):
    traces = (dataclasses.replace(t, sigma=factor * t.sigma, sigma_dof=5000.0) for t in problem.traces)
    return dataclasses.replace(problem, traces=tuple(traces))


@pytest.mark.parametrize(("factor", "said"), [(1.0, False), (1.05, False), (3.0, True)])
def test_less_noise_than_declared_is_said_with_both_figures(factor, said):
    problem = problem_of(np.random.default_rng(4), (Sensor.GYRO,))
    report = diagnose(declared(problem, factor), nested=False)
    assert not report.effects
    warned = [w for w in report.warnings if "less noise" in w]
    assert bool(warned) is said
    if said:
        assert f"{3.0 * SIGMA[Sensor.GYRO]:.3g}" in warned[0]
        assert "3 times too noisy" in warned[0]


def test_noise_that_nobody_declared_is_never_too_little():
    problem = problem_of(np.random.default_rng(5), (Sensor.GYRO,))
    bare = dataclasses.replace(problem, traces=tuple(dataclasses.replace(t, sigma=None) for t in problem.traces))
    assert not diagnose(bare, nested=False).warnings


def test_noise_of_a_trajectory_is_no_sensors():
    """The simulator flew doublets, the real vehicle did not: every report said that the simulator is too noisy."""
    problem = declared(problem_of(np.random.default_rng(4), (Sensor.GYRO,)), 3.0)
    flown = dataclasses.replace(problem, reference=dataclasses.replace(problem.reference, bandwidth_hz=2.0))
    assert not [w for w in diagnose(flown, nested=False).warnings if "less noise" in w]
