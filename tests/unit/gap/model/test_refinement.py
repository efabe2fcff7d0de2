"""The joint maximum over everything in the mean."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mavcal.calib.gap.diagnose import _setup_of
from mavcal.calib.gap.effects import catalogue
from mavcal.calib.gap.model.hypotheses import columns_of
from mavcal.calib.gap.model.joint import Term, with_residual
from mavcal.calib.gap.model.refinement import misfit, refined
from mavcal.calib.recording import Sensor
from tests.unit.gap.synthetic import SIGMA, problem_of

WARM = "gyro_temp_poly"
HUM = 12.0
"""Hz."""


def warming(trace):
    """A gyroscope that follows its temperature along a curve."""
    u = (trace.temperature - 30.0) / 10.0
    return np.outer(3.0 * u + 4.0 * u**2 - 5.0 * u**3, SIGMA[Sensor.GYRO] * np.array([1.0, -0.5, 0.2]))


@pytest.mark.parametrize("theta", [-5.0, 20.0, 30.0, 45.0, 70.0])
@pytest.mark.parametrize("factor", [-30.0, 5.0, 300.0])
def test_amplitudes_are_fitted_however_far_they_and_their_shape_are(theta, factor):
    """What another effect leaned on may be far off when that one leaves: no tangent of the shape helps there."""
    problem = problem_of(np.random.default_rng(5), (Sensor.GYRO,), warming)
    task = _setup_of(problem, tuple(e for e in catalogue() if e.id == WARM))
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


def humming_late(trace):
    """A gyroscope that reads .03 s late, with two tones whose frequencies lie two parts of the recording apart."""
    late = np.array([np.interp(trace.t - 0.03, trace.t, axis) for axis in trace.ideal.T]).T - trace.ideal
    apart = 1.0 / (trace.t[-1] - trace.t[0])
    hum = np.sin(2.0 * np.pi * (HUM - apart) * trace.t) + np.sin(2.0 * np.pi * (HUM + 1.3 * apart) * trace.t)
    return late + np.outer(hum, np.full(3, 30.0 * SIGMA[Sensor.GYRO]))


def test_a_frequency_between_two_peaks_does_not_hold_the_other_shapes():
    """Its tangent leads nowhere; every step of a joint fit was spoiled by it, and no shape moved any more."""
    problem = problem_of(np.random.default_rng(7), (Sensor.GYRO,), humming_late)
    task = _setup_of(problem, tuple(e for e in catalogue() if e.id in ("gyro_tone", "gyro_delay")))
    by_name = {h.effect.id: h for h in task.contest.hypotheses}
    tone = Term(by_name["gyro_tone"], np.full(6, 1e-3), HUM)
    delay = Term(by_name["gyro_delay"], np.ones(1), 0.029)
    begun = with_residual(dataclasses.replace(task.bare, terms=(tone, delay)))
    found, _ = refined(begun)
    assert found.terms[1].theta == pytest.approx(0.03, abs=1e-4)
