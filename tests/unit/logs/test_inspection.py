from __future__ import annotations

import numpy as np

from mavcal.calib.logs.inspection import inspect, summarise
from mavcal.calib.recording import Channel, Event, Identity, ParameterTimeline, Recording, Sensor, Stage


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


def test_a_pause_of_the_log_is_said_once_and_is_no_stuck_sensor():
    t = np.concatenate([np.arange(0, 10, 0.02), np.arange(60, 70, 0.02)])
    rng = np.random.default_rng(2)
    both = [
        channel(t, rng.normal(size=(len(t), 3))),
        channel(t[::5], rng.normal(size=(len(t[::5]), 3)), sensor=Sensor.GYRO),
    ]
    document = inspect(Recording(tuple(both)))
    assert document["warnings"] == ["the log pauses once, for 50.0 s at 10.0 s: it may record while armed only"]
    (pause,) = document["pauses"]
    assert 9.9 < pause["start"] < 10.0
    assert 49.9 < pause["length"] < 50.1


def test_a_channel_that_stops_alone_is_no_pause_of_the_log():
    t = np.arange(0, 70, 0.02)
    rng = np.random.default_rng(3)
    part = (t < 10) | (t > 60)
    both = [
        channel(t, rng.normal(size=(len(t), 3))),
        channel(t[part], rng.normal(size=(part.sum(), 3)), sensor=Sensor.GYRO),
    ]
    document = inspect(Recording(tuple(both)))
    assert document["pauses"] == []
    assert any(w.startswith("gyro[0]") and "1 gaps" in w for w in document["warnings"])


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


def test_what_a_vehicle_lacks_is_said():
    rows = channel(np.arange(0, 1, 0.02), np.random.default_rng(3).normal(size=(50, 3)))
    bare = inspect(Recording((rows,), identity=Identity(autopilot="px4")))["missing"]
    assert any("no gyroscope" in text for text in bare)
    assert any("no compass" in text for text in bare)
    assert any("no parameters" in text for text in bare)
    told = ParameterTimeline.constant({"A": 1.0})
    assert not any("parameters" in t for t in inspect(Recording((rows,), told, identity=Identity("px4")))["missing"])
    assert inspect(Recording((), identity=Identity("px4")))["missing"] == [
        "no accelerometer, gyroscope or compass was recorded: there is nothing to calibrate"
    ]


def test_armed_spans_counts_lengths_and_repeats():
    values = np.array([[3.0, 4.0, 0.0], [3.0, 4.0, 0.0], [0.0, 0.0, 7.0]])
    events = (Event(0.5, "armed", ""), Event(1.0, "disarmed", ""), Event(1.5, "armed", ""), Event(1.6, "drop", "x"))
    document = inspect(Recording((channel([0, 1, 2], values),), events=events))
    assert document["armed"] == [{"start": 0.5, "end": 1.0}, {"start": 1.5, "end": 2.0}]
    assert (document["counts"]["drop"], document["counts"]["reboot"]) == (1, 0)
    (only,) = document["channels"]
    assert only["repeated"] == 1
    np.testing.assert_allclose(only["norm"], [17 / 3, np.std([5, 5, 7])])
