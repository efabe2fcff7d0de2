"""Vibration, clipping and aliasing: the autopilot's own numbers, with their time."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mavcal.calib.health.finding import HealthVerdict
from mavcal.calib.health.report import health
from mavcal.calib.recording import Channel, Event, Oddity, OddSamples, Sensor, Stage
from tests.unit.health.made import flight


def found(recording, check, instance=0, sensor=Sensor.ACCEL):
    sensors = health(recording).sensors
    unit = next(s for s in sensors if (s.sensor, s.instance) == (sensor, instance))
    return next(f for f in unit.findings if f.check == check)


def with_level(recording, level):
    """The level of VIBE is `level(t)` along z."""
    return recording.with_channels(
        dataclasses.replace(c, values=np.column_stack([*c.values.T[:2], level(c.t)]))
        if c.sensor == Sensor.VIBRATION
        else c
        for c in recording.channels
    )


def clipped(count, first, last):
    odd = OddSamples(Oddity.CLIPPED, Sensor.ACCEL, 0, count, until=last)
    return Event(first, "clipping", f"accelerometer 1 clipped {count} times", odd)


@pytest.mark.parametrize(
    ("level", "verdict"),
    [(29.0, HealthVerdict.OK), (31.0, HealthVerdict.SUSPICIOUS), (61.0, HealthVerdict.FAULTY)],
)
def test_a_level_that_is_held_is_judged_by_the_limits_of_ardupilot(level, verdict):
    made = found(with_level(flight(1), lambda t: np.where((t > 60.0) & (t < 80.0), level, 5.0)), "vibration")
    assert (made.verdict, made.value) == (verdict, level)
    assert "along z" in made.text
    if verdict != HealthVerdict.OK:
        assert made.action == "Damp the mount, and balance the propellers."
        assert made.start == pytest.approx(60.1, abs=0.2)
        assert made.end == pytest.approx(79.9, abs=0.2)


def test_a_blow_is_no_vibration():
    made = found(with_level(flight(1), lambda t: np.where((t > 60.0) & (t < 62.0), 90.0, 5.0)), "vibration")
    assert made.verdict == HealthVerdict.OK
    assert made.text.endswith("at 60.1 s: a blow, no vibration")


def test_what_shakes_on_the_ground_with_the_motors_off_is_no_vibration():
    carried = with_level(flight(1), lambda t: np.where(t < 19.0, 90.0, 5.0))
    assert found(carried, "vibration").verdict == HealthVerdict.OK


def test_the_level_of_px4_has_limits_of_its_own():
    recording = flight(2)
    level = next(c for c in recording.channels if c.sensor == Sensor.VIBRATION)
    single = dataclasses.replace(level, values=np.full((len(level), 1), 6.0), source="vehicle_imu_status")
    gyro = dataclasses.replace(single, sensor=Sensor.GYRO_VIBRATION, unit="rad/s")
    px4 = recording.with_channels([*(c for c in recording.channels if c is not level), single, gyro])
    made = found(px4, "vibration")
    assert made.verdict == HealthVerdict.SUSPICIOUS
    assert made.limit.suspicious == 4.905
    said = found(px4, "vibration", sensor=Sensor.GYRO)
    assert (said.verdict, said.limit) == (HealthVerdict.CANNOT_SAY, None)


def test_clips_of_a_moment_are_a_blow_and_those_of_a_flight_are_the_mount():
    recording = flight(3)
    blow = found(dataclasses.replace(recording, events=(*recording.events, clipped(28, 100.0, 100.6))), "clipping")
    assert blow.verdict == HealthVerdict.SUSPICIOUS
    assert blow.text == "clipped 28 times, from 100.0 to 100.6 s: a blow rather than vibration"
    assert blow.action.startswith("Look for what struck the vehicle at 100 s")
    long = found(dataclasses.replace(recording, events=(*recording.events, clipped(128, 50.0, 120.0))), "clipping")
    assert long.verdict == HealthVerdict.FAULTY
    assert long.action == "Damp the mount, and balance the propellers."
    assert (long.start, long.end) == (50.0, 120.0)


def test_a_counter_that_did_not_rise_in_this_log_is_no_clipping():
    recording = flight(3)
    before = Event(10.0, "clipping", "", OddSamples(Oddity.CLIPPED, Sensor.ACCEL, 0, 0))
    made = found(dataclasses.replace(recording, events=(*recording.events, before)), "clipping")
    assert made.verdict == HealthVerdict.OK


def fast(size, stage=Stage.CORRECTED):
    """A kilohertz of unit 1, with a line at 480 Hz."""
    recording = flight(4)
    slow = recording.find(Sensor.ACCEL)[0]
    t = np.arange(0.0, 100.0, 1e-3)
    values = np.column_stack([np.interp(t, slow.t, column) for column in slow.values.T])
    values[:, 2] += size * np.sin(2.0 * np.pi * 480.0 * t)
    return recording.with_channels([*recording.channels, Channel(Sensor.ACCEL, 0, t, values, "m/s2", stage, "ACC")])


def test_a_line_near_half_the_sampling_rate_may_be_a_faster_one():
    made = found(fast(8.0), "aliasing")
    assert made.verdict == HealthVerdict.SUSPICIOUS
    assert made.value == pytest.approx(8.0, rel=0.1)
    assert "480 Hz, near half the sampling rate of 1000 Hz" in made.text
    assert found(fast(0.0), "aliasing").verdict == HealthVerdict.OK


def test_a_slow_or_filtered_stream_says_what_it_cannot_show():
    slow = found(flight(5), "aliasing")
    assert slow.verdict == HealthVerdict.CANNOT_SAY
    assert "shows nothing above 25 Hz" in slow.text
    assert "INS_LOG_BAT_MASK 1" in slow.action
    recording = flight(5)
    speed = Channel(Sensor.ROTOR_SPEED, 0, np.array([30.0, 90.0]), np.full((2, 4), 95.0), "Hz", Stage.RAW, "ESC")
    turning = recording.with_channels([*recording.channels, speed])
    assert found(turning, "aliasing").text.endswith("the rotors turn at up to 95 Hz")
