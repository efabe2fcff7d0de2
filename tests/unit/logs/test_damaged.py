"""Samples whose time goes back: the largest part in order is kept, by a search over all parts."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mavcal.calib.logs.damaged import in_order
from mavcal.calib.logs.dataflash.clock import ordered
from mavcal.calib.recording import Channel, Sensor, Stage
from tests.examples import examples


def channel(t):
    values = np.column_stack([np.arange(float(len(t)))] * 3)
    return Channel(Sensor.GYRO, 0, np.asarray(t, dtype=float), values, "rad/s", Stage.RAW, "IMU")


def longest(t):
    """Length of a longest non-decreasing part, by trying all."""
    for size in range(len(t), 0, -1):
        for rows in itertools.combinations(t, size):
            if all(a <= b for a, b in itertools.pairwise(rows)):
                return size
    return 0


@settings(max_examples=examples(40), deadline=None)
@given(t=st.lists(st.integers(0, 6).map(float), max_size=9))
def test_as_many_samples_as_possible_are_kept_in_their_order(t):
    kept, lost = in_order(channel(t), 100.0)
    assert (np.diff(kept.t) >= 0.0).all()
    assert len(kept) == longest(t)
    assert lost == len(t) - len(kept)
    rows = kept.values[:, 0]
    assert (np.diff(rows) > 0.0).all()
    np.testing.assert_array_equal(kept.t, np.asarray(t)[rows.astype(int)])


def test_samples_in_order_are_left_as_they_are():
    whole = channel([0.0, 1.0, 1.0, 2.0])
    kept, lost = in_order(whole, 2.0)
    assert kept is whole
    assert lost == 0


@pytest.mark.parametrize("stamp", [np.nan, np.inf, -0.5, 10.5])
def test_a_stamp_that_cannot_be_costs_only_itself(stamp):
    for at in range(4):
        t = [1.0, 2.0, 3.0]
        t.insert(at, stamp)
        kept, lost = in_order(channel(t), 10.0)
        np.testing.assert_array_equal(kept.t, [1.0, 2.0, 3.0])
        assert lost == 1


@pytest.mark.parametrize("stamp", [0.0, 10.0])
def test_the_ends_of_what_can_be_are_kept(stamp):
    assert in_order(channel(sorted([5.0, stamp])), 10.0)[1] == 0


def test_of_two_neighbours_that_contradict_each_other_the_one_that_is_damaged_goes():
    """A stamp that is far too late takes none of the many after it along, and one that is far too early neither."""
    t = np.arange(20.0)
    late, early = t.copy(), t.copy()
    late[7], early[7] = 500.0, 0.5
    for damaged in (late, early):
        kept, lost = in_order(channel(damaged), 1000.0)
        assert lost == 1
        np.testing.assert_array_equal(kept.t, np.delete(damaged, 7))


def test_nothing_is_in_order():
    kept, lost = in_order(channel([]), 1.0)
    assert (len(kept), lost) == (0, 0)
    kept, lost = in_order(channel([np.nan, np.nan]), 1.0)
    assert (len(kept), lost) == (0, 2)


@settings(max_examples=examples(40), deadline=None)
@given(t=st.lists(st.integers(0, 30).map(float) | st.just(np.nan), max_size=25))
def test_times_of_a_log_that_are_believed_never_go_back(t):
    times = np.array(t, dtype=float)
    keep = ordered(times)
    assert np.isfinite(times[keep]).all()
    assert (np.diff(times[keep]) >= 0.0).all()
    if np.isfinite(times).any():
        assert keep.any()


@pytest.mark.parametrize("stamp", [500.0, 0.5, np.nan])
@pytest.mark.parametrize("at", [2, 7, 18])
def test_one_damaged_time_of_a_log_goes_alone(at, stamp):
    """From the third on: of the first two alone nothing says which is the damaged one."""
    times = 1.0 + np.arange(20.0)
    times[at] = stamp
    np.testing.assert_array_equal(np.flatnonzero(~ordered(times)), [at])


def test_a_time_like_the_one_before_a_wrong_one_is_right():
    assert ordered(np.array([1.0, 5.0, 1.0, 2.0])).tolist() == [True, False, True, True]
    assert ordered(np.array([1.0, 5.0, 0.5, 6.0])).tolist() == [True, True, False, True]
