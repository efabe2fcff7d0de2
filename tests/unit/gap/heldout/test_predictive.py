"""What is foretold of a held-out block: the density that a fit and its uncertainty give, and nothing unseen."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mavcal.calib.gap.effects import forward_models
from mavcal.calib.gap.heldout.folds import applied_to, folds_of, log_loss, predictive_loss, with_joined_term
from mavcal.calib.gap.model.hypotheses import Hypothesis
from mavcal.calib.gap.model.joint import Model, Term, jacobian, normal_equations, setting_of
from mavcal.calib.gap.model.noise_fit import noise_fitted
from mavcal.calib.gap.model.views import views_of
from mavcal.calib.recording import Sensor
from tests.unit.gap.synthetic import SIGMA, problem_of

ACCEL_SCALE = Hypothesis(forward_models()["accel_scale"][-1], (0,))
GYRO_BIAS = Hypothesis(forward_models()["gyro_bias"][-1], (0,))


def folds(sensor, seed, gap=None, count=4):
    setting = setting_of(views_of(problem_of(np.random.default_rng(seed), (sensor,), gap), {}, {}))
    return folds_of(setting, count)


def loss_at(model: Model, block: Model, beta) -> float:
    (term,) = model.terms
    return log_loss(applied_to(dataclasses.replace(model, terms=(dataclasses.replace(term, beta=beta),)), block))


@pytest.mark.long
@pytest.mark.parametrize("seed", range(3))
def test_it_is_the_mean_of_the_density_over_what_the_other_blocks_leave_open(seed):
    """Monte Carlo over what one block says, and the other three; beside a large effect its prior hardly moves it."""

    def gap(trace):
        return 0.05 * SIGMA[Sensor.ACCEL] * trace.ideal

    rng = np.random.default_rng(seed)
    for fold in folds(Sensor.ACCEL, seed, gap):
        train = with_joined_term(noise_fitted(fold.test).model, Term(ACCEL_SCALE, np.zeros(3), np.nan))
        normal = normal_equations([jacobian(train.terms[0], train.setting)], train.y, train.weight)
        drawn = rng.multivariate_normal(train.terms[0].beta, np.linalg.inv(normal.gram), 600)
        losses = np.array([loss_at(train, fold.train, beta) for beta in drawn])
        weight = np.exp(losses.min() - losses)
        mean = losses.min() - np.log(weight.mean())
        error = weight.std() / weight.mean() / np.sqrt(len(weight))
        assert predictive_loss(train, fold.train) == pytest.approx(mean, abs=0.05 + 5.0 * error)


def test_of_what_the_other_blocks_do_not_show_nothing_is_foretold():
    def gap(trace):
        return np.where(trace.t > 0.8 * trace.t[-1], 5.0, 0.0)[:, None] * SIGMA[Sensor.GYRO] * np.ones(3)

    *_, last = folds(Sensor.GYRO, 3, gap, 5)
    bare = noise_fitted(last.train).model
    train = with_joined_term(bare, Term(GYRO_BIAS, np.zeros(3), np.nan))
    without = predictive_loss(bare, last.test)
    assert predictive_loss(train, last.test) == pytest.approx(without, abs=8.0)
    assert without > log_loss(last.test) - 1.0


def test_without_an_effect_it_is_the_loss_of_the_noise():
    for fold in folds(Sensor.GYRO, 4):
        model = noise_fitted(fold.train).model
        assert predictive_loss(model, fold.test) == log_loss(applied_to(model, fold.test))


def test_a_curve_carried_on_beyond_what_was_seen_is_not_taken_for_certain():
    """A cubic of temperature where one end of the warm-up is held out: its best guess is far off, and known to be."""

    def gap(trace):
        warm = trace.temperature - trace.temperature.mean()
        return 0.1 * SIGMA[Sensor.GYRO] * warm[:, None] * np.ones(3)

    poly = Hypothesis(forward_models()["gyro_temp_poly"][-1], (0,))
    saved = []
    for seed in range(4):
        first, *_, last = folds(Sensor.GYRO, seed, gap, 5)
        for fold in (first, last):
            train = with_joined_term(noise_fitted(fold.train).model, Term(poly, np.zeros(9), 25.0))
            saved.append(log_loss(applied_to(train, fold.test)) - predictive_loss(train, fold.test))
    assert np.median(saved) > 10.0
    assert min(saved) > -0.5 * 9  # a guess that is right by chance would have been cheaper by some half a nat a number


def test_two_effects_of_which_the_other_blocks_know_the_sum_alone_do_not_deny_each_other():
    """An offset and a drift with temperature, the warm-up held out: neither shows a sign beside the other."""
    problem = problem_of(np.random.default_rng(5), (Sensor.ACCEL,))
    (trace,) = problem.traces
    warm = 22.0 + 33.0 * (1.0 - np.exp(-trace.t / 1.2))
    drift = np.outer(0.05 + 0.008 * (warm - 35.0), np.ones(3))
    trace = dataclasses.replace(trace, temperature=warm, measured=trace.measured + drift)
    fold = folds_of(setting_of(views_of(dataclasses.replace(problem, traces=(trace,)), {}, {})), 4)[0]
    bias, thermal = (Hypothesis(forward_models()[name][-1], (0,)) for name in ("accel_bias", "accel_temp_linear"))
    one = with_joined_term(noise_fitted(fold.train).model, Term(bias, np.zeros(3), np.nan))
    both = with_joined_term(one, Term(thermal, np.zeros(3), 35.0))
    true = (Term(bias, np.full(3, 0.05), np.nan), Term(thermal, np.full(3, 0.008), 35.0))
    known = log_loss(applied_to(dataclasses.replace(both, terms=true), fold.test))
    assert predictive_loss(one, fold.test) > known + 300.0
    assert predictive_loss(both, fold.test) < known + 60.0
