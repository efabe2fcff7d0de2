from __future__ import annotations

import numpy as np

from calib.inspection import inspect, summarise
from calib.recording import Channel, Event, Recording, Sensor, Stage


def channel(t, values, sensor=Sensor.ACCEL, quantum=0.0):
    return Channel(sensor, 0, np.asarray(t), np.asarray(values), "m/s2", Stage.RAW, "test", quantum=quantum)


def test_rate_and_gap_are_found():
    t = np.concatenate([np.arange(0, 1, 0.02), np.arange(3, 4, 0.02)])
    summary = summarise(channel(t, np.random.default_rng(1).normal(size=(len(t), 3))))
    assert summary.rate is not None
    np.testing.assert_allclose(summary.rate, 50.0, rtol=1e-6)
    assert summary.n_gaps == 1
    np.testing.assert_allclose([summary.gaps[0].start, summary.gaps[0].length], [0.98, 2.02], atol=1e-9)


def test_backward_time_and_bad_numbers_are_counted():
    values = np.ones((5, 3))
    values[2, 1] = np.nan
    summary = summarise(channel([0, 1, 2, 1.5, 3], values))
    assert (summary.backward_steps, summary.not_finite) == (1, 1)
    assert summary.mean == (1.0, 1.0, 1.0)


def test_a_column_without_a_number_has_no_mean():
    assert summarise(channel([0, 1], [[np.nan, 0, 0], [np.nan, 0, 0]])).mean[0] is None


def test_a_stuck_sensor_is_named():
    t = np.arange(0, 10, 0.02)
    values = np.random.default_rng(2).normal(size=(len(t), 3))
    values[100:300] = values[100]
    warnings = inspect(Recording((channel(t, values),)))["warnings"]
    assert any("stuck" in w and "accel[0]" in w for w in warnings)


def test_a_truncated_stream_that_repeats_is_not_called_stuck():
    t = np.arange(0, 10, 0.02)
    assert inspect(Recording((channel(t, np.zeros((len(t), 3)), quantum=0.01),)))["warnings"] == []


def test_an_empty_recording_is_described():
    document = inspect(Recording((), events=(Event(-np.inf, "text", "hello"),)))
    assert document["channels"] == []
    assert document["duration"] == 0.0
    assert document["events"][0]["t"] is None


def test_one_sample_is_enough():
    assert summarise(channel([1.0], [[1, 2, 3]])).rate is None
