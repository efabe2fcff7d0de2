"""Noise that is no sensor's own: it swells and fades, it comes back, or one driver moves all axes."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.signal import lfilter

from mavcal.calib.gap.effects import forward_models
from mavcal.calib.gap.model.hypotheses import Hypothesis
from mavcal.calib.gap.model.joint import NoiseTerm, setting_of
from mavcal.calib.gap.model.noise_fit import model_without_effects, noise_fitted, with_term
from mavcal.calib.gap.model.views import views_of
from mavcal.calib.gap.problem import GapProblem, ReferenceInfo, ReferenceKind, Trace
from mavcal.calib.gap.unknown.misattributed_noise import (
    hidden_driver,
    misattributed_noise,
    nonstationary_noise,
    returns_to_mean,
)
from mavcal.calib.recording import Sensor

G, FS, N, SD = Sensor.GYRO, 50.0, 2000, 0.003


def model_of(change, *, rounding=0.0, seed=0, n=N, live=(1.0, 1.0, 1.0), **over):
    rng = np.random.default_rng(seed)
    t = np.arange(n) / FS
    ideal = 0.3 * np.sin(0.7 * t)[:, None] * [1.0, -0.5, 0.2]
    measured = ideal + (SD * rng.normal(size=ideal.shape) + change) * live
    if rounding:
        measured = np.round(measured / rounding) * rounding
    trace = Trace(G, (0,), t, measured, ideal, np.ones(n, dtype=bool), **{"sigma": np.full(3, SD), **over})
    setting = setting_of(views_of(GapProblem((trace,), ReferenceInfo(ReferenceKind.SIM), n / FS), {}, {}))
    return model_without_effects(setting)


def wandering(model):
    term = NoiseTerm(Hypothesis(forward_models()["gyro_random_walk"][-1], (0,)), np.nan)
    return noise_fitted(with_term(model, term)).model, term


def bursts(times, seed=9, n=N, every=10.0, of=1.0):
    t = np.arange(n) / FS
    return (t % every < of)[:, None] * times * SD * np.random.default_rng(seed).normal(size=(n, 3))


@pytest.mark.parametrize("times", [2.0, 5.0])
@pytest.mark.parametrize("of", [0.5, 1.0, 3.0])
def test_noise_that_comes_in_bursts_is_unsteady(times, of):
    (found,) = nonstationary_noise(model_of(bursts(times, of=of)))
    assert found.nats > 20.0
    assert "comes and goes" in found.text
    assert found.sensor is G


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_bursts_of_all_axes_at_once_show_earlier_than_those_of_one(seed):
    (found,) = nonstationary_noise(model_of(bursts(1.0, seed=seed)))
    assert found.nats > 30.0
    assert found.text.endswith("on gyro")
    assert nonstationary_noise(model_of(bursts(1.0, seed=seed) * [1.0, 0.0, 0.0])) == []


def test_heavy_tails_that_lie_anywhere_are_not_unsteady():
    for seed in range(20):
        rng = np.random.default_rng(seed + 900)
        heavy = SD * rng.standard_t(4.0, size=(N, 3))
        assert nonstationary_noise(model_of(heavy, seed=seed)) == []


@pytest.mark.long
def test_steady_noise_is_not_unsteady():
    assert not any(nonstationary_noise(model_of(0.0, seed=seed)) for seed in range(100))


def test_louder_noise_that_stays_is_not_unsteady():
    for seed in range(20):
        louder = 2.0 * SD * np.random.default_rng(seed + 500).normal(size=(N, 3))
        assert nonstationary_noise(model_of(louder, seed=seed)) == []


@pytest.mark.parametrize("steps", [1.5, 4.0, 10.0])
def test_coarse_rounding_is_not_unsteady(steps):
    assert not any(nonstationary_noise(model_of(0.0, rounding=steps * SD, seed=seed)) for seed in range(10))


def test_noise_that_is_not_declared_or_follows_the_rotors_by_itself_is_not_asked():
    assert nonstationary_noise(model_of(bursts(5.0), sigma=None)) == []
    t = np.arange(N) / FS
    rotors = np.repeat(np.where(t % 10.0 < 1.0, 90.0, 10.0)[:, None], 4, axis=1)
    model = model_of(bursts(5.0), rotor_hz=rotors)
    term = NoiseTerm(Hypothesis(forward_models()["gyro_rotor_noise"][-1], (0,)), np.nan)
    assert nonstationary_noise(noise_fitted(with_term(model, term)).model) == []


def walk(seed, size=0.3):
    return np.cumsum(size * SD * np.random.default_rng(seed).normal(size=(N, 3)), axis=0)


def test_a_walk_of_each_axis_is_a_sensors_own():
    for seed in range(10):
        model, _ = wandering(model_of(walk(seed + 50), seed=seed))
        assert misattributed_noise(model) == ()


@pytest.mark.parametrize("seed", range(3))
def test_a_walk_that_the_axes_share_has_one_driver(seed):
    direction = np.array([0.8, -0.6, 0.3])
    model, term = wandering(model_of(walk(seed + 20)[:, :1] * direction, seed=seed))
    driver = hidden_driver(model, 0, term)
    assert driver is not None
    found = np.array(driver.direction)
    assert abs(found @ direction) / np.linalg.norm(direction) == pytest.approx(1.0, abs=0.05)
    assert "hidden scalar driver" in misattributed_noise(model)[0].text


@pytest.mark.parametrize("live", [(1.0, 0.0, 0.0), (1.0, 1.0, 0.0)])
def test_axes_that_read_the_same_as_their_reference_are_driven_by_nothing(live):
    """Compasses of a simulator agree to the last digit; the correlation with such an axis is no number."""
    for seed in range(5):
        model, term = wandering(model_of(walk(seed + 50), seed=seed, live=live))
        assert hidden_driver(model, 0, term) is None


def test_two_axes_that_one_driver_moves_are_told_beside_one_without_a_residual():
    model, term = wandering(model_of(walk(20)[:, :1] * [0.8, -0.6, 0.0], live=(1.0, 1.0, 0.0)))
    driver = hidden_driver(model, 0, term)
    assert driver is not None
    assert abs(np.array(driver.direction) @ [0.8, -0.6, 0.0]) == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize("seed", range(3))
def test_drift_that_comes_back_is_told_from_a_walk(seed):
    noise = np.random.default_rng(seed + 70).normal(size=(3 * N, 3))
    back = 0.5 * SD * lfilter([1.0], [1.0, -0.96], noise, axis=0)
    tripled, term = wandering(model_of(back, seed=seed, n=3 * N))
    assert returns_to_mean(tripled, 0, term)
    plain, own = wandering(model_of(walk(seed + 90), seed=seed))
    assert not returns_to_mean(plain, 0, own)


def test_a_learned_spectrum_is_not_asked_whether_it_swells():
    model = model_of(bursts(5.0))
    views = tuple(
        dataclasses.replace(v, density=np.full((v.count, 3), SD**2), variance=None, dof=500.0)
        for v in model.setting.views
    )
    setting = setting_of(views)
    assert nonstationary_noise(model_without_effects(setting)) == []
