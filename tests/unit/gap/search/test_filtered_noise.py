from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mavcal.calib.gap import diagnose
from mavcal.calib.gap.effects import by_id
from mavcal.calib.gap.effects.timing import low_pass_gain
from mavcal.calib.gap.model.hypotheses import Hypothesis
from mavcal.calib.gap.model.joint import Term, setting_of
from mavcal.calib.gap.model.noise_fit import model_without_effects, noise_fitted
from mavcal.calib.gap.model.views import views_of
from mavcal.calib.gap.search.contest import noise_score
from mavcal.calib.gap.search.filtered_noise import evidence_of_filters, filter_evidence
from mavcal.calib.recording import Sensor
from tests.unit.gap.synthetic import problem_of

CUTOFF = 12.0  # Hz, of 25


def through_filter(trace, values, way=0):
    """`values` through the filter of the catalogue, without its phase."""
    f = np.fft.rfftfreq(len(values), 1.0 / trace.fs)
    gain = np.sqrt(low_pass_gain(trace, 2.0 * np.pi * f / trace.fs, CUTOFF)[way])
    return np.fft.irfft(np.fft.rfft(values, axis=0) * gain[:, None], len(values), axis=0)


def made(noise, level=1.0, way=0):
    """A sensor whose noise went through the filter, or whose reading is late by as much."""
    problem = problem_of(np.random.default_rng(3), (Sensor.GYRO,))
    trace = problem.traces[0]
    left = through_filter(trace, trace.residual, way) if noise else trace.residual
    trace = dataclasses.replace(trace, measured=trace.ideal + level * left, sigma_dof=5000.0)
    return dataclasses.replace(problem, traces=(trace,))


def said(problem, effect="gyro_low_pass"):
    setting = setting_of(views_of(problem, {}, {}))
    model = model_without_effects(setting)
    return filter_evidence(Hypothesis(by_id()[effect], (0,)), CUTOFF, model)


@pytest.mark.parametrize("level", [1.0, 0.3])
def test_the_form_of_the_noise_tells_and_not_its_level(level):
    assert said(made(noise=True, level=level)) > 100.0
    assert said(made(noise=False, level=level)) < -50.0


def test_noise_that_was_filtered_before_it_was_thinned_out_tells_as_well():
    assert said(made(noise=True, way=1)) > 30.0


def test_what_does_not_filter_and_noise_that_nobody_declared_say_nothing():
    assert said(made(noise=True), "gyro_delay") == 0.0
    problem = made(noise=True)
    bare = dataclasses.replace(problem, traces=(dataclasses.replace(problem.traces[0], sigma=None),))
    assert said(bare) == 0.0


def test_noise_that_a_filter_has_shaped_has_no_cause_of_its_own():
    problem = made(noise=True)
    loose = dataclasses.replace(problem, traces=(dataclasses.replace(problem.traces[0], sigma_dof=50.0),))
    setting = setting_of(views_of(loose, {}, {}))
    model = noise_fitted(model_without_effects(setting)).model
    flicker = Hypothesis(by_id()["gyro_flicker"], (0,))
    assert noise_score(flicker, model).gain > 50.0
    filtered = dataclasses.replace(model, terms=(Term(Hypothesis(by_id()["gyro_low_pass"], (0,)), np.ones(1), CUTOFF),))
    assert evidence_of_filters(filtered, Sensor.GYRO) > 100.0
    assert noise_score(flicker, filtered).gain == 0.0


@pytest.mark.long
def test_a_late_sensor_with_noise_of_its_own_is_no_filter():
    problem = problem_of(np.random.default_rng(6), (Sensor.GYRO,))
    trace = problem.traces[0]
    late = trace.ideal - np.gradient(trace.ideal, 1.0 / trace.fs, axis=0) * 0.004
    problem = dataclasses.replace(problem, traces=(dataclasses.replace(trace, measured=late + trace.residual),))
    assert [e.id for e in diagnose(problem, nested=False).effects] == ["gyro_delay"]
