"""A line has a frequency that the data bound, or it is none."""

import math

import numpy as np
import pytest

from mavcal.calib.gap.effects.replay import forward_models
from mavcal.calib.gap.model.hypotheses import Hypothesis
from mavcal.calib.gap.model.joint import NoiseTerm, setting_of
from mavcal.calib.gap.model.noise_fit import model_without_effects, noise_fitted, with_term
from mavcal.calib.gap.model.views import views_of
from mavcal.calib.gap.telling.estimates import frequency_sd
from mavcal.calib.recording import Sensor
from tests.unit.gap.synthetic import SIGMA, problem_of

HZ = 13.0
LINE = forward_models()["gyro_vibration"][-1]


def with_line(seed, shaking, hz=HZ):
    """A gyroscope that shakes so while its motors run, and a line in its model."""
    problem = problem_of(np.random.default_rng(seed), (Sensor.GYRO,), shaking)
    setting = setting_of(views_of(problem, {}, {}))
    term = NoiseTerm(Hypothesis(LINE, (0,)), hz)
    return noise_fitted(with_term(model_without_effects(setting), term)).model, term


def shaken(trace, hz=HZ):
    turning = (trace.throttle > 0.05)[:, None]
    return 2.0 * SIGMA[Sensor.GYRO] * np.cos(2.0 * np.pi * hz * trace.t)[:, None] * turning * np.ones(3)


@pytest.mark.parametrize("seed", range(3))
def test_the_frequency_of_a_line_is_bounded(seed):
    model, term = with_line(seed, shaken)
    assert 0.0 < frequency_sd(model, term) < 0.5


@pytest.mark.parametrize("seed", range(6))
def test_white_noise_has_no_frequency(seed):
    rng = np.random.default_rng(100 + seed)
    louder = 0.05 * SIGMA[Sensor.GYRO]
    model, term = with_line(seed, lambda trace: louder * rng.normal(size=trace.ideal.shape))
    sd = frequency_sd(model, term)
    assert math.isinf(sd) or sd > 0.1 * HZ


def test_power_that_rises_to_half_of_the_rate_is_no_line():
    tried = LINE.shape.grid(problem_of(np.random.default_rng(1), (Sensor.GYRO,)).traces[0])
    for hz, bounded in ((tried[-1], False), (tried[-8], True)):
        model, term = with_line(1, lambda trace, hz=hz: shaken(trace, hz), hz)
        assert math.isfinite(frequency_sd(model, term)) is bounded
