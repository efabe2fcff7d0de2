"""Scales: round ticks, limits that hold the data, lines that end at the edge."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavcal.calib.drawing.scale import limits_of, runs_inside, shares, thinned, ticks


def test_thinning_keeps_the_peaks() -> None:
    values = np.zeros(100_000)
    values[54_321] = 7.0
    t, kept = thinned(np.arange(100_000.0), values)
    assert len(t) <= 620
    assert kept.max() == 7.0
    assert (np.diff(t) > 0).all()


@pytest.mark.parametrize(
    ("limits", "log", "labels"),
    [((0.0, 10.0), False, ["0", "2", "4", "6", "8", "10"]), ((1.0, 1000.0), True, ["1", "10", "100", "1000"]),
     ((0.8, 3.0), True, ["1", "2"]), ((0.2, 0.31), True, ["0.2"])],
)  # fmt: skip
def test_ticks_are_round(limits: tuple[float, float], log: bool, labels: list[str]) -> None:
    assert [label for _, label in ticks(limits, log=log)] == labels


def test_limits_are_never_empty() -> None:
    for values in ([], [np.nan], [3.0], [0.0], [-1.0, 5.0]):
        for log in (False, True):
            low, high = limits_of(values, log=log)
            assert low < high


def test_a_share_is_where_a_number_lies() -> None:
    assert shares([0.0, 5.0, 20.0], (0.0, 10.0), log=False).tolist() == [0.0, 0.5, 2.0]
    assert shares([1.0, 10.0, 100.0], (1.0, 100.0), log=True).tolist() == [0.0, 0.5, 1.0]
    low, gone = shares([0.0, np.nan], (1.0, 100.0), log=True)
    assert low == 0.0
    assert np.isnan(gone)


def runs(*points: tuple[float, float]) -> list[list[tuple[float, float]]]:
    return runs_inside(*np.array(points).T)


def test_a_line_ends_at_the_edge_and_goes_on_where_it_comes_back() -> None:
    assert runs((0.0, 0.5), (1.0, 0.5)) == [[(0.0, 0.5), (1.0, 0.5)]]
    assert runs((0.0, 0.5), (0.5, 1.5), (1.0, 0.5)) == [[(0.0, 0.5), (0.25, 1.0)], [(0.75, 1.0), (1.0, 0.5)]]
    assert runs((-1.0, -1.0), (2.0, 2.0)) == [[(0.0, 0.0), (1.0, 1.0)]]
    assert runs((0.0, 1.5), (1.0, 1.5)) == []
    assert runs((-1.0, 0.5), (0.5, 2.5)) == []


def test_a_line_has_a_gap_where_a_number_is_not_finite() -> None:
    nan = float("nan")
    found = runs((0.0, 0.0), (0.1, 0.1), (0.2, nan), (0.3, 0.3), (0.4, 0.4))
    assert found == [[(0.0, 0.0), (0.1, 0.1)], [(0.3, 0.3), (0.4, 0.4)]]


@given(st.lists(st.tuples(st.floats(-9, 9), st.floats(-9, 9)), min_size=2, max_size=9))
def test_no_line_leaves_the_axes(points: list[tuple[float, float]]) -> None:
    for run in runs(*points):
        assert len(run) > 1
        assert np.min(run) > -1e-9
        assert np.max(run) < 1.0 + 1e-9
