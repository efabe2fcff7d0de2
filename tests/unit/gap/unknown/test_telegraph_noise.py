"""Readings that switch to and fro between two levels, instead of a drift or of an effect that comes and goes."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import pytest

from mavcal.calib.gap.diagnose import diagnose
from mavcal.calib.gap.effects import forward_models
from mavcal.calib.gap.model.hypotheses import Hypothesis
from mavcal.calib.gap.model.joint import NoiseTerm, Term, setting_of, with_residual
from mavcal.calib.gap.model.noise_fit import model_without_effects, noise_fitted, with_term
from mavcal.calib.gap.model.views import views_of
from mavcal.calib.gap.problem import GapProblem, ReferenceInfo, ReferenceKind, Trace
from mavcal.calib.gap.unknown.telegraph_noise import telegraph_noise, two_levels
from mavcal.calib.gap.worth.attribution import Attribution
from mavcal.calib.recording import Sensor
from tests.unit.gap.synthetic import SIGMA, problem_of

G, FS, N, SD = Sensor.GYRO, 50.0, 3500, 0.003
WALK = ("gyro_random_walk", (0,))


def telegraph(rng, levels, every):
    """(N, 3), switching on average `every` samples between 0 and `levels`."""
    return (np.cumsum(rng.random((N, 3)) < 1.0 / every, axis=0) % 2) * np.asarray(levels)


def drifting(change, seed=0):
    """A model with a random walk, and what the walk gains."""
    rng = np.random.default_rng(seed + 1000)
    t = np.arange(N) / FS
    ideal = 0.3 * np.sin(0.7 * t)[:, None] * [1.0, -0.5, 0.2]
    measured = ideal + SD * rng.normal(size=ideal.shape) + change
    trace = Trace(G, (0,), t, measured, ideal, np.ones(N, dtype=bool), sigma=np.full(3, SD))
    setting = setting_of(views_of(GapProblem((trace,), ReferenceInfo(ReferenceKind.SIM), N / FS), {}, {}))
    start = noise_fitted(model_without_effects(setting))
    term = NoiseTerm(Hypothesis(forward_models()["gyro_random_walk"][-1], (0,)), np.nan)
    walking = noise_fitted(with_term(start.model, term))
    gain = sum(start.deviance.values()) - sum(walking.deviance.values())
    return walking.model, (Attribution(WALK, gain, 3, 1.0, 0.7, 0.0, ()),)


@pytest.mark.parametrize("seed", range(5))
def test_a_walk_that_is_telegraph_noise_is_one_of_two_levels(seed):
    change = telegraph(np.random.default_rng(seed), [SD, 0.7 * SD, 0.3 * SD], 150.0)
    (found,) = telegraph_noise(*drifting(change, seed))
    assert found.keys == (WALK,)
    assert "two levels on gyro" in found.text


def test_jumps_below_what_two_recordings_differ_by_are_not_said():
    change = telegraph(np.random.default_rng(1), [SD, 0.7 * SD, 0.3 * SD], 150.0)
    model, (walk,) = drifting(change, 1)
    assert telegraph_noise(model, (walk,), {G: 100.0, Sensor.MAG: 1e6})
    assert telegraph_noise(model, (walk,), {G: 1e6}) == ()


@pytest.mark.parametrize("seed", range(3))
def test_a_constant_of_another_unit_is_no_jump_of_the_one_that_has_a_bias(seed):
    # A chain of two equal levels takes any constant, and jumps as often as it likes.
    rng = np.random.default_rng(seed)
    t = np.arange(N) / FS
    ideal = 0.3 * np.sin(0.7 * t)[:, None] * [1.0, -0.5, 0.2]
    offsets = (np.array([2.0, -1.0, 0.5]), np.array([0.5, 0.5, -0.5]))
    traces = tuple(
        Trace(
            G,
            (i,),
            t,
            ideal + SD * (rng.normal(size=ideal.shape) + offset),
            ideal,
            np.ones(N, dtype=bool),
            sigma=np.full(3, SD),
        )
        for i, offset in enumerate(offsets)
    )
    problem = GapProblem(traces, ReferenceInfo(ReferenceKind.ESTIMATOR, 1.0), N / FS)
    setting = setting_of(views_of(problem, {}, {}))
    assert len(setting.views) == 2
    bias = Hypothesis(forward_models()["gyro_bias"][-1], (0,))
    start = noise_fitted(model_without_effects(setting)).model
    model = with_residual(dataclasses.replace(start, terms=(Term(bias, SD * offsets[0], np.nan),)))
    assert telegraph_noise(model, (Attribution(bias.key, 1e4, 3, 1.0, 0.9, 0.0, ()),)) == ()


@pytest.mark.long
@pytest.mark.parametrize("size", [0.02, 0.1])
def test_a_walk_that_is_one_has_more_than_two_levels(size):
    for seed in range(10):
        walk = np.cumsum(size * SD * np.random.default_rng(seed).normal(size=(N, 3)), axis=0)
        assert telegraph_noise(*drifting(walk, seed)) == ()


def test_a_drift_of_one_sensor_is_asked_beside_what_all_of_them_share():
    def gap(trace):
        if trace.sensor is not G:
            return 0.0
        return np.cumsum(0.3 * SIGMA[G] * np.random.default_rng(8).normal(size=trace.ideal.shape), axis=0)

    problem = problem_of(np.random.default_rng(7), (Sensor.ACCEL, G), gap)
    setting = setting_of(views_of(problem, {}, {}))
    start = noise_fitted(model_without_effects(setting))
    walk = NoiseTerm(Hypothesis(forward_models()["gyro_random_walk"][-1], (0,)), np.nan)
    drift = Hypothesis(forward_models()["clock_drift"][-1], (0,))
    clock = Term(drift, np.ones(1), 20.0)
    model = with_residual(dataclasses.replace(noise_fitted(with_term(start.model, walk)).model, terms=(clock,)))
    attributions = tuple(Attribution(key, 100.0, 3, 0.5, 0.7, 0.0, ()) for key in (WALK, drift.key))
    assert telegraph_noise(model, attributions) == ()


@pytest.mark.sampled
@pytest.mark.parametrize("end", [1.0, 0.7])
def test_a_step_and_one_that_ends_are_no_jumps_to_and_fro(end):
    t = np.arange(N) / N
    for seed in range(5):
        step = ((t > 0.3) & (t < end))[:, None] * SD * np.array([1.0, -0.7, 0.3])
        assert telegraph_noise(*drifting(step, seed)) == ()


def test_an_effect_that_the_sensor_does_not_have_is_not_asked():
    change = telegraph(np.random.default_rng(1), [SD, SD, SD], 150.0)
    model, (walk,) = drifting(change)
    assert telegraph_noise(model, ()) == ()
    assert [s.keys for s in telegraph_noise(model, (walk,))] == [(WALK,)]


@pytest.mark.sampled
@pytest.mark.parametrize("seed", range(3))
def test_what_follows_motors_that_are_switched_is_theirs_beside_a_relative_as_well(seed):
    # Two effects that imitate each other: what one of them gains as the last is little, what it does is much.
    rng = np.random.default_rng(seed)
    problem = problem_of(rng, (G,))
    (trace,) = problem.traces
    on = (np.floor(trace.t / 5.0) % 2 == 1).astype(float)
    tilted = np.column_stack([4.0 * on, -2.0 * on, -9.8 + 0.0 * on]) + 0.6 * np.sin(
        0.9 * trace.t[:, None] + [0.0, 1.0, 2.0]
    )
    change = SIGMA[G] * (1.5 * on[:, None] * [0.6, -0.6, 0.5] + 0.3 * tilted)
    trace = dataclasses.replace(
        trace,
        measured=trace.measured + change,
        force=tilted,
        throttle=0.6 * on,
        motors=np.repeat(0.6 * on[:, None], 4, axis=1),
    )
    report = diagnose(dataclasses.replace(problem, traces=(trace,)), nested=False)
    assert "two levels" not in report.unknown.shape
    assert report.effects


@pytest.mark.long
def test_likelihood_of_two_levels_is_that_of_all_paths():
    rng = np.random.default_rng(3)
    x = np.array([0.1, 0.9, 1.3, -0.2, 0.0, 1.1, 0.8])[:, None] + 0.1 * rng.normal(size=(7, 1))
    variance = np.array([0.04])

    def summed(levels, up, down):
        chances = {(0, 0): 1 - up, (0, 1): up, (1, 0): down, (1, 1): 1 - down}
        total = 0.0
        for path in itertools.product((0, 1), repeat=len(x)):
            start = (down, up)[path[0]] / (up + down)
            steps = np.prod([chances[pair] for pair in itertools.pairwise(path)])
            misfit = (x[:, 0] - np.take(levels, path)) ** 2 - x[:, 0] ** 2
            total += start * steps * np.exp(-0.5 * misfit.sum() / variance[0])
        return 2.0 * np.log(total)

    grid = itertools.product(np.linspace(-0.1, 0.2, 7), np.linspace(0.9, 1.2, 7), (0.2, 0.35, 0.5), (0.2, 0.35, 0.5))
    best = max(summed((low, high), up, down) for low, high, up, down in grid)
    (found,), (jumps,) = two_levels(x, variance)
    assert best - 0.3 < found < best + 3.0  # between the values of the grid it may be better
    assert jumps == pytest.approx(3.0, abs=0.3)


def test_columns_do_not_touch_each_other():
    rng = np.random.default_rng(5)
    x = rng.normal(size=(300, 2)) + 2.0 * telegraph(rng, [1.0, 1.0, 0.0], 40.0)[:300, :2]
    both, _ = two_levels(x, np.ones(2))
    alone = [two_levels(x[:, [c]], np.ones(1))[0][0] for c in range(2)]
    assert both == pytest.approx(alone, abs=0.2)
