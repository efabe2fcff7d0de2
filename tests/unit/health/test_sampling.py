"""Gaps of one sensor, values that stand still, samples that the autopilot distrusted."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mavcal.calib.health.finding import HealthVerdict
from mavcal.calib.health.report import health
from mavcal.calib.recording import Event, Oddity, OddSamples, Sensor
from tests.unit.health.made import flight


def found(recording, check, sensor=Sensor.MAG, instance=0):
    unit = next(s for s in health(recording).sensors if (s.sensor, s.instance) == (sensor, instance))
    return next((f for f in unit.findings if f.check == check), None)


def silenced(recording, first, last, chosen):
    return recording.with_channels(c.take((c.t < first) | (c.t > last)) if chosen(c) else c for c in recording.channels)


def test_a_compass_that_falls_silent_alone_is_found_with_its_time():
    made = found(silenced(flight(1), 60.0, 63.0, lambda c: (c.sensor, c.instance) == (Sensor.MAG, 0)), "sampling")
    assert made.verdict == HealthVerdict.SUSPICIOUS
    assert made.value == pytest.approx(3.2, abs=0.1)
    assert "for up to 3.2 s at 59.9 s (10 Hz)" in made.text
    assert made.action == "Check its bus and power; replace it if it comes back."


def test_a_gap_that_all_sensors_share_is_the_logger_s():
    sensors = (Sensor.ACCEL, Sensor.GYRO, Sensor.MAG)
    report = health(silenced(flight(1), 60.0, 63.0, lambda c: c.sensor in sensors))
    assert report.verdict == HealthVerdict.OK
    assert any("the logger did not keep up. Use a faster card" in line for line in report.lacks)


def test_a_pause_of_the_log_is_no_gap():
    report = health(silenced(flight(1), 60.0, 90.0, lambda _: True))
    assert report.verdict == HealthVerdict.OK
    assert not any("keep up" in line for line in report.lacks)


def test_samples_that_were_left_out_are_no_silence():
    recording = silenced(flight(1), 60.0, 63.0, lambda c: (c.sensor, c.instance) == (Sensor.MAG, 0))
    odd = OddSamples(Oddity.ZERO, Sensor.MAG, 0, 30, 1800, until=63.0)
    said = dataclasses.replace(recording, events=(*recording.events, Event(60.0, "damage", "", odd)))
    assert found(said, "sampling").verdict == HealthVerdict.OK


def test_a_stuck_gyroscope_says_when_it_stood_still():
    def held(channel):
        values = channel.values.copy()
        values[(channel.t > 100.0) & (channel.t < 108.0)] = values[0]
        return dataclasses.replace(channel, values=values)

    recording = flight(2)
    stuck = recording.with_channels(
        held(c) if (c.sensor, c.instance) == (Sensor.GYRO, 1) else c for c in recording.channels
    )
    made = found(stuck, "stuck", Sensor.GYRO, 1)
    assert made.verdict == HealthVerdict.FAULTY
    assert made.start == pytest.approx(100.0, abs=0.1)
    assert made.end == pytest.approx(108.0, abs=0.1)


@pytest.mark.parametrize(
    ("count", "verdict"), [(5, HealthVerdict.OK), (50, HealthVerdict.SUSPICIOUS), (200, HealthVerdict.FAULTY)]
)
def test_what_the_autopilot_called_unhealthy_counts_by_its_share(count, verdict):
    odd = OddSamples(Oddity.UNHEALTHY, Sensor.ACCEL, 1, count, 1000, until=90.0)
    recording = flight(3)
    said = dataclasses.replace(recording, events=(*recording.events, Event(80.0, "damage", "", odd)))
    assert found(said, "unhealthy", Sensor.ACCEL, 1).verdict == verdict


def test_rates_are_said_and_make_no_sensor_ok():
    bare = flight(4).with_channels(c for c in flight(4).channels if c.sensor == Sensor.MAG)
    few = bare.with_channels(c.take(np.arange(20)) for c in bare.channels)
    assert found(bare, "sampling").text == "sampled at 10 Hz, no gap"
    assert health(few).verdict == HealthVerdict.CANNOT_SAY


def test_an_offset_of_a_gyroscope_makes_no_still_compass_a_stuck_one():
    """A simulated compass without noise repeats itself where nothing turns, whatever a gyroscope adds to its rate."""
    whole = flight(2)
    held = [
        dataclasses.replace(c, values=np.where((c.t > 60.0)[:, None] & (c.t < 72.0)[:, None], c.values[600], c.values))
        if c.sensor == Sensor.MAG
        else dataclasses.replace(c, values=0.1 * c.values + [np.radians(20.0 * (c.instance == 0)), 0.0, 0.0])
        if c.sensor == Sensor.GYRO
        else c
        for c in whole.channels
    ]
    for units in (held, [c for c in held if c.sensor != Sensor.GYRO or c.instance == 0]):
        report = health(whole.with_channels(units))
        assert {s.name for s in report.sensors if s.verdict == HealthVerdict.FAULTY} <= {"gyroscope 1"}
