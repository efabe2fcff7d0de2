from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mavcal.calib.flight.item import FlightLimit, FlightVerdict, judged
from mavcal.calib.flight.report import flight_report
from mavcal.calib.methods.overview import overview
from mavcal.calib.methods.worthwhile import LoggedTrip, advice
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
from tests.unit.flight.made import GRAVITY, Unit, log

CLEAN = Unit()
OFF = Unit((0.3, -0.2, 0.15), (0.01, -0.015, 0.008))


def items(recording):
    report = flight_report(recording)
    assert report is not None
    return {(item.name, item.subject): item for item in report.items}


def with_attitude(recording, roll=0.0):
    t = np.arange(0.0, recording.span[1], 0.1)
    q = np.column_stack([np.full(len(t), np.cos(roll / 2)), np.full(len(t), np.sin(roll / 2)), 0 * t, 0 * t])
    return recording.with_channels([*recording.channels, Channel(Sensor.ATTITUDE, 0, t, q, "1", Stage.RAW, "ATT")])


def test_a_bad_unit_is_found_beside_a_good_one_and_named():
    found = items(log([OFF, CLEAN], (30.0, 31.0), seed=1))
    apart = found["accel_consistency", "accel 1, 2"]
    assert apart.verdict == FlightVerdict.WARN
    assert apart.numbers["difference"] == pytest.approx([0.3, -0.2, 0.15], abs=0.003)
    assert "accel 1 is the one that is off" in apart.text
    assert found["gyro_consistency", "gyro 1, 2"].numbers["difference"] == pytest.approx(OFF.gyro, abs=2e-4)
    assert found["gravity_at_rest", "accel 1"].verdict == FlightVerdict.WARN
    assert found["gravity_at_rest", "accel 2"].verdict == FlightVerdict.PASS
    assert found["gyro_bias_at_rest", "gyro 1"].numbers["bias"] == pytest.approx(OFF.gyro, abs=2e-4)
    assert found["gyro_bias_at_rest", "gyro 2"].verdict == FlightVerdict.PASS
    assert found["gyro_bias_drift", "gyro 1"].verdict == FlightVerdict.PASS


def test_a_bias_that_moves_in_flight_is_said_with_the_warming():
    warm = log([Unit(gyro_drift=((1e-4, 0.0, 0.0),))], (20.0, 60.0), seed=2)
    drift = items(warm)["gyro_bias_drift", "gyro 1"]
    assert drift.verdict == FlightVerdict.WARN
    assert drift.numbers["change"][0] == pytest.approx(1e-4 * drift.numbers["degrees_c"], rel=0.02)


def test_the_interval_holds_the_difference():
    truth = np.array(OFF.accel)
    z = []
    for seed in range(20):
        apart = items(log([OFF, CLEAN], (30.0, 31.0), seed=seed, before=10.0, flight=6.0, after=10.0))
        numbers = apart["accel_consistency", "accel 1, 2"].numbers
        z.append((np.array(numbers["difference"]) - truth) / numbers["difference_sd"])
    assert 0.5 < float((np.array(z) ** 2).mean()) < 1.6


def test_gravity_counts_between_that_of_the_place_and_the_firmwares():
    recording = log([Unit((0.0, 0.0, 0.02))], (30.0, 31.0), seed=3)
    t = np.array([0.0, 10.0])
    at_equator = Channel(Sensor.POSITION, 0, t, np.tile([0.0, 10.0, 0.0], (2, 1)), "deg deg m", Stage.RAW, "GPS")
    item = items(recording.with_channels([*recording.channels, at_equator]))["gravity_at_rest", "accel 1"]
    assert item.numbers["gravity"] == pytest.approx(9.7803, abs=1e-4)
    assert item.value == 0.0  # 9.7867 lies between 9.7803 and 9.80665


def test_level_is_judged_with_the_trim():
    tilted = log([Unit((0.0, GRAVITY * np.sin(np.radians(-3.0)), 0.0))], (30.0, 31.0), seed=4, after=0.0)
    plain = with_attitude(tilted)
    assert items(plain)["level", "accel 1"].value == pytest.approx(3.0, abs=0.1)
    trim = ParameterTimeline.constant({"AHRS_TRIM_X": np.radians(3.0), "AHRS_TRIM_Y": 0.0})
    assert items(dataclasses.replace(plain, parameters=trim))["level", "accel 1"].value == pytest.approx(0.0, abs=0.1)
    assert items(tilted)["level", "accel 1"].verdict == FlightVerdict.NOT_TESTABLE


def test_vibration_and_its_tone_though_samples_are_missing():
    recording = log([CLEAN], (30.0, 31.0), seed=5, rate=400.0, vibration=0.0)
    shaken = []
    for c in recording.channels:
        flying = (c.t >= 60.0) & (c.t < 100.0)
        tone = np.where(flying, 8.0 * np.sin(2 * np.pi * 60.0 * c.t), 0.0)[:, None]
        kept = c.take(np.arange(len(c)) % 11 != 0)  # as loggers thin them
        shaken.append(
            dataclasses.replace(kept, values=kept.values + tone[np.arange(len(c)) % 11 != 0] * [1, 0, 0])
            if c.sensor == Sensor.ACCEL
            else kept
        )
    item = items(recording.with_channels(shaken))["vibration", "accel 1"]
    assert item.verdict == FlightVerdict.PASS
    assert item.numbers["rms"][0] == pytest.approx(8.0 / np.sqrt(2.0), rel=0.1)
    assert item.numbers["tones"][0]["hz"] == pytest.approx(60.0, abs=1.0)
    violent = [dataclasses.replace(c, values=10.0 * c.values) if c.sensor == Sensor.ACCEL else c for c in shaken]
    assert items(recording.with_channels(violent))["vibration", "accel 1"].verdict == FlightVerdict.WARN
    filtered = [dataclasses.replace(c, stage=Stage.FILTERED) for c in shaken]
    item = items(recording.with_channels(filtered))["vibration", "accel 1"]
    assert (item.verdict, item.text[:9]) == (FlightVerdict.WARN, "at least ")  # half a g is left behind the filter
    quiet = [dataclasses.replace(c, values=0.5 * c.values) if c.sensor == Sensor.ACCEL else c for c in filtered]
    item = items(recording.with_channels(quiet))["vibration", "accel 1"]
    assert item.verdict == FlightVerdict.NOT_TESTABLE
    assert "low-passed" in item.text


def test_clipping_is_counted_by_the_autopilot_or_seen():
    recording = log([CLEAN], (30.0, 31.0), seed=6)
    assert items(recording)["clipping", "accel 1"].verdict == FlightVerdict.PASS
    odd = OddSamples(Oddity.CLIPPED, Sensor.ACCEL, 0, 140)
    counted = Event(70.0, "clipping", "accelerometer 1 clipped 140 times", odd)
    item = items(dataclasses.replace(recording, events=(*recording.events, counted)))["clipping", "accel 1"]
    assert (item.verdict, item.value) == (FlightVerdict.FAIL, 140.0)
    hit = [
        dataclasses.replace(c, values=np.where(c.t[:, None] == c.t[3500], 156.9, c.values))
        if c.sensor == Sensor.ACCEL
        else c
        for c in recording.channels
    ]
    assert items(recording.with_channels(hit))["clipping", "accel 1"].verdict == FlightVerdict.WARN


def test_scales_of_redundant_units_are_compared_where_the_flight_excites_them():
    recording = log([CLEAN, CLEAN], (30.0, 31.0), seed=7, flight=60.0, vibration=0.0, noise=0.005)
    scaled = [
        dataclasses.replace(c, values=c.values * [1.05, 1.0, 1.0]) if c.sensor == Sensor.GYRO and c.instance == 0 else c
        for c in recording.channels
    ]
    item = items(recording.with_channels(scaled))["gyro_scale", "gyro 1, 2"]
    assert item.verdict == FlightVerdict.WARN
    assert item.numbers["scale"] == pytest.approx([1.05, 1.0, 1.0], abs=0.003)
    still = log([CLEAN, CLEAN], (30.0, 31.0), seed=7, flight=0.0)
    assert items(still)["gyro_scale", "gyro 1, 2"].verdict == FlightVerdict.NOT_TESTABLE


def test_a_finding_is_none_within_twice_its_own_sd():
    limit = FlightLimit(1.0, 2.0, "1", "a test")
    assert judged("a", "b", 1.5, limit, "", sd=0.4).verdict == FlightVerdict.PASS
    assert judged("a", "b", 1.5, limit, "", sd=0.1).verdict == FlightVerdict.WARN
    assert judged("a", "b", 2.5, limit, "").verdict == FlightVerdict.FAIL


def steps_of(recording):
    report = flight_report(recording)
    assert report is not None
    return advice(LoggedTrip(recording, report.rests, report.ground))


def test_the_steps_say_what_is_worthwhile_and_why_the_rest_is_not():
    found = steps_of(with_attitude(log([CLEAN], (20.0, 45.0), seed=8)))
    steps = {step.method: step for step in found}
    assert steps["gyro-rest"].worthwhile
    assert steps["thermal-poly"].worthwhile
    assert steps["thermal-poly"].command == "mavcal fit thermal-poly made.bin"
    assert "2 directions" in steps["accel-multi"].reason or "1 direction" in steps["accel-multi"].reason
    assert "no compass" in steps["mag-flight"].reason
    assert [step.worthwhile for step in found] == sorted((s.worthwhile for s in found), reverse=True)


def test_a_corrupt_compensation_is_named():
    recording = log([CLEAN], (20.0, 45.0), seed=9)
    mag = Channel(Sensor.MAG, 0, np.arange(10.0), np.ones((10, 3)), "uT", Stage.RAW, "MAG")
    corrupt = ParameterTimeline.constant({"COMPASS_MOT_X": float("nan"), "COMPASS_MOT_Y": 0.0})
    found = steps_of(dataclasses.replace(recording.with_channels([*recording.channels, mag]), parameters=corrupt))
    assert "COMPASS_MOT_X in force is not a number" in {s.method: s.reason for s in found}["mag-motor"]


def test_what_is_no_vehicles_has_no_flight():
    recording = log([CLEAN], (30.0, 31.0), seed=10)
    assert flight_report(dataclasses.replace(recording, identity=Identity())) is None
    document = overview(dataclasses.replace(recording, identity=Identity()))
    assert document["flight"] is None
    assert document["next"] is None


def test_a_log_without_inertial_sensors_is_told_so():
    current = Channel(Sensor.CURRENT, 0, np.arange(5.0), np.ones(5), "A", Stage.RAW, "BAT")
    recording = Recording((current,), identity=Identity("ardupilot"), source="x.log")
    report = flight_report(recording)
    assert report is not None
    assert report.verdict == FlightVerdict.NOT_TESTABLE
    assert report.items == ()
    assert not any(step.worthwhile for step in steps_of(recording))


@pytest.mark.parametrize("spoil", ["nan", "constant", "one", "backwards", "debiased", "counts"])
def test_bad_streams_end_in_a_report(spoil):
    def spoilt(c):
        if c.sensor not in (Sensor.ACCEL, Sensor.GYRO):
            return c
        match spoil:
            case "nan":
                return dataclasses.replace(c, values=np.full_like(c.values, np.nan))
            case "constant":
                return dataclasses.replace(c, values=np.zeros_like(c.values))
            case "one":
                return c.take(slice(0, 1))
            case "backwards":
                return dataclasses.replace(c, t=np.where(c.t > 30.0, c.t - 25.0, c.t))
            case "debiased":
                return dataclasses.replace(c, stage=Stage.DEBIASED)
        return dataclasses.replace(c, unit="counts")

    recording = log([CLEAN, CLEAN], (30.0, 31.0), seed=11)
    document = overview(recording.with_channels(spoilt(c) for c in recording.channels))
    assert document["flight"]["verdict"] in set(FlightVerdict)
