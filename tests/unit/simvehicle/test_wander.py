"""The slow wander of a simulated bias."""

from __future__ import annotations

import numpy as np
import pytest

from mavcal.service.simvehicle.wander import RandomWalk


def test_it_grows_with_the_root_of_time():
    ends = np.array([RandomWalk(np.random.default_rng(seed))(np.array([100.0])) for seed in range(60)])
    assert np.sqrt(np.mean(ends**2)) == pytest.approx(10.0, rel=0.2)


def test_it_is_the_same_however_it_is_read_and_starts_at_zero():
    wander, t = RandomWalk(np.random.default_rng(1)), np.linspace(0.0, 50.0, 501)
    together = wander(t)
    np.testing.assert_array_equal(together, np.vstack([wander(part) for part in np.array_split(t, 7)]))
    assert not together[0].any()


def test_a_restart_of_the_clock_does_not_move_it():
    wander = RandomWalk(np.random.default_rng(2))
    before = wander(np.array([40.0]))
    wander.restart(40.0)
    np.testing.assert_array_equal(wander(np.array([0.0])), before)
