"""Columns of the joint fit of everything on the mean."""

from __future__ import annotations

import numpy as np
import pytest

from mavcal.calib.gap.diagnose import _setup_of
from mavcal.calib.gap.effects import catalogue
from mavcal.calib.gap.model.hypotheses import columns_of
from mavcal.calib.gap.model.joint import Term, jacobian, setting_of
from mavcal.calib.recording import Sensor
from tests.unit.gap.synthetic import problem_of


@pytest.mark.parametrize("effect", ["accel_bias", "accel_temp_linear", "accel_scale", "accel_delay"])
def test_a_block_without_samples_of_a_sensor_knows_nothing_of_its_effects(effect):
    """A magnetometer may fall silent for an eighth of a flight, and that eighth is held out in its turn."""
    problem = problem_of(np.random.default_rng(6), (Sensor.ACCEL, Sensor.GYRO))
    task = _setup_of(problem, tuple(e for e in catalogue() if e.id == effect))
    hypothesis, setting = task.contest.hypotheses[0], task.bare.setting
    theta = np.nan if hypothesis.effect.shape is None else 20.0
    own = columns_of(hypothesis, theta, setting.views, setting.frames)
    term = Term(hypothesis, np.ones(own.p), theta)
    silent = setting_of(tuple(view for view in setting.views if view.sensor is Sensor.GYRO))
    whole, nothing = jacobian(term, setting), jacobian(term, silent)
    assert nothing.p == whole.p == len(term.values)
    assert not nothing.parts
