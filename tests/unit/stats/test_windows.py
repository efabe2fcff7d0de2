from __future__ import annotations

import numpy as np
import pytest

from mavcal.calib.stats.windows import occupied_starts, without_spikes


def test_lone_spikes_are_found_and_movements_are_not():
    rng = np.random.default_rng(1)
    t = np.arange(2000) / 100.0
    values = 3.0 * np.sin(2.0 * np.pi * t)[:, None] * [1.0, -0.5, 0.2] + 0.002 * rng.normal(size=(2000, 3))
    assert without_spikes(values).all()
    spiked = values.copy()
    where = [0, 500, 502, 504, 1200, 1999]
    spiked[where, 1] += 50.0
    assert np.flatnonzero(~without_spikes(spiked)).tolist() == where


def test_a_short_fast_turn_is_no_spike():
    values = np.zeros((500, 3)) + 0.001 * np.random.default_rng(2).normal(size=(500, 3))
    values[200:204, 0] += [6.0, 17.0, 17.0, 5.0]
    values[300:303, 1] += [2.5, 12.0, 11.0]
    values[400:405, 2] += [4.0, 9.0, 12.0, 9.0, 4.0]
    assert without_spikes(values).all()


def test_windows_begin_only_where_there_are_samples():
    t = np.concatenate([np.arange(0.0, 5.0, 0.01), 1e12 + np.arange(0.0, 5.0, 0.01)])
    starts = occupied_starts(t, t[0], t[-1], 0.5)
    assert len(starts) <= 80
    assert starts[0] == 0.0
    assert np.diff(starts[:30]) == pytest.approx(np.full(29, 0.125))
    assert starts[-1] <= t[-1] - 0.5
