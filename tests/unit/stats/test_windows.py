from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mavcal.calib.stats.windows import finite_rows, occupied_starts, row_of, window_statistics, without_spikes
from tests.examples import examples


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


def irregular(seed: int, n: int = 400) -> tuple[np.ndarray, np.ndarray]:
    """Samples of a trend with noise at times that no grid has."""
    rng = np.random.default_rng(seed)
    t = np.cumsum(rng.uniform(0.002, 0.05, n))
    return t, np.outer(t, [0.5, -2.0, 0.0]) + rng.normal(size=(n, 3)) * [0.1, 1.0, 3.0] + [0.0, 0.0, -9.8]


@given(seed=st.integers(0, 1000), length=st.floats(0.4, 2.0))
@settings(max_examples=examples(20), deadline=None)
def test_every_window_has_the_mean_and_line_that_numpy_fits(seed, length):
    t, x = irregular(seed)
    starts = np.arange(t[0], t[-1] - length, length / 3.0)
    windows = window_statistics(t, x, t[0], starts, length)
    for k, start in enumerate(starts):
        inside = (t >= start) & (t < start + length)
        slope, residual, *_ = np.polyfit(t[inside] - start, x[inside], 1, full=True)
        assert windows.n[k] == inside.sum()
        assert windows.mean[k] == pytest.approx(x[inside].mean(axis=0))
        assert windows.change[k] == pytest.approx(slope[0] * length, rel=1e-6, abs=1e-9)
        assert windows.scatter[k] == pytest.approx(np.sqrt(residual.sum() / (inside.sum() - 2)), rel=1e-6)


def test_a_window_takes_its_first_instant_and_leaves_its_last_to_the_next():
    t = np.arange(0.0, 2.0, 0.125)
    x = np.column_stack([t, t, t])
    windows = window_statistics(t, x, 0.0, np.array([0.5, 1.0]), 0.5)
    assert windows.n.tolist() == [4, 4]
    assert windows.mean[:, 0].tolist() == [0.6875, 1.1875]
    assert windows.change == pytest.approx(np.full((2, 3), 0.5))
    assert windows.scatter == pytest.approx([0.0, 0.0], abs=1e-6)


def test_a_window_does_not_depend_on_what_lies_outside_of_it():
    t, x = irregular(3)
    starts = np.array([2.0, 2.5])
    whole = window_statistics(t, x, 2.0, starts, 1.0)
    near = (t > 1.5) & (t < 4.0)
    other = x + np.where((t < 2.0) | (t >= 3.5), 1e3, 0.0)[:, None]
    for found in (window_statistics(t[near], x[near], 2.0, starts, 1.0), window_statistics(t, other, 2.0, starts, 1.0)):
        for one, two in zip(found, whole, strict=True):
            np.testing.assert_array_equal(one, two)


@pytest.mark.parametrize(
    ("first", "last", "counted"),
    [
        (1.0, 1.99, True),
        (1.25, 1.75, True),  # a quarter of the window at either end
        (1.27, 1.99, False),
        (1.0, 1.73, False),
    ],
)
def test_a_window_counts_if_less_than_a_quarter_is_missing_at_either_end(first, last, counted):
    t = np.concatenate([[0.0, 0.1], np.linspace(first, last, 20), [2.5, 2.6]])
    found = window_statistics(t, np.ones((len(t), 3)), 0.0, np.array([1.0]), 1.0)
    assert found.n[0] == (20 if counted else 0)


def test_a_window_without_samples_is_empty_and_not_its_neighbour():
    t = np.concatenate([np.arange(0.0, 1.0, 0.1), np.arange(5.0, 6.0, 0.1)])
    found = window_statistics(t, np.full((20, 3), 7.0), 0.0, np.array([0.0, 2.0, 9.0]), 1.0)
    assert found.n.tolist() == [10, 0, 0]
    assert found.scatter.tolist() == [pytest.approx(0.0, abs=1e-6), 0.0, 0.0]


def test_one_row_of_windows_is_that_window_alone():
    t, x = irregular(5)
    windows = window_statistics(t, x, 0.0, np.array([1.0, 2.0, 3.0]), 0.5)
    second = row_of(windows, 1)
    assert (second.n, second.scatter) == (windows.n[1], windows.scatter[1])
    assert second.mean.tolist() == windows.mean[1].tolist()
    assert row_of(None, 1) is None


def test_windows_begin_a_quarter_apart_and_end_with_the_recording():
    t = np.arange(0.0, 3.0, 1.0 / 64.0)
    assert occupied_starts(t, 0.5, 2.5, 1.0).tolist() == [0.5, 0.75, 1.0, 1.25, 1.5]
    assert occupied_starts(t, 0.0, 0.99, 1.0).tolist() == []


def test_a_row_counts_as_finite_if_all_of_it_is():
    values = np.array([[1.0, 2.0], [np.nan, 2.0], [1.0, np.inf], [-np.inf, np.nan], [0.0, 0.0]])
    assert finite_rows(values).tolist() == [True, False, False, False, True]
    assert finite_rows(np.zeros((0, 3))).tolist() == []


def test_fewer_than_nine_rows_show_no_spike():
    values = np.zeros((8, 3))
    values[4] = 100.0
    assert without_spikes(values).all()
    longer = np.zeros((9, 3))
    longer[4] = 100.0
    assert np.flatnonzero(~without_spikes(longer)).tolist() == [4]


@given(scale=st.floats(1e-6, 1e6), shift=st.floats(-10.0, 10.0))
@settings(max_examples=examples(20), deadline=None)
def test_spikes_are_the_same_in_every_unit(scale, shift):
    values = np.random.default_rng(9).normal(size=(300, 2)) * [1.0, 0.1]
    values[[40, 200], 1] += [12.0, -30.0]
    found = np.flatnonzero(~without_spikes((values + shift) * scale)).tolist()
    assert found == [40, 200]


@pytest.mark.parametrize(("size", "kept"), [(67.0, True), (69.0, False)])
def test_a_spike_is_far_beyond_what_the_samples_around_change_by(size, kept):
    """Samples that go up and down by two: four times that and thirty times that are 68 about the lower level."""
    values = np.where(np.arange(200) % 2, 1.0, -1.0)[:, None]
    values[101] = size - 1.0
    assert without_spikes(values).all() == kept
