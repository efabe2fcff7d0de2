"""Bets on what is left over: white noise wins none of them, heavy tails neither; bursts and combs do."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mavcal.calib.gap.model.joint import setting_of
from mavcal.calib.gap.model.noise_fit import model_without_effects
from mavcal.calib.gap.model.views import views_of
from mavcal.calib.gap.problem import GapProblem, ReferenceInfo, ReferenceKind, Trace
from mavcal.calib.gap.unknown.discrepancy import BURSTS, WAVES, bets_of, burst_bet, log_odds, wave_bet, winning_bets
from mavcal.calib.recording import Sensor

G, FS, N, SD = Sensor.GYRO, 50.0, 3000, 0.003


def bets(change, *, seed=0, **over):
    t = np.arange(N) / FS
    measured = SD * np.random.default_rng(seed).normal(size=(N, 3)) + change
    trace = Trace(G, (0,), t, measured, np.zeros((N, 3)), np.ones(N, dtype=bool), **{"sigma": np.full(3, SD), **over})
    setting = setting_of(views_of(GapProblem((trace,), ReferenceInfo(ReferenceKind.SIM), N / FS), {}, {}))
    return bets_of(model_without_effects(setting))


def rare_bursts(seed=3, times=1.0, lasts=0.4, part=0.1):
    """Louder for a moment now and then, at moments that nothing foretells."""
    rng = np.random.default_rng(seed)
    length = round(lasts * FS)
    on = np.zeros(N, dtype=bool)
    for start in rng.integers(0, N - length, round(part * N / length)):
        on[start : start + length] = True
    return times * SD * on[:, None] * rng.normal(size=(N, 3))


def pulses(hz=0.7, of=0.12, size=0.8):
    t = np.arange(N) / FS
    return size * SD * ((t * hz) % 1.0 < of)[:, None] * [1.0, 0.0, 0.0]


@pytest.mark.long
def test_white_noise_wins_less_than_a_draw_in_the_mean():
    odds = [log_odds(bets(0.0, seed=seed)) for seed in range(40)]
    assert np.mean(np.exp(odds)) < 1.0
    assert max(odds) < math.log(1.0 / 2e-3)
    assert not any(winning_bets(bets(0.0, seed=seed)) for seed in range(5))


@pytest.mark.long
def test_heavy_tails_that_lie_anywhere_win_nothing():
    for seed in range(6):
        heavy = SD * np.random.default_rng(seed + 900).standard_t(3.0, size=(N, 3))
        assert winning_bets(bets(heavy, seed=seed)) == []


@pytest.mark.long
def test_samples_that_are_loud_on_all_axes_at_once_are_no_bursts():
    for seed in range(6):
        rng = np.random.default_rng(seed)
        loud = np.where(rng.random((N, 1)) < 0.05, 3.0, 1.0)
        assert burst_bet((loud * rng.normal(size=(N, 3))).T) < 0.0


def test_noise_of_another_size_is_no_burst():
    assert burst_bet(1.2 * np.random.default_rng(1).normal(size=(3, N))) < 0.0


@pytest.mark.parametrize("seed", [3, 4, 5])
def test_rare_bursts_of_unknown_moments_are_found(seed):
    (found,) = winning_bets(bets(rare_bursts(seed)))
    assert found.text == f"{BURSTS} on gyro"
    assert found.sensor is G


@pytest.mark.parametrize("hz", [0.7, 1.313])
def test_a_pulse_that_comes_again_is_found_with_its_frequency(hz):
    (found,) = winning_bets(bets(pulses(hz)))
    assert found.text.startswith(WAVES)
    told = float(found.text.split()[-4])
    assert min(abs(told * k / hz - 1.0) for k in (1, 2)) < 0.01


def test_a_wave_alone_is_a_comb_too():
    t = np.arange(N) / FS
    wave = 0.3 * np.sin(2.0 * np.pi * 3.21 * t + 0.4)
    nats, periods = wave_bet(np.random.default_rng(2).normal(size=(3, N)) + wave)
    assert nats > 20.0
    assert periods / t[-1] == pytest.approx(3.21, rel=2e-3)


def test_noise_that_was_learned_is_not_held_against_anything():
    learned = {"sigma": None, "psd": np.full((2, 3), SD**2), "psd_hz": np.array([0.0, FS / 2])}
    assert bets(rare_bursts(), **learned) == ()
    assert log_odds(()) is None


def test_coarse_readings_are_left_out():
    step = 4.0 * SD
    rounded = np.round(SD * np.random.default_rng(0).normal(size=(N, 3)) / step) * step
    assert bets(rounded - SD * np.random.default_rng(0).normal(size=(N, 3))) == ()


def test_slow_waves_of_long_series_keep_their_number_of_periods():
    n = 50_000
    wave = 0.1 * np.sin(2.0 * np.pi * 37.0 * np.arange(n) / n)
    nats, periods = wave_bet(np.random.default_rng(4).normal(size=(3, n)) + wave)
    assert nats > 20.0
    assert periods == pytest.approx(37.0, rel=0.01)
