"""Numbers of a channel and of a recording, each by samples that have them."""

from __future__ import annotations

import dataclasses
import json
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mavcal.calib.logs.inspection import MOST_GAPS_LISTED, Gap, constant_run, inspect, pauses, summarise
from mavcal.calib.recording import (
    Channel,
    Event,
    Identity,
    Oddity,
    OddSamples,
    ParameterTimeline,
    Recording,
    Sensor,
    Stage,
)
from tests.examples import examples

T = np.arange(0.0, 20.0, 0.02)
NOISE = np.random.default_rng(1).normal(size=(len(T), 3))


def channel(t=T, values=None, sensor=Sensor.ACCEL, instance=0, *, stage=Stage.RAW, quantum=0.0, source="IMU"):
    t = np.asarray(t, dtype=float)
    made = NOISE[: len(t)] if values is None else np.asarray(values, dtype=float)
    return Channel(sensor, instance, t, made, "m/s2", stage, source, quantum=quantum)


def held(start, end, *, t=T):
    """Noise that stands still from one row to another."""
    values = NOISE[: len(t)].copy()
    values[start:end] = values[start]
    return channel(t, values)


@settings(max_examples=examples(20), deadline=None)
@given(factor=st.floats(-5.0, 5.0), shift=st.floats(-100.0, 100.0))
def test_ranges_and_means_move_with_the_values(factor, shift):
    plain, moved = summarise(channel()), summarise(channel(values=factor * NOISE + shift))
    for axis in range(3):
        ends = sorted(factor * end + shift for end in (plain.least[axis], plain.most[axis]))
        assert [moved.least[axis], moved.most[axis]] == pytest.approx(ends, abs=1e-9)
    assert moved.mean[1] == pytest.approx(factor * plain.mean[1] + shift, abs=1e-9)


def test_the_length_of_a_vector_has_a_mean_and_a_spread():
    values = np.tile([3.0, 4.0, 0.0], (10, 1))
    values[5:] *= 2.0
    assert summarise(channel(T[:10], values)).norm == (pytest.approx(7.5), pytest.approx(2.5))
    values[3] = np.nan
    assert summarise(channel(T[:10], values)).norm[0] == pytest.approx((4 * 5.0 + 5 * 10.0) / 9)
    assert summarise(channel(T[:2], np.full((2, 3), np.nan))).norm is None
    warm = Channel(Sensor.TEMPERATURE, 0, T[:3], np.array([1.0, 2.0, 3.0]), "degC", Stage.RAW, "IMU")
    assert summarise(warm).norm is None


@pytest.mark.parametrize(("step", "gaps"), [(0.098, 0), (0.102, 1)])
def test_five_periods_are_a_gap(step, gaps):
    t = np.concatenate([T[:50], T[49] + step + T[:50]])
    found = summarise(channel(t))
    assert found.n_gaps == len(found.gaps) == gaps


def test_gaps_beyond_the_listed_ones_are_counted():
    t = np.concatenate([T[:30] + k * 2.0 for k in range(MOST_GAPS_LISTED + 5)])
    values = np.random.default_rng(2).normal(size=(len(t), 3))
    found = summarise(channel(t, values))
    assert (found.n_gaps, len(found.gaps)) == (MOST_GAPS_LISTED + 4, MOST_GAPS_LISTED)


def test_a_single_sample_or_a_time_that_stands_still_has_no_rate():
    for t in ([1.0], [1.0, 1.0, 1.0]):
        found = summarise(channel(t))
        assert (found.rate, found.n_gaps, found.longest_constant) == (None, 0, 0.0)


@settings(max_examples=examples(20), deadline=None)
@given(start=st.integers(0, 400), rows=st.integers(2, 300))
def test_the_longest_run_of_equal_samples_is_found_with_its_time(start, rows):
    found = constant_run(held(start, start + rows))
    assert found.start == pytest.approx(T[start])
    assert found.length == pytest.approx(T[start + rows - 1] - T[start])


def test_a_run_ends_at_a_gap_and_where_one_column_moves():
    t = np.concatenate([T[:100], T[:100] + 10.0])
    values = np.ones((200, 3))
    assert constant_run(channel(t, values)).length == pytest.approx(T[99])
    values[50, 2] = 2.0
    assert constant_run(channel(T[:100], values[:100])) == Gap(T[0], pytest.approx(T[49]))
    assert constant_run(channel()) is None
    assert constant_run(channel([0.0])) is None


def test_equal_neighbours_are_counted():
    assert summarise(held(10, 30)).repeated == 19
    assert summarise(channel()).repeated == 0


def warned(*channels, **more):
    return inspect(Recording(channels, **more))["warnings"]


@pytest.mark.parametrize(("rows", "stuck"), [(45, False), (60, True)])
def test_a_second_of_equal_values_is_a_stuck_sensor(rows, stuck):
    found = [w for w in warned(held(100, 100 + rows)) if "stuck" in w]
    assert bool(found) == stuck


def test_a_slow_or_coarse_channel_may_stand_still_for_longer():
    slow = np.arange(0.0, 40.0, 0.5)
    for rows, stuck in ((9, False), (14, True)):
        values = np.random.default_rng(2).normal(size=(len(slow), 3))
        values[10 : 10 + rows] = values[10]
        assert any("stuck" in w for w in warned(channel(slow, values))) == stuck
        coarse = channel(slow, values, quantum=0.1)
        assert not any("stuck" in w for w in warned(coarse))
        slow_current = Channel(Sensor.CURRENT, 0, slow, values[:, 0], "A", Stage.RAW, "BAT")
        assert not any("stuck" in w for w in warned(slow_current, channel()))


def test_damage_of_a_channel_is_told_in_numbers():
    t, values = T.copy(), NOISE.copy()
    t[50], values[7, 1] = t[48], np.nan
    lost, back = warned(channel(t, values, instance=1, source="RAW_IMU"))
    assert all(said.startswith("accel[1] of RAW_IMU") for said in (lost, back))
    assert " 1 of" in lost
    assert "1000 samples" in lost
    assert " 1 times" in back


def test_gaps_of_one_channel_are_told_with_the_longest():
    rows = np.r_[0:250, 275:500, 600:1000]
    (said,) = warned(channel(T[rows], NOISE[rows]), channel(sensor=Sensor.GYRO))
    assert said.startswith("accel[0] ")
    assert all(token in said for token in (" 2 gaps", " 2.02 s", " 9.98 s"))


@pytest.mark.parametrize(("length", "paused"), [(0.95, False), (1.1, True)])
def test_a_second_without_any_sample_is_a_pause(length, paused):
    t = np.concatenate([T[:200], T[199] + length + T[:200]])
    assert bool(pauses(Recording((channel(t),)))) == paused
    slow = np.concatenate([np.arange(20) * 0.2, 3.8 + length + np.arange(20) * 0.2])
    assert not pauses(Recording((channel(slow),)))


def test_a_pause_is_as_long_as_no_channel_has_a_sample():
    t = np.concatenate([T[:200], T[:200] + 14.0])
    slow = np.array([0.0, 2.0, 6.0, 13.0, 15.0])
    mag, gyro = channel(slow, sensor=Sensor.MAG), channel([0.0, 5.0, 13.5, 15.0], sensor=Sensor.GYRO)
    for others in ((mag,), (mag, gyro), (gyro, mag)):
        (found,) = pauses(Recording((channel(t), *others)))
        assert (found.start, found.length) == (6.0, pytest.approx(7.0))
    assert pauses(Recording(())) == ()


def spans(*events, end=19.0):
    said = tuple(Event(t, kind, "") for t, kind in events)
    return inspect(Recording((channel(T[end + 1e-9 >= T]),), events=said))["armed"]


@pytest.mark.parametrize(
    ("events", "armed"),
    [
        ([(2.0, "armed"), (5.0, "disarmed")], [(2.0, 5.0)]),
        ([(2.0, "armed")], [(2.0, 19.0)]),
        ([(2.0, "disarmed")], []),
        ([(2.0, "armed"), (3.0, "armed"), (5.0, "disarmed"), (6.0, "disarmed")], [(2.0, 5.0)]),
        ([(2.0, "armed"), (5.0, "disarmed"), (7.0, "armed"), (8.0, "disarmed")], [(2.0, 5.0), (7.0, 8.0)]),
        ([(25.0, "armed")], [(25.0, 25.0)]),
    ],
)
def test_armed_spans_end_with_the_recording_at_the_latest(events, armed):
    assert [(s["start"], pytest.approx(s["end"])) for s in spans(*events)] == armed


def missing(*channels, autopilot="ardupilot", parameters=None, events=()):
    timeline = ParameterTimeline.constant({"A": 1.0} if parameters is None else parameters)
    made = Recording(channels, identity=Identity(autopilot), parameters=timeline, events=events)
    return inspect(made)["missing"]


def test_what_a_log_lacks_is_told_unless_it_is_a_table():
    every = [channel(sensor=s) for s in (Sensor.ACCEL, Sensor.GYRO, Sensor.MAG)]
    assert missing(*every) == []
    assert missing(*every[:2]) == ["no compass was recorded: no magnetometer can be calibrated from it"]
    assert missing(every[0], every[2]) == ["no gyroscope was recorded"]
    assert missing(*every[1:])[0].startswith("no accelerometer was recorded")
    assert missing(*every, parameters={})[0].startswith("no parameters were recorded")
    assert missing(every[0], autopilot=None, parameters={}) == []
    nothing = ["no accelerometer, gyroscope or compass was recorded: there is nothing to calibrate"]
    assert missing(channel(sensor=Sensor.TEMPERATURE, values=NOISE[:, :1])) == nothing
    assert missing(channel(stage=Stage.DEBIASED)) == nothing


def test_a_dead_sensor_is_not_missing():
    dead = (Event(0.0, "dead", "compass 1 reads zero", OddSamples(Oddity.ZERO, Sensor.MAG, 0, 9, 9)),)
    pair = channel(), channel(sensor=Sensor.GYRO)
    assert missing(*pair, events=dead) == []


def test_events_are_counted_by_kind_and_told_where_they_are_warnings():
    events = tuple(
        Event(1.0, kind, f"about {kind}")
        for kind in ("reboot", "gap", "drop", "clipping", "damage", "left_out", "dead", "text")
    )
    document = inspect(Recording((channel(), channel(sensor=Sensor.GYRO)), events=(*events, events[0])))
    assert document["counts"] == {"reboot": 2, "gap": 1, "drop": 1, "clipping": 1, "damage": 1, "left_out": 1}
    assert document["warnings"] == ["about clipping", "about damage", "about left_out", "about dead"]


def test_a_document_is_json_whatever_was_recorded():
    odd = channel(T[:3], [[np.nan, np.inf, 1.0]] * 3)
    timeline = ParameterTimeline.constant({"A": 1.0})
    events = (Event(math.nan, "text", "when nobody knows"),)
    made = Recording((odd, channel([], np.zeros((0, 3)), Sensor.GYRO)), parameters=timeline, events=events)
    document = json.loads(json.dumps(inspect(made), allow_nan=False))
    assert document["events"][0]["t"] is None
    assert len(document["channels"]) == 1
    assert document["channels"][0]["least"][0] is None
    assert inspect(Recording(()))["duration"] == 0.0
    with_reference = dataclasses.replace(Recording((channel(),)), reference=(channel(T[:5]),))
    assert [c["samples"] for c in inspect(with_reference)["reference"]] == [5]
