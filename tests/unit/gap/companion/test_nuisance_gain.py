"""A part of the reference's nuisance effects that is still there is no gap, whatever it is taken for."""

from __future__ import annotations

import numpy as np
import pytest

from mavcal.calib.gap.companion.nuisance_gain import above_nuisance
from mavcal.calib.gap.effects import catalogue
from mavcal.calib.gap.model.hypotheses import hypotheses_of
from mavcal.calib.gap.model.joint import setting_of, starting_model
from mavcal.calib.gap.model.noise_fit import model_without_effects, noise_fitted
from mavcal.calib.gap.model.views import views_of
from mavcal.calib.gap.problem import NuisanceEffect
from mavcal.calib.gap.schema import EffectEstimate, EffectEvidence, ParameterEstimate
from mavcal.calib.gap.search.contest import Contest
from mavcal.calib.gap.search.projection import Projection
from mavcal.calib.recording import Sensor
from tests.unit.gap.synthetic import SIGMA, problem_of

SCALE = np.array([0.04, -0.02, 0.03])


def nuisance(part, effect_id="accel_scale", name="scale"):
    estimates = tuple(
        ParameterEstimate(f"{name}.{a}", float(v), 0.001, (v - 0.002, v + 0.002), "")
        for a, v in zip("xyz", SCALE, strict=True)
    )
    return NuisanceEffect(
        EffectEstimate(effect_id, Sensor.ACCEL, (1,), estimates, EffectEvidence(1.0, 3, 0.0, 1.0, 0.0)), part
    )


@pytest.fixture(scope="module")
def task():
    problem = problem_of(np.random.default_rng(1), (Sensor.ACCEL,))
    views = views_of(problem, {}, {})
    setting = setting_of(views)
    bare = noise_fitted(model_without_effects(setting)).model
    hypotheses, _ = hypotheses_of([e for e in catalogue() if e.sensor is Sensor.ACCEL], views)
    return problem, bare, Contest(hypotheses)


def own(task, *effects):
    _, bare, contest = task
    return above_nuisance(contest, bare, effects).thresholds.own


def test_it_is_the_energy_of_the_part_that_is_left_open(task):
    problem, _, _ = task
    expected = float(((problem.traces[0].ideal * SCALE / 3.0) ** 2).sum() / SIGMA[Sensor.ACCEL] ** 2)
    assert own(task, nuisance(1.0 / 3.0))["accel_scale", (0,)] == pytest.approx(expected, rel=0.05)


def test_it_grows_with_the_square_of_the_part(task):
    small, large = own(task, nuisance(0.1)), own(task, nuisance(0.3))
    key = ("accel_scale", (0,))
    assert large[key] == pytest.approx(9.0 * small[key], rel=1e-6)


def test_what_would_explain_it_less_gains_less_of_it(task):
    found = own(task, nuisance(1.0 / 3.0))
    alike, other = found["accel_temp_scale", (0,)], found["accel_step", (0,)]
    whole = found["accel_scale", (0,)]
    assert whole > alike > other
    assert other < 0.5 * whole


def test_a_residual_like_the_flaw_gains_as_much(task):
    """The same number from the other side: the part put into the readings, scored against no nuisance effect."""

    def left(trace):
        return trace.ideal * SCALE / 3.0

    quiet, loud = (problem_of(np.random.default_rng(1), (Sensor.ACCEL,), gap) for gap in (None, left))
    gains = []
    for problem in (quiet, loud):
        setting = setting_of(views_of(problem, {}, {}))
        model = starting_model(setting, task[1].noise)
        contest = task[2]
        hypothesis = next(h for h in contest.hypotheses if h.key == ("accel_scale", (0,)))
        gains.append(Contest([hypothesis]).score(hypothesis, Projection(model)).gain)
    expected = own(task, nuisance(1.0 / 3.0))["accel_scale", (0,)]
    assert gains[1] - gains[0] == pytest.approx(expected, rel=0.15)


def test_a_flaw_that_cannot_be_tested_here_leaves_nothing_open(task):
    assert set(own(task, nuisance(1.0, "gyro_scale")).values()) == {0.0}


def test_without_nuisance_effects_there_is_nothing(task):
    assert own(task) == {}
