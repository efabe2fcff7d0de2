"""Noise that is there for a while is no noise of a sensor, and is said with its time."""

from __future__ import annotations

import numpy as np
import pytest

from mavcal.calib.gap.effects import forward_models
from mavcal.calib.gap.model.hypotheses import Hypothesis
from mavcal.calib.gap.model.joint import NoiseTerm, setting_of
from mavcal.calib.gap.model.noise_fit import model_without_effects, noise_fitted, with_term
from mavcal.calib.gap.model.views import views_of
from mavcal.calib.gap.problem import GapProblem, ReferenceInfo, ReferenceKind, Trace
from mavcal.calib.gap.unknown.misattributed_noise import bursts
from mavcal.calib.recording import Sensor

FS, SECONDS, SD = 50.0, 120.0, 0.05


def louder_while(when):
    """A model with noise of an accelerometer, which is there where `when` of the time is true."""
    rng = np.random.default_rng(3)
    t = np.arange(int(FS * SECONDS)) / FS
    noise = rng.normal(size=(len(t), 3)) * (SD + 0.2 * when(t))[:, None]
    seen = np.ones(len(t), dtype=bool)
    trace = Trace(Sensor.ACCEL, (0,), t, noise, 0.0 * noise, seen, sigma=np.full(3, SD))
    setting = setting_of(views_of(GapProblem((trace,), ReferenceInfo(ReferenceKind.SIM), SECONDS), {}, {}))
    start = model_without_effects(setting)
    term = NoiseTerm(Hypothesis(forward_models()["accel_noise"][-1], (0,)), np.nan)
    return noise_fitted(with_term(start, term)).model


def test_a_burst_is_told_with_its_time():
    ((key, text),) = bursts(louder_while(lambda t: (t > 80.0) & (t < 90.0)))
    assert key[0] == "accel_noise"
    assert text == "noise on accel from 80 to 90 s only"


@pytest.mark.parametrize("start", [0.0, 70.0])
def test_noise_of_the_whole_recording_or_of_a_flight_is_no_burst(start):
    assert not list(bursts(louder_while(lambda t: t >= start)))
