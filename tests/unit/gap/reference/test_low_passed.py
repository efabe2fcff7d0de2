"""A pose's own filter: what it leaves in the band is what ideal sensors read."""

from __future__ import annotations

import numpy as np
import pytest

from mavcal.calib.gap.reference.signals import Signal, bandwidth, low_passed

FS, CUTOFF = 200.0, 16.0
T = np.arange(8000) / FS


def gain(hz):
    wave = np.sin(2.0 * np.pi * hz * T)[:, None]
    middle = slice(2000, 6000)
    return float(np.std(low_passed(Signal(T, wave), CUTOFF).values[middle]) / np.std(wave[middle]))


@pytest.mark.parametrize(("octaves", "least"), [(1.0, 0.99), (0.5, 0.95)])
def test_below_its_edge_nothing_is_taken_away(octaves, least):
    assert least < gain(CUTOFF / 2.0**octaves) < 1.001


def test_it_is_at_half_amplitude_at_the_cutoff_and_nothing_is_left_beyond():
    assert gain(CUTOFF) == pytest.approx(0.5, abs=0.01)
    assert gain(2.0 * CUTOFF) < 1e-3


def test_it_has_no_phase():
    pulse = np.exp(-0.5 * ((T - 20.0) / 0.1) ** 2)[:, None]
    made = low_passed(Signal(T, pulse), CUTOFF).values[:, 0]
    assert T[int(made.argmax())] == pytest.approx(20.0, abs=1.0 / FS)
    assert made == pytest.approx(pulse[:, 0], abs=1e-3)


@pytest.mark.parametrize("seed", range(5))
def test_the_band_ends_where_the_derived_movement_is_more_noise_than_movement(seed):
    rng = np.random.default_rng(seed)
    slow = np.column_stack([np.sin(2.0 * np.pi * hz * T + rng.uniform(0, 6)) for hz in (0.5, 2.0, 7.0)])
    noise = low_passed(Signal(T, rng.standard_normal((len(T), 3))), 80.0).values
    fast = noise - low_passed(Signal(T, noise), 20.0).values
    assert 7.0 < bandwidth(T, slow + fast, slow) < 20.0
