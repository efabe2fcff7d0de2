"""Every kind of fault is found in the sensor that has it, and a healthy flight has none."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from bench.health import named_bad
from mavcal.calib.health.finding import HealthVerdict
from mavcal.calib.health.report import health
from mavcal.calib.methods.overview import overview
from mavcal.calib.recording import Event, Identity, Oddity, OddSamples, ParameterTimeline, Recording, Sensor, Stage
from tests.unit.health.faults import FAULTS, injected
from tests.unit.health.made import CALIBRATED, flight


def of(report, sensor, instance=0):
    return next(s for s in report.sensors if (s.sensor, s.instance) == (sensor, instance))


def without(recording, *sensors):
    return recording.with_channels(c for c in recording.channels if c.sensor not in sensors)


@pytest.mark.sampled
@pytest.mark.parametrize("seed", range(20))
def test_a_healthy_flight_has_no_bad_sensor(seed):
    report = health(flight(seed))
    assert report.verdict == HealthVerdict.OK, report.summary
    assert report.summary == "6 of 6 sensors ok."
    assert report.action == ""


@pytest.mark.sampled
@pytest.mark.parametrize("instance", [0, 1])
@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault.name)
def test_each_fault_is_found_in_the_sensor_that_has_it(fault, instance):
    for seed in (101, 102, 103):
        bad = named_bad(injected(flight(seed), fault, instance))
        assert (fault.sensor, instance) in bad
        assert {sensor for sensor, _ in bad} - {*fault.shared} == {fault.sensor}


def test_which_of_two_units_is_off_is_told_by_what_each_shows_alone():
    fault = next(f for f in FAULTS if f.name.startswith("gyroscope 3"))
    report = health(injected(flight(1), fault, 1))
    assert of(report, Sensor.GYRO, 0).verdict == HealthVerdict.OK
    assert "by its own check unit" in " ".join(f.text for f in of(report, Sensor.GYRO, 0).findings)
    assert of(report, Sensor.GYRO, 1).actions == ("Calibrate the gyroscope: ten seconds at rest.",)


def test_a_gyroscope_that_misleads_the_attitude_is_found_while_the_vehicle_lies_still():
    lying = flight(2, rest=600.0)
    fault = next(f for f in FAULTS if f.name.startswith("gyroscope 20"))
    spun = injected(lying, fault, 0)
    attitude = next(c for c in spun.channels if c.sensor == Sensor.ATTITUDE)
    turning = dataclasses.replace(
        attitude,
        values=np.column_stack([np.cos(0.17 * attitude.t), np.sin(0.17 * attitude.t), 0 * attitude.t, 0 * attitude.t]),
    )
    report = health(spun.with_channels(turning if c is attitude else c for c in spun.channels))
    found = of(report, Sensor.GYRO, 0)
    assert found.verdict == HealthVerdict.FAULTY
    assert "20.0" in found.findings[0].text
    assert "at rest" in found.findings[0].text


def test_a_sensor_that_was_never_calibrated_is_said_to_be():
    fault = next(f for f in FAULTS if f.name.startswith("accelerometer 0.8"))
    zero = dict.fromkeys((n for n in CALIBRATED if n.startswith("INS_ACCOFFS")), 0.0)
    report = health(injected(flight(3, parameters={**CALIBRATED, **zero}), fault, 0))
    assert any("never calibrated" in f.text for f in of(report, Sensor.ACCEL).bad)
    assert not any(
        "never calibrated" in f.text for f in of(health(injected(flight(3), fault, 0)), Sensor.ACCEL).findings
    )


def test_a_compass_of_zeros_alone_is_faulty_if_the_vehicle_uses_it():
    dead = Event(0.0, "dead", "so it is said", OddSamples(Oddity.ZERO, Sensor.MAG, 0, 500, 500))
    recording = dataclasses.replace(without(flight(4), Sensor.MAG), events=(dead,))
    assert of(health(recording), Sensor.MAG).verdict == HealthVerdict.FAULTY
    unused = ParameterTimeline.constant({**CALIBRATED, "COMPASS_USE": 0.0})
    assert of(health(dataclasses.replace(recording, parameters=unused)), Sensor.MAG).verdict == HealthVerdict.CANNOT_SAY


def test_a_parameter_that_is_no_number_is_faulty():
    report = health(flight(5, parameters={**CALIBRATED, "COMPASS_MOT2_X": math.nan}))
    found = of(report, Sensor.MAG, 1)
    assert found.verdict == HealthVerdict.FAULTY
    assert "COMPASS_MOT2_X is not a number" in found.findings[0].text


def test_without_an_attitude_and_a_rest_nothing_is_called_ok():
    recording = without(flight(6), Sensor.ATTITUDE, Sensor.POSITION)
    moving = recording.between(30.0, 90.0)
    shaken = [
        dataclasses.replace(c, values=c.values + 3.0 * np.sin(9.0 * c.t)[:, None]) if c.sensor == Sensor.GYRO else c
        for c in moving.channels
    ]
    report = health(moving.with_channels(shaken))
    assert of(report, Sensor.GYRO).verdict in (HealthVerdict.CANNOT_SAY, HealthVerdict.OK)
    assert "cannot be told" in " ".join(f.text for s in report.sensors for f in s.findings)
    assert any(line.startswith("attitude") for line in report.lacks)


def test_what_is_not_in_physical_units_is_not_judged():
    counts = [dataclasses.replace(c, unit="counts") if c.sensor == Sensor.GYRO else c for c in flight(7).channels]
    assert of(health(Recording(tuple(counts))), Sensor.GYRO).verdict == HealthVerdict.CANNOT_SAY
    raw = [dataclasses.replace(c, stage=Stage.RAW) for c in flight(7).channels]
    bare = Recording(tuple(raw), identity=Identity("ardupilot"))
    assert of(health(bare), Sensor.ACCEL).verdict == HealthVerdict.CANNOT_SAY


def test_a_px4_log_of_bare_sensors_is_judged_with_its_calibration():
    rows = {}
    for kind, offset in (("ACC", 0.0), ("GYRO", 0.0)):
        for i in range(2):
            rows |= {f"CAL_{kind}{i}_{a}OFF": offset for a in "XYZ"} | {f"CAL_{kind}{i}_ID": 100.0 + i}
            rows |= {f"CAL_{kind}{i}_{a}SCALE": 1.0 for a in "XYZ"} | {
                f"CAL_{kind}{i}_ROT": -1.0,
                f"CAL_{kind}{i}_PRIO": 50.0,
            }
    rows |= {"CAL_ACC0_ZOFF": 1.5, "SENS_BOARD_ROT": 0.0, "TC_A_ENABLE": 0.0, "TC_G_ENABLE": 0.0}
    rows |= dict.fromkeys(("SENS_BOARD_X_OFF", "SENS_BOARD_Y_OFF", "SENS_BOARD_Z_OFF"), 0.0)
    recording = without(flight(8), Sensor.MAG)
    bare = [
        dataclasses.replace(c, stage=Stage.RAW, values=c.values + np.array((0.0, 0.0, 1.5 * (c.instance == 0))))
        if c.sensor == Sensor.ACCEL
        else c
        for c in recording.channels
    ]
    made = Recording(tuple(bare), identity=Identity("px4"), parameters=ParameterTimeline.constant(rows))
    assert of(health(made), Sensor.ACCEL).verdict == HealthVerdict.OK
    uncorrected = dataclasses.replace(made, parameters=ParameterTimeline.constant({**rows, "CAL_ACC0_ZOFF": 0.0}))
    assert of(health(uncorrected), Sensor.ACCEL).verdict == HealthVerdict.FAULTY


def test_the_document_has_every_number_that_is_shown():
    fault = next(f for f in FAULTS if f.name.startswith("compass 20 uT"))
    document = overview(injected(flight(9), fault, 0))["health"]
    assert document["verdict"] in ("suspicious", "faulty")
    bad = next(s for s in document["sensors"] if s["name"] == "compass 1")
    finding = next(f for f in bad["findings"] if f["verdict"] == bad["verdict"])
    assert finding["value"] > finding["limit"]["suspicious"]
    assert finding["action"]
    assert document["action"] in [f["action"] for f in bad["findings"]]


def test_a_compass_that_never_changes_is_dead_only_where_the_vehicle_was_turned():
    held = next(f for f in FAULTS if f.name.startswith("compass reads one value"))
    turned = injected(flight(4), held, 0)
    assert of(health(turned), Sensor.MAG).verdict == HealthVerdict.FAULTY
    lying = turned.between(0.0, 19.0)
    found = of(health(lying), Sensor.MAG)
    assert found.verdict == HealthVerdict.CANNOT_SAY
    assert any(f.action == "Turn the vehicle while it logs." for f in found.findings)


def with_field(recording, instance, change):
    """The same in which a compass reads something more, uT."""
    return recording.with_channels(
        dataclasses.replace(c, values=c.values + change) if (c.sensor, c.instance) == (Sensor.MAG, instance) else c
        for c in recording.channels
    )


def test_of_three_compasses_the_one_that_is_off_both_others_is_suspicious():
    """7 uT: half of the angle that two good compasses may be apart, but the other two agree within a degree."""
    made = health(with_field(flight(3, units=3), 1, [5.0, 5.0, 0.0]))
    alone = next(f for f in of(made, Sensor.MAG, 1).findings if f.check == "compasses")
    assert alone.verdict == HealthVerdict.SUSPICIOUS
    assert "away from those of compasses 1 and 3, which agree" in alone.text
    assert [of(made, Sensor.MAG, i).verdict for i in (0, 2)] == [HealthVerdict.OK] * 2


def test_three_compasses_that_all_differ_a_little_are_ok():
    made = flight(3, units=3)
    apart = with_field(with_field(made, 1, [4.0, 0.0, 0.0]), 2, [0.0, 4.0, 0.0])
    for recording in (made, apart):
        found = health(recording)
        assert [of(found, Sensor.MAG, i).verdict for i in range(3)] == [HealthVerdict.OK] * 3
    two = health(with_field(flight(3), 1, [4.0, 0.0, 0.0]))
    assert [of(two, Sensor.MAG, i).verdict for i in range(2)] == [HealthVerdict.OK] * 2
