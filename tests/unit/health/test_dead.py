"""Sensors that deliver nothing are named, whatever their kind, and speak against no other one."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mavcal.calib.health.dead import dead_findings
from mavcal.calib.health.finding import HealthVerdict
from mavcal.calib.health.report import health
from mavcal.calib.methods.overview import overview
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
from tests.unit.health.made import CALIBRATED, flight

OK, CANNOT_SAY, SUSPICIOUS, FAULTY = (
    HealthVerdict.OK,
    HealthVerdict.CANNOT_SAY,
    HealthVerdict.SUSPICIOUS,
    HealthVerdict.FAULTY,
)
TRIADS = (Sensor.ACCEL, Sensor.GYRO, Sensor.MAG)
IDS = {"INS_ACC_ID": 11, "INS_ACC2_ID": 12, "INS_GYR_ID": 21, "INS_GYR2_ID": 22, "COMPASS_DEV_ID": 31}


def changed(recording, sensor, instance, change):
    """`recording` with the values of one sensor changed."""
    return recording.with_channels(
        dataclasses.replace(c, values=change(c)) if (c.sensor, c.instance) == (sensor, instance) else c
        for c in recording.channels
    )


def left_out(recording, sensor, instance):
    return recording.with_channels(c for c in recording.channels if (c.sensor, c.instance) != (sensor, instance))


def of(report, sensor, instance=0):
    return next((s for s in report.sensors if (s.sensor, s.instance) == (sensor, instance)), None)


def verdicts(report):
    return {(s.sensor, s.instance): s.verdict for s in report.sensors}


def only_bad(report, sensor, instance):
    return {key for key, verdict in verdicts(report).items() if verdict in (SUSPICIOUS, FAULTY)} == {(sensor, instance)}


@pytest.mark.parametrize("sensor", TRIADS)
@pytest.mark.parametrize("instance", [0, 1])
def test_a_sensor_of_zeros_alone_is_faulty_and_no_other_one_is(sensor, instance):
    report = health(changed(flight(1), sensor, instance, lambda c: np.zeros_like(c.values)))
    assert of(report, sensor, instance).verdict == FAULTY
    assert of(report, sensor, instance).findings[0].text == "reads 0, 0, 0 throughout"
    assert only_bad(report, sensor, instance)


@pytest.mark.parametrize("sensor", TRIADS)
def test_a_sensor_of_one_value_is_faulty_and_no_other_one_is(sensor):
    report = health(changed(flight(2), sensor, 1, lambda c: np.tile(c.values[7], (len(c), 1))))
    assert of(report, sensor, 1).findings[0].text.startswith("reads the same throughout (")
    assert only_bad(report, sensor, 1)


@pytest.mark.parametrize("sensor", TRIADS)
def test_zeros_that_a_reader_left_out_are_told_without_a_channel(sensor):
    dead = Event(0.0, "dead", "", OddSamples(Oddity.ZERO, sensor, 1, 500, 500))
    recording = dataclasses.replace(left_out(flight(3), sensor, 1), events=(dead,))
    assert of(health(recording), sensor, 1).verdict == FAULTY
    if sensor != Sensor.MAG:  # ArduPilot clears the id of a unit that it does not find
        name = "INS_ACC2_ID" if sensor == Sensor.ACCEL else "INS_GYR2_ID"
        absent = ParameterTimeline.constant({**CALIBRATED, name: 0})
        assert of(health(dataclasses.replace(recording, parameters=absent)), sensor, 1) is None


@pytest.mark.parametrize("sensor", TRIADS)
def test_a_sensor_whose_samples_are_all_distrusted_is_faulty(sensor):
    odd = Event(0.0, "damage", "", OddSamples(Oddity.UNHEALTHY, sensor, 1, 500, 500))
    report = health(dataclasses.replace(flight(4), events=(*flight(4).events, odd)))
    assert of(report, sensor, 1).findings[0].text == "was called unhealthy by the autopilot in all of its 500 samples"
    assert only_bad(report, sensor, 1)


@pytest.mark.parametrize("sensor", TRIADS)
def test_a_sensor_that_is_announced_and_never_heard_is_faulty_where_others_of_its_kind_were(sensor):
    announced = {**CALIBRATED, **IDS, "COMPASS_DEV_ID2": 32}
    whole = flight(5, parameters=announced)
    assert health(whole).verdict == OK
    report = health(left_out(whole, sensor, 1))
    assert "and was never heard" in of(report, sensor, 1).findings[0].text
    assert only_bad(report, sensor, 1)
    assert of(health(left_out(left_out(whole, sensor, 1), sensor, 0)), sensor, 1) is None  # they are not logged at all


def test_a_row_of_px4_may_be_left_over():
    rows = {"CAL_MAG0_ID": 1, "CAL_MAG0_PRIO": 50, "CAL_MAG1_ID": 2, "CAL_MAG1_PRIO": 50, "CAL_MAG2_ID": 3}
    recording = flight(6, parameters=rows)
    px4 = dataclasses.replace(recording, identity=dataclasses.replace(recording.identity, autopilot="px4"))
    found = of(health(px4), Sensor.MAG, 2)
    assert found.verdict == CANNOT_SAY  # named, but nobody can tell a dead sensor from one that is gone
    assert "left over" in found.findings[0].text


@pytest.mark.parametrize("sensor", TRIADS)
def test_a_sensor_that_dies_in_mid_log_is_faulty(sensor):
    frozen = changed(flight(7), sensor, 1, lambda c: np.where(c.t[:, None] > 90.0, 0.0, c.values))
    cut = flight(7).with_channels(
        c.between(0.0, 90.05) if (c.sensor, c.instance) == (sensor, 1) else c for c in flight(7).channels
    )
    assert of(health(cut), sensor, 1).verdict == FAULTY
    assert "fell silent at 90.0 s" in " ".join(f.text for f in of(health(cut), sensor, 1).bad)
    assert of(health(frozen), sensor, 1).verdict == FAULTY


def test_coarse_numbers_may_repeat_where_nothing_turned():
    t = np.arange(0.0, 20.0, 0.02)
    still = np.tile([0.0, 0.0, -9.80665], (len(t), 1))
    coarse = [
        Channel(Sensor.ACCEL, 0, t, still, "m/s2", Stage.FILTERED, "RAW_IMU", quantum=0.0098),
        Channel(Sensor.GYRO, 0, t, np.zeros_like(still), "rad/s", Stage.FILTERED, "RAW_IMU", quantum=0.001),
    ]
    assert set(verdicts(health(Recording(tuple(coarse)))).values()) == {CANNOT_SAY}


def test_nothing_is_proposed_for_a_dead_compass():
    alone = left_out(flight(8), Sensor.MAG, 1)
    document = overview(changed(alone, Sensor.MAG, 0, lambda c: np.zeros_like(c.values)))
    assert not any(step["worthwhile"] for step in document["next"] if step["method"].startswith("mag-"))


def found(*channels, events=(), parameters=None):
    timeline = ParameterTimeline.constant({} if parameters is None else parameters)
    made = Recording(channels, events=tuple(events), identity=Identity("ardupilot"), parameters=timeline)
    return dead_findings(made)


def zeros(count, total=1000, sensor=Sensor.MAG):
    return Event(12.5, "damage", "", OddSamples(Oddity.ZERO, sensor, 0, count, total, until=80.0))


@pytest.mark.parametrize("sensor", TRIADS)
def test_zeros_are_a_fault_from_a_tenth_of_the_samples_on(sensor):
    (made,) = found(events=[zeros(100, sensor=sensor)])
    assert (made.verdict, made.sensor) == (FAULTY, sensor)
    assert made.text == "reads 0, 0, 0 in 10 % of its samples, first at 12.5 s"
    assert (made.start, made.end) == (12.5, 80.0)
    for event in (zeros(99), zeros(100, None), Event(1.0, "damage", "")):
        assert found(events=[event]) == ()


def test_a_dead_sensor_that_is_not_used_is_told_without_blame():
    for sensor, name in ((Sensor.MAG, "COMPASS_USE2"), (Sensor.GYRO, "INS_USE2")):
        dead = Event(0.0, "dead", "", OddSamples(Oddity.ZERO, sensor, 1, 500, 500))
        (unused,) = found(events=[dead], parameters={name: 0})
        assert (unused.verdict, unused.action) == (CANNOT_SAY, "")
    assert found(events=[Event(0.0, "dead", "")]) == ()


@pytest.mark.parametrize(("tilt", "verdict"), [(5.0, CANNOT_SAY), (8.0, FAULTY)])
def test_a_constant_compass_is_dead_where_gravity_went_to_another_axis(tilt, verdict):
    """The limit of 1 m/s2 across is a tilt of 5.9 deg."""
    t = np.arange(0.0, 120.0, 0.1)
    angle = np.radians(np.where(t > 60.0, tilt, 0.0))
    force = 9.80665 * np.column_stack([np.sin(angle), np.zeros_like(t), -np.cos(angle)])
    accel = Channel(Sensor.ACCEL, 0, t, force, "m/s2", Stage.CORRECTED, "LOG")
    held = Channel(Sensor.MAG, 0, t, np.tile([20.0, 1.0, 43.0], (len(t), 1)), "uT", Stage.CORRECTED, "LOG")
    (made,) = found(held, accel)
    assert made.verdict == verdict
    (flat,) = found(dataclasses.replace(held, values=np.zeros_like(held.values)))
    assert flat.verdict == FAULTY  # even where nothing turned
