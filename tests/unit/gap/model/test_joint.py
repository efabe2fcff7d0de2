"""The joint fit of everything on the mean."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mavcal.calib.gap.diagnose import _task_of
from mavcal.calib.gap.effects import catalogue
from mavcal.calib.gap.model.hypotheses import columns_of
from mavcal.calib.gap.model.joint import Term, jacobian, misfit, refined, setting_of, with_residual
from mavcal.calib.recording import Sensor
from tests.unit.gap.synthetic import SIGMA, problem_of

WARM = "gyro_temp_poly"


def warming(trace):
    """A gyroscope that follows its temperature along a curve."""
    u = (trace.temperature - 30.0) / 10.0
    return np.outer(3.0 * u + 4.0 * u**2 - 5.0 * u**3, SIGMA[Sensor.GYRO] * np.array([1.0, -0.5, 0.2]))


@pytest.mark.parametrize("theta", [-5.0, 20.0, 30.0, 45.0, 70.0])
@pytest.mark.parametrize("factor", [-30.0, 5.0, 300.0])
def test_amplitudes_are_fitted_however_far_they_and_their_shape_are(theta, factor):
    """What another effect leaned on may be far off when that one leaves: no tangent of the shape helps there."""
    problem = problem_of(np.random.default_rng(5), (Sensor.GYRO,), warming)
    task = _task_of(problem, tuple(e for e in catalogue() if e.id == WARM))
    hypothesis = task.contest.hypotheses[0]
    setting = task.bare.setting
    columns = columns_of(hypothesis, theta, setting.views, setting.frames)
    worth = 0.0
    far = np.zeros(columns.p)
    for axis, part in columns.parts.items():  # the second route: least squares axis by axis at that very shape
        root = np.sqrt(task.bare.weight[axis])
        found = np.linalg.lstsq((part.X * root).T, task.bare.y[axis] * root, rcond=None)[0]
        worth += float((task.bare.y[axis] * root) @ (part.X * root).T @ found)
        far[part.index] = factor * found
    begun = with_residual(dataclasses.replace(task.bare, terms=(Term(hypothesis, far, theta),)))
    assert misfit(refined(begun)[0]) < misfit(task.bare) - 0.99 * worth


@pytest.mark.parametrize("effect", ["accel_bias", "accel_temp_linear", "accel_scale", "accel_delay"])
def test_a_block_without_samples_of_a_sensor_knows_nothing_of_its_effects(effect):
    """A magnetometer may fall silent for an eighth of a flight, and that eighth is held out in its turn."""
    problem = problem_of(np.random.default_rng(6), (Sensor.ACCEL, Sensor.GYRO))
    task = _task_of(problem, tuple(e for e in catalogue() if e.id == effect))
    hypothesis, setting = task.contest.hypotheses[0], task.bare.setting
    theta = np.nan if hypothesis.effect.shape is None else 20.0
    own = columns_of(hypothesis, theta, setting.views, setting.frames)
    term = Term(hypothesis, np.ones(own.p), theta)
    silent = setting_of(tuple(view for view in setting.views if view.sensor is Sensor.GYRO))
    whole, nothing = jacobian(term, setting), jacobian(term, silent)
    assert nothing.p == whole.p == len(term.values)
    assert not nothing.parts
