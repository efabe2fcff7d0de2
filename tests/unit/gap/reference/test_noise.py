from __future__ import annotations

import numpy as np
import pytest

from mavcal.calib.gap.problem import Trace
from mavcal.calib.gap.reference.channels import filter_gain
from mavcal.calib.gap.reference.noise import learned_spectrum, pooled, with_noise
from mavcal.calib.gap.reference.signals import grid_of
from mavcal.calib.gap.reference.simulator import mean_deviations, with_simulated_offset
from mavcal.calib.recording import Sensor

from .test_recorded import channel


def trace(residual, fs=100.0, **over):
    n = len(residual)
    ideal = np.tile([0.0, 0.0, -9.8], (n, 1))
    return Trace(Sensor.ACCEL, (0,), np.arange(n) / fs, ideal + residual, ideal, np.ones(n, dtype=bool), **over)


def white(n=8000, sd=0.02, seed=0):
    return sd * np.random.default_rng(seed).standard_normal((n, 3))


def walk(n=8000, sd=0.002, seed=1):
    return np.cumsum(white(n, sd, seed), axis=0)


def at(found, hz):
    return np.array([np.interp(hz, found.psd_hz, column) for column in found.psd.T])


def test_white_noise_is_a_number():
    found = with_noise(trace(white(seed=5)), learned_spectrum(trace(white())), None)
    assert found.psd is None
    assert found.sigma == pytest.approx(0.02, rel=0.03)
    assert found.sigma_dof == pytest.approx(8000, rel=0.01)


def test_a_walk_is_a_spectrum():
    found = with_noise(trace(white()), learned_spectrum(trace(white() + walk())), None)
    w = 2.0 * np.pi * 0.5 / 100.0
    assert at(found, 0.5).mean() == pytest.approx(0.02**2 + 0.002**2 / w**2, rel=0.35)  # of 24 squares an axis
    assert at(found, 45.0) == pytest.approx(0.02**2, rel=0.2)


def test_noise_of_another_rate_keeps_its_density():
    found = with_noise(trace(white(), fs=200.0), learned_spectrum(trace(white() + walk())), None)
    assert found.sigma is None
    assert at(found, 40.0) == pytest.approx(2.0 * 0.02**2, rel=0.2)


def test_noise_behind_a_filter_is_brought_before_it():
    n, fs, cutoff = 40000, 400.0, 20.0
    hz = np.fft.rfftfreq(n, 1.0 / fs)[:, None]
    filtered = np.fft.irfft(np.fft.rfft(white(n), axis=0) * filter_gain(hz, cutoff), n, axis=0)
    nominal = learned_spectrum(trace(filtered, fs, low_pass_hz=cutoff))
    found = with_noise(trace(white(n), fs), nominal, None)
    assert at(found, 60.0) == pytest.approx(0.02**2, rel=0.25)
    same = with_noise(trace(white(n), fs, low_pass_hz=cutoff), nominal, None)
    assert at(same, 60.0) == pytest.approx(0.02**2 * filter_gain(60.0, cutoff) ** 2, rel=0.25)


def test_the_sensors_own_noise_is_half_of_a_difference():
    total, own = learned_spectrum(trace(white() + walk())), learned_spectrum(trace(np.sqrt(2.0) * white(seed=9)))
    found = with_noise(trace(white()), total, own)
    assert found.sigma == pytest.approx(0.02, rel=0.03)
    assert found.own_psd[0] == pytest.approx(0.02**2, rel=0.9)
    assert (found.psd[5] > 10.0 * found.own_psd[5]).all()


def test_digits_that_do_not_change_have_the_noise_of_their_rounding():
    still = trace(np.zeros((8000, 3)), quantum=0.1)
    assert with_noise(still, learned_spectrum(still), None).sigma == pytest.approx(0.1 / np.sqrt(12.0))


def test_several_recordings_are_averaged():
    both = pooled([learned_spectrum(trace(white(sd=0.01))), learned_spectrum(trace(white(sd=0.03)))])
    assert both.sigma == pytest.approx(np.sqrt(0.5 * (0.01**2 + 0.03**2)), rel=0.05)


def test_a_simulators_offset_is_part_of_it():
    offset = np.array([0.05, 0.0, -0.1])
    found = mean_deviations([trace(white() + offset)])
    against = with_simulated_offset(trace(white(seed=3) + offset), found)
    assert against.residual.mean(axis=0) == pytest.approx(np.zeros(3), abs=1e-3)
    assert found[Sensor.ACCEL, 0][1] == 0.0


@pytest.mark.parametrize("stamp", [0.001, 0.0])
def test_a_grid_of_stamps_in_whole_milliseconds(stamp):
    t = np.arange(4000) / 400.0
    t = np.floor(t / stamp) * stamp if stamp else t
    rows = np.ones(len(t), dtype=bool)
    rows[1000:1010] = False
    grid = grid_of(channel(Sensor.GYRO, t[rows], np.zeros((int(rows.sum()), 3))))
    assert len(grid.t) == 4000
    assert (~grid.observed).sum() == 10
    assert grid.t[1] - grid.t[0] == pytest.approx(0.0025, rel=1e-4)


def test_a_long_hole_makes_two_recordings_of_which_the_longer_counts():
    t = np.concatenate([np.arange(0.0, 10.0, 0.01), np.arange(100.0, 130.0, 0.01)])
    grid = grid_of(channel(Sensor.GYRO, t, np.zeros((len(t), 3))))
    assert grid.cut
    assert grid.t[0] == pytest.approx(100.0, abs=1e-6)


def test_noise_that_ceases_is_not_called_white():
    ceasing = white()
    ceasing[5000:] *= 0.7
    assert not learned_spectrum(trace(ceasing)).white
    assert np.mean([learned_spectrum(trace(white(2000, seed=s))).steady for s in range(200)]) > 0.99


def test_many_holes_do_not_forbid_to_learn():
    holed = trace(white())
    seen = np.arange(len(holed.t)) % 1000 < 800
    found = learned_spectrum(Trace(Sensor.ACCEL, (0,), holed.t, holed.measured, holed.ideal, seen))
    assert found.sigma == pytest.approx(0.02, rel=0.03)
    assert found.dof.sum() == pytest.approx(seen.sum(), abs=2)
