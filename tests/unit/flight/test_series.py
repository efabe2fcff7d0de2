"""Series for pictures keep what stands out."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from mavcal.calib.flight.series import POINTS, series_of
from mavcal.calib.recording import Channel, Recording, Sensor, Stage


def channel(values: np.ndarray, sensor: Sensor = Sensor.ACCEL, source: str = "IMU") -> Channel:
    return Channel(sensor, 0, 5.0 + 0.01 * np.arange(len(values)), values, "m/s2", Stage.CORRECTED, source)


@given(st.integers(0, 49_999), st.integers(0, 2), st.sampled_from([-50.0, 50.0]))
def test_a_single_spike_is_never_thinned_away(row, axis, height):
    values = np.random.default_rng(1).normal(0.0, 0.1, (50_000, 3))
    values[row, axis] = height
    (series,) = series_of(Recording((channel(values),)))
    assert height in series.values[axis]
    assert len(series.t) <= POINTS + 6
    assert np.all(np.diff(series.t) > 0)
    assert series.t[0] >= 0.0


def test_a_short_one_is_whole_and_the_densest_message_is_shown():
    few, many = channel(np.ones((10, 3)), source="slow"), channel(np.ones((40, 3)), source="fast")
    (series,) = series_of(Recording((few, many)))
    assert series.source == "fast"
    assert series.values.shape == (3, 40)


def test_what_is_not_finite_stays_so_and_nothing_gives_nothing():
    values = np.full((5000, 3), np.nan)
    (series,) = series_of(Recording((channel(values),)))
    assert np.isnan(series.values).all()
    assert series_of(Recording(())) == ()
