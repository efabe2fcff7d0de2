"""Gains of groups of columns against a plain least-squares computation, and chances on series without a gap."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from scipy.stats import kstest

from mavcal.calib.gap.effects import by_id, forward_models
from mavcal.calib.gap.likelihood import transform
from mavcal.calib.gap.model.bands import split
from mavcal.calib.gap.model.hypotheses import Binning, Hypothesis
from mavcal.calib.gap.model.joint import setting_of
from mavcal.calib.gap.model.noise_fit import model_without_effects
from mavcal.calib.gap.model.refinement import refined
from mavcal.calib.gap.model.views import views_of
from mavcal.calib.gap.problem import GapProblem, ReferenceInfo, ReferenceKind, Trace
from mavcal.calib.gap.search.contest import (
    Contest,
    fixed_score,
    free_score,
    most_sensitive_series,
    noise_score,
    one_sided_tail_probability,
    tail_probability,
)
from mavcal.calib.gap.search.power import noncentrality
from mavcal.calib.gap.search.projection import Gain, Projection
from mavcal.calib.gap.search.selection import ChosenModel, extended
from mavcal.calib.gap.search.terms import jointly_fitted, with_score
from mavcal.calib.recording import Sensor
from tests.unit.gap.synthetic import SIGMA, problem_of


def start(seed):
    setting = setting_of(views_of(problem_of(np.random.default_rng(seed), (Sensor.ACCEL,)), {}, {}))
    return model_without_effects(setting)


def test_gain_beside_another_effect_is_the_ratio_of_least_squares():
    model = start(0)
    contest = Contest(())
    bias, scale = (Hypothesis(by_id()[f"accel_{kind}"], (0,)) for kind in ("bias", "scale"))
    model, _ = refined(with_score(model, contest.score(bias, Projection(model))))
    gain = contest.score(scale, Projection(model)).gain
    view = model.setting.views[0]
    trace = view.traces[0]
    X = [e.effect.columns(trace, math.nan).reshape(3, -1).T for e in (bias, scale)]
    y = view.residual.ravel() / SIGMA[Sensor.ACCEL]

    def left(columns):
        A = columns / SIGMA[Sensor.ACCEL]
        return float(((y - A @ np.linalg.lstsq(A, y, rcond=None)[0]) ** 2).sum())

    assert gain == pytest.approx(left(X[0]) - left(np.hstack(X)), rel=1e-6)


def test_what_grows_to_the_end_of_a_recording_counts_to_its_end():
    # The mean may leave out next to nothing of the samples that noise is fitted to, or a drift is called noise.
    rng = np.random.default_rng(5)
    problem = problem_of(rng, (Sensor.ACCEL,))
    (trace,) = problem.traces
    kept = np.arange(len(trace.t)) < 1993  # a prime
    late = SIGMA[Sensor.ACCEL] * np.exp((trace.t - trace.t[-1]) / 1.0)[:, None] * [3.0, 0.0, 0.0]
    trace = dataclasses.replace(trace, measured=trace.measured + late, observed=kept)
    setting = setting_of(views_of(dataclasses.replace(problem, traces=(trace,)), {}, {}))
    model = model_without_effects(setting)
    energy = sum(float(w @ y**2) for w, y in zip(model.weight, model.y, strict=True))
    assert energy == pytest.approx(float(((trace.residual[kept] / SIGMA[Sensor.ACCEL]) ** 2).sum()), rel=0.015)


def test_chances_are_uniform_where_there_is_no_gap():
    bias = Hypothesis(by_id()["accel_bias"], (0,))
    chances = [Contest(()).score(bias, Projection(start(seed))).p for seed in range(100, 140)]
    assert kstest(chances, "uniform").pvalue > 1e-3


def test_the_grid_multiplies_the_tail():
    assert tail_probability(30.0, 3, 10) == pytest.approx(10 * tail_probability(30.0, 3, 1))
    assert one_sided_tail_probability(9.0, 1, 1) == pytest.approx(0.5 * tail_probability(9.0, 1, 1))
    assert tail_probability(0.0, 3, 5) == 1.0


def test_averages_of_white_noise_have_its_power_over_their_number():
    frame = Binning(4, 4000)
    series = np.random.default_rng(0).normal(size=4000)
    assert frame.power(np.ones(4000)) == pytest.approx(np.full(1000, 0.25), rel=2e-3)
    assert np.var(frame.bins(series)) == pytest.approx(0.25, rel=0.15)
    assert np.array_equal(Binning(1, 4000).bins(series), transform(series))


def test_the_smallest_effect_that_shows_is_found_half_of_the_time():
    level = 1e-4
    rng = np.random.default_rng(0)
    x = rng.normal(size=(20_000, 3))
    x[:, 0] += math.sqrt(noncentrality(3, level))
    found = np.mean([tail_probability(float(s), 3, 1) < level for s in (x**2).sum(axis=1)])
    assert found == pytest.approx(0.5, abs=4.0 * 0.5 / math.sqrt(20_000))


def test_of_two_bands_the_lower_one_stands_for_both_however_loud_the_upper_one_is():
    rng = np.random.default_rng(8)
    t = np.arange(24_000) / 400.0
    ideal = 0.3 * np.sin(0.7 * t)[:, None] * [1.0, -0.5, 0.2]
    humming = 0.1 * np.sin(2.0 * np.pi * 90.0 * t)[:, None]
    measured = ideal + 0.003 * rng.normal(size=ideal.shape) + humming
    trace = Trace(Sensor.GYRO, (0,), t, measured, ideal, np.ones(len(t), bool), sigma=np.full(3, 0.003))
    problem = GapProblem((trace,), ReferenceInfo(ReferenceKind.SIM), 60.0)
    setting = setting_of(split(views_of(problem, {}, {})))
    model = model_without_effects(setting)
    assert [view.first > 0 for view in setting.views] == [False, True]
    for kind in ("step", "tone", "bias", "noise"):
        assert most_sensitive_series(Hypothesis(by_id()[f"gyro_{kind}"], (0,)), model)[1] == 0


HANDICAP = 7.0


def dearer(made):
    """A score without and with a handicap: everything but its price is the same."""
    free, dear = made(0.0), made(HANDICAP)
    assert (dear.gain, dear.p, dear.df, dear.grid, dear.theta) == pytest.approx(
        (free.gain, free.p, free.df, free.grid, free.theta), rel=1e-12, nan_ok=True
    )
    np.testing.assert_array_equal(dear.beta, free.beta)
    assert free.gain > 0.0
    return dear.delta - free.delta


@pytest.mark.parametrize("theta", [math.nan, 2.0])
def test_a_handicap_is_paid_by_effects_on_the_mean(theta):
    found = Gain(60.0, 3, np.array([0.1, -0.2, 0.3]), 50.0)
    effect = by_id()["gyro_bias"]
    assert dearer(lambda h: free_score(Hypothesis(effect, (1,), 0, h), theta, found, 9)) == pytest.approx(-HANDICAP)


def test_a_handicap_is_paid_by_effects_that_are_nothing_but_a_shape():
    effect = by_id()["gyro_delay"]
    assert dearer(lambda h: fixed_score(Hypothesis(effect, (1,), 0, h), 0.01, 60.0)) == pytest.approx(-HANDICAP)


def test_a_handicap_is_paid_by_effects_on_the_noise():
    rng = np.random.default_rng(4)
    loud = problem_of(rng, (Sensor.GYRO,), lambda t: SIGMA[Sensor.GYRO] * rng.normal(size=t.ideal.shape))
    setting = setting_of(views_of(loud, {}, {}))
    model = model_without_effects(setting)
    (effect,) = forward_models()["gyro_noise"]
    assert dearer(lambda h: noise_score(Hypothesis(effect, (0,), 0, h), model)) == pytest.approx(-HANDICAP)


def test_a_handicap_reaches_the_contest():
    rng = np.random.default_rng(5)
    problem = problem_of(rng, (Sensor.ACCEL,), lambda _t: np.array([0.05, 0.0, 0.0]))
    setting = setting_of(views_of(problem, {}, {}))
    beside = Projection(model_without_effects(setting))
    bias = by_id()["accel_bias"]
    assert dearer(lambda h: Contest(()).score(Hypothesis(bias, (0,), 0, h), beside)) == pytest.approx(-HANDICAP)


def exchanged(seed, size, kinds=("bias", "scale")):
    """A chosen model of an accelerometer with an offset and a scale of `size`, as an exchange leaves it."""

    def gap(trace):
        return np.array([0.015, -0.01, 0.0]) + size * trace.ideal * [1.0, 0.0, -1.0]

    setting = setting_of(views_of(problem_of(np.random.default_rng(seed), (Sensor.ACCEL,), gap), {}, {}))
    contest = Contest([Hypothesis(by_id()[f"accel_{kind}"], (0,)) for kind in kinds])
    model, scores = model_without_effects(setting), []
    for hypothesis in contest.hypotheses:
        scores.append(contest.score(hypothesis, Projection(model)))
        model = with_score(model, scores[-1])
    model, joint, noise = jointly_fitted(model)
    return ChosenModel(model, joint, noise, tuple(scores), len(kinds), (), model), contest


def members(chosen):
    """Members of the model: those that have a score."""
    inside = [term.hypothesis.effect.id for term in chosen.model.members]
    assert sorted(s.hypothesis.effect.id for s in chosen.scores) == sorted(inside)
    return set(inside)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("order", [("bias", "scale"), ("scale", "bias")])
def test_what_an_exchange_made_superfluous_leaves(seed, order):
    chosen, contest = exchanged(seed, 0.0, order)
    assert members(chosen) == {"accel_bias", "accel_scale"}
    assert members(extended(chosen, contest, 1e-4)) == {"accel_bias"}
    assert members(extended(chosen, contest, 1e-4, ())) == {"accel_bias"}


@pytest.mark.parametrize("seed", range(5))
def test_what_is_still_needed_after_an_exchange_stays(seed):
    chosen, contest = exchanged(seed, 0.01)
    assert members(extended(chosen, contest, 1e-4)) == {"accel_bias", "accel_scale"}


def test_the_only_effect_of_a_model_stays_while_something_may_join_it():
    chosen, contest = exchanged(1, 0.01, ("scale",))
    assert members(extended(chosen, contest.restricted_to(exchanged(1, 0.01)[1].hypotheses), 1e-4)) == {
        "accel_bias",
        "accel_scale",
    }
