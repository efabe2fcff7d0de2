"""What takes the place of an effect: noise that had to contain it, and rivals that are freer by a shape."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mavcal.calib.gap.effects import by_id
from mavcal.calib.gap.model.bands import split
from mavcal.calib.gap.model.hypotheses import Hypothesis
from mavcal.calib.gap.model.joint import setting_of
from mavcal.calib.gap.model.noise_fit import model_without_effects, noise_fitted
from mavcal.calib.gap.model.views import views_of
from mavcal.calib.gap.search.contest import Contest, ContestScore
from mavcal.calib.gap.search.exchange import _with_noise_fitted, evidence_deficit
from mavcal.calib.gap.search.projection import Projection
from mavcal.calib.recording import Sensor
from tests.unit.gap.synthetic import SIGMA, problem_of


def score(effect_id: str, delta: float, df: int) -> ContestScore:
    return ContestScore(Hypothesis(by_id()[effect_id], (0,)), 0.0, delta, df, 1, 1e-9, delta, np.zeros(df))


def test_a_shape_is_a_freedom() -> None:
    """A scale that vanishes at a temperature that is searched says no more than a plain one, and had half of it."""
    plain = False, False, 3
    assert evidence_deficit(1000.0, score("gyro_scale", 1000.0, 3), plain, 10.0) == 0.0
    assert evidence_deficit(1000.0, score("gyro_temp_scale", 1000.0, 3), plain, 10.0) == 10.0


def test_noise_shrinks_once_an_effect_on_the_mean_has_what_it_had_to_contain() -> None:
    """Learned noise has a free scale: beside an offset of sixty times itself it grew, and the offset seemed small."""
    offset = 60.0 * SIGMA[Sensor.ACCEL]
    problem = problem_of(np.random.default_rng(3), (Sensor.ACCEL,), lambda _: np.array([0.0, offset, 0.0]))
    learned = dataclasses.replace(problem.traces[0], sigma_dof=500.0)
    setting = setting_of(split(views_of(dataclasses.replace(problem, traces=(learned,)), {}, {})))
    bare = noise_fitted(model_without_effects(setting)).model
    bias = Hypothesis(by_id()["accel_bias"], (0,))
    found = Contest((bias,)).score(bias, Projection(bare))
    fitted = _with_noise_fitted(found, bare)
    samples = setting.views[0].count + 500
    assert fitted.gain == pytest.approx(samples * np.log(1.0 + setting.views[0].count * 60.0**2 / samples), rel=0.05)
    assert fitted.gain > 3.0 * found.gain
    assert fitted.delta - found.delta == pytest.approx(fitted.gain - found.gain)
