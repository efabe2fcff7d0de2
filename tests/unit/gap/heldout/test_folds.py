"""Blocks that are held out: what is carried over to them keeps its axis, and what they should gain."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mavcal.calib.gap.effects import forward_models
from mavcal.calib.gap.heldout.folds import (
    applied_to,
    expected_gain,
    folds_of,
    is_predictable,
    log_loss,
    with_joined_term,
)
from mavcal.calib.gap.model.hypotheses import Hypothesis
from mavcal.calib.gap.model.joint import NoiseTerm, Term, setting_of
from mavcal.calib.gap.model.noise_fit import model_without_effects, noise_fitted, with_term
from mavcal.calib.gap.model.views import views_of
from mavcal.calib.gap.search.contest import Contest
from mavcal.calib.gap.search.projection import Projection
from mavcal.calib.recording import Sensor
from tests.unit.gap.synthetic import SIGMA, problem_of

LOUD = np.array([2.0, 0.5, 8.0])


def louder(trace):
    rng = np.random.default_rng(77)
    return LOUD * SIGMA[trace.sensor] * rng.normal(size=trace.ideal.shape)


def folds(seed, gap=None, *, unknown=False, count=4):
    problem = problem_of(np.random.default_rng(seed), (Sensor.GYRO,), gap)
    if unknown:
        problem = dataclasses.replace(problem, traces=tuple(dataclasses.replace(t, sigma=None) for t in problem.traces))
    return folds_of(setting_of(views_of(problem, {}, {})), count)


def test_the_others_are_whole_on_either_side_of_a_block_and_a_second_away_from_it():
    count = 5
    every = folds(3, count=count)
    assert len(every) == count
    for k, fold in enumerate(every):
        (block,) = (view.t for view in fold.test.setting.views)
        others = [view.t for view in fold.train.setting.views]
        assert len(others) == (1 if k in {0, count - 1} else 2)
        for t in others:
            assert t[0] - block[-1] > 0.99 or block[0] - t[-1] > 0.99
        assert len(block) + sum(map(len, others)) >= 0.94 * 2000


NOISE = NoiseTerm(Hypothesis(forward_models()["gyro_noise"][-1], (0,)), np.nan)


def test_noise_that_differs_by_axis_keeps_its_axis():
    for fold in folds(1, louder):
        train = with_joined_term(noise_fitted(fold.train).model, NOISE)
        test = applied_to(train, fold.test)
        for c in range(3):
            assert test.noise[c].amplitudes[NOISE.name(0)] == train.noise[c].amplitudes[NOISE.name(0)]
        found = np.sqrt([50.0 * test.noise[c].amplitudes[NOISE.name(0)] for c in range(3)]) / SIGMA[Sensor.GYRO]
        assert found == pytest.approx(LOUD, rel=0.2)


def test_noise_that_nobody_declared_keeps_its_axis_too():
    for fold in folds(2, louder, unknown=True):
        train = noise_fitted(fold.train).model
        test = applied_to(train, fold.test)
        power = np.array([test.noise[c].power.mean() for c in range(3)])
        assert np.sqrt(power) == pytest.approx(SIGMA[Sensor.GYRO] * np.hypot(1.0, LOUD), rel=0.15)


def shaken(trace):
    """A vibration in the third quarter of the recording alone."""
    during = (trace.t > 20.0) & (trace.t < 30.0)
    wave = 10.0 * SIGMA[trace.sensor] * np.sin(2.0 * np.pi * 17.0 * trace.t) * during
    return wave[:, None] * np.ones(3)


def test_a_vibration_is_sought_in_the_block_that_has_it():
    # The first of the blocks that remain is still: its four strongest frequencies are chance.
    line = Hypothesis(forward_models()["gyro_vibration"][-1], (0,))
    model = noise_fitted(folds(4, shaken)[1].train).model
    score = Contest(()).score(line, Projection(model))
    assert score.theta == pytest.approx(17.0, abs=0.5)
    assert score.gain > 1000.0


def test_the_right_axis_has_the_smaller_loss():
    for fold in folds(3, louder):
        train = with_joined_term(noise_fitted(fold.train).model, NOISE)
        turned = dataclasses.replace(train, noise=train.noise[1:] + train.noise[:1])
        assert log_loss(applied_to(train, fold.test)) < log_loss(applied_to(turned, fold.test)) - 100.0


def test_a_true_effect_gains_on_a_held_out_block_what_it_should():
    def gap(_trace):
        return np.array([0.0, 1.0, -0.5]) * SIGMA[Sensor.GYRO]

    bias = Hypothesis(forward_models()["gyro_bias"][-1], (0,))
    gained, due = 0.0, 0.0
    for fold in folds(4, gap):
        term = Term(bias, np.zeros(3), np.nan)
        train = with_joined_term(noise_fitted(fold.train).model, term)
        gained += log_loss(applied_to(noise_fitted(fold.train).model, fold.test)) - log_loss(
            applied_to(train, fold.test)
        )
        due += expected_gain(train.terms[0], fold.train, applied_to(train, fold.test))
    assert gained == pytest.approx(due, abs=4.0 * np.sqrt(2.0 * due))


def test_what_happens_in_one_block_only_cannot_be_foretold():
    step = Hypothesis(forward_models()["gyro_step"][-1], (0,))
    term = Term(step, np.array([0.01, 0.0, 0.0]), 35.0)
    found = [expected_gain(term, fold.train, fold.test) for fold in folds(5)]
    assert found[-1] < -5.0
    assert all(e > -5.0 for e in found[:-1])


def test_a_recording_in_fewer_than_three_pieces_has_no_folds():
    assert folds(6, count=2) == ()
    setting = setting_of(views_of(problem_of(np.random.default_rng(6), (Sensor.GYRO,)), {}, {}))
    model = with_term(model_without_effects(setting), NOISE)
    assert applied_to(model, model_without_effects(setting)).noise_terms == (NOISE,)


def test_a_jump_beside_a_drift_is_foretold_only_by_the_blocks_in_which_it_happens():
    made = folds(5)
    whole = made[0].train
    step = Term(Hypothesis(forward_models()["gyro_step"][0], (0,)), np.ones(3), 15.0)
    drift = NoiseTerm(Hypothesis(forward_models()["gyro_random_walk"][-1], (0,)), np.nan)
    assert all(is_predictable(step, whole, fold.train.setting) for fold in made)
    drifting = dataclasses.replace(whole, noise_terms=(drift,))
    assert [is_predictable(step, drifting, fold.train.setting) for fold in made] == [True, False, True, True]
    assert all(is_predictable(drift, drifting, fold.train.setting) for fold in made)


def test_what_a_block_cannot_show_is_not_expected_of_it():
    fold = folds(1)[0]
    term = Term(Hypothesis(forward_models()["mag_hard_iron"][-1], (0,)), np.ones(3), np.nan)
    assert expected_gain(term, fold.train, fold.test) == 0.0


def test_two_jumps_in_one_held_out_block_are_not_foretold():
    fold = folds(1)[0]
    step = forward_models()["gyro_step"][0]
    inside = float(fold.test.setting.views[0].t[200])
    pair = [Term(Hypothesis(step, (0,), k), np.ones(3), inside + k) for k in range(2)]
    far = Term(Hypothesis(step, (0,), 1), np.ones(3), float(fold.train.setting.views[-1].t[200]))
    whole = fold.train
    assert not is_predictable(pair[0], dataclasses.replace(whole, terms=tuple(pair)), fold.train.setting)
    assert is_predictable(pair[0], dataclasses.replace(whole, terms=(pair[0], far)), fold.train.setting)
