"""How findings become verdicts: of a number, of a sensor, of a log."""

from __future__ import annotations

import json
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavcal.calib.flight.item import FlightLimit
from mavcal.calib.health.finding import (
    SUPPORTING,
    HealthFinding,
    HealthVerdict,
    SensorHealth,
    judged_value,
    sensor_health,
    worst,
)
from mavcal.calib.health.limits import HealthLimit
from mavcal.calib.health.report import HealthReport
from mavcal.calib.recording import Sensor

OK, CANNOT_SAY, SUSPICIOUS, FAULTY = (
    HealthVerdict.OK,
    HealthVerdict.CANNOT_SAY,
    HealthVerdict.SUSPICIOUS,
    HealthVerdict.FAULTY,
)
LIMIT = HealthLimit(1.0, 5.0, "m/s2", "a test")
RISING = [CANNOT_SAY, OK, SUSPICIOUS, FAULTY]


def finding(verdict, check="gravity", *, action="", text="", sensor=Sensor.ACCEL, instance=0):
    return HealthFinding(check, sensor, instance, verdict, text, action)


def one_sensor(*findings):
    return sensor_health(Sensor.ACCEL, 0, findings)


@pytest.mark.parametrize(
    ("value", "sd", "verdict"),
    [
        (1.0, 0.0, OK),
        (math.nextafter(1.0, 2.0), 0.0, SUSPICIOUS),
        (5.0, 0.0, SUSPICIOUS),
        (math.nextafter(5.0, 6.0), 0.0, FAULTY),
        (2.0, 0.5, OK),
        (2.0, 0.4375, SUSPICIOUS),
        (6.0, 0.5, SUSPICIOUS),
        (6.0, 0.4375, FAULTY),
    ],
)
def test_a_number_is_judged_beyond_its_limit_less_two_standard_errors(value, sd, verdict):
    assert judged_value(value, sd, LIMIT) == verdict


def test_a_limit_without_a_second_step_calls_nothing_faulty():
    assert judged_value(1e12, 0.0, HealthLimit(1.0, None, "m/s2", "a test")) == SUSPICIOUS


@given(
    value=st.floats(0.0, 20.0),
    more=st.floats(0.0, 20.0),
    sd=st.floats(0.0, 5.0),
    surer=st.floats(0.0, 1.0),
)
def test_a_larger_number_is_never_better_and_a_surer_one_never_milder(value, more, sd, surer):
    worsening = [OK, CANNOT_SAY, SUSPICIOUS, FAULTY]  # what is not known is no better than what is ok
    judged = worsening.index(judged_value(value, sd, LIMIT))
    assert worsening.index(judged_value(value + more, sd, LIMIT)) >= judged
    known = judged_value(value, surer * sd, LIMIT)
    assert worsening.index(known) >= judged or judged_value(value, sd, LIMIT) == CANNOT_SAY


def test_the_worst_verdict_counts_and_a_check_that_was_not_made_counts_last():
    assert [worst(RISING[: k + 1]) for k in range(4)] == RISING
    assert worst(reversed(RISING)) == FAULTY
    assert worst([]) == CANNOT_SAY


@pytest.mark.parametrize("check", sorted(SUPPORTING))
def test_a_check_that_cannot_show_a_sensor_right_makes_none_ok(check):
    assert one_sensor(finding(OK, check)).verdict == CANNOT_SAY
    assert one_sensor(finding(OK, check), finding(OK, "gravity")).verdict == OK
    assert one_sensor(finding(OK, check), finding(CANNOT_SAY, "gravity")).verdict == CANNOT_SAY
    assert one_sensor(finding(SUSPICIOUS, check), finding(OK, "gravity")).verdict == SUSPICIOUS


def test_a_sensor_has_its_own_findings_and_the_worst_first():
    found = [
        finding(OK, text="a"),
        finding(FAULTY, text="b", instance=1),
        finding(SUSPICIOUS, text="c"),
        finding(FAULTY, text="d", sensor=Sensor.GYRO),
        finding(CANNOT_SAY, text="e"),
        finding(FAULTY, text="f"),
        finding(SUSPICIOUS, text="g"),
    ]
    own = sensor_health(Sensor.ACCEL, 0, found)
    assert [f.text for f in own.findings] == ["f", "c", "g", "a", "e"]
    assert [f.text for f in own.bad] == ["f", "c", "g"]
    assert [f.text for f in own.good] == ["a", "e"]


def test_an_action_is_told_once_and_not_beside_a_longer_one_that_holds_it():
    own = one_sensor(
        finding(FAULTY, action="Calibrate. Stay."),
        finding(SUSPICIOUS, action="Calibrate."),
        finding(SUSPICIOUS, action="Damp it."),
        finding(SUSPICIOUS, action="Damp it."),
        finding(SUSPICIOUS),
        finding(OK, action="Nothing."),
    )
    assert own.actions == ("Calibrate. Stay.", "Damp it.")


def report_of(*sensors):
    return HealthReport(tuple(sensors), ())


def sensor(kind, instance, *findings):
    return SensorHealth(kind, instance, findings)


def test_a_summary_names_the_faulty_first_and_counts_the_others():
    made = report_of(
        sensor(Sensor.ACCEL, 0, finding(OK)),
        sensor(Sensor.GYRO, 1, finding(SUSPICIOUS, text="reads 2 deg/s. It was never calibrated")),
        sensor(Sensor.GYRO, 0, finding(CANNOT_SAY)),
        sensor(Sensor.MAG, 0, finding(FAULTY, text="reads 0, 0, 0 throughout")),
        sensor(Sensor.MAG, 2, finding(FAULTY, text="reads 90 uT")),
    )
    assert made.sentences == (
        "Faulty: compass 1 (reads 0, 0, 0 throughout); compass 3 (reads 90 uT).",
        "Suspicious: gyroscope 2 (reads 2 deg/s).",
        "1 of 5 sensors ok.",
        "1 cannot be judged.",
    )
    assert made.verdict == FAULTY
    assert [s.name for s in made.urgent_first] == [
        "compass 1",
        "compass 3",
        "gyroscope 2",
        "accelerometer 1",
        "gyroscope 1",
    ]


def test_a_log_without_sensors_says_so_and_calls_nothing_ok():
    made = report_of()
    assert made.summary == "The log has no accelerometer, gyroscope or compass."
    assert (made.verdict, made.action) == (CANNOT_SAY, "")


def test_the_next_action_is_that_of_the_first_faulty_sensor():
    shaken = sensor(Sensor.ACCEL, 0, finding(SUSPICIOUS, action="Damp the mount."))
    dead = sensor(Sensor.MAG, 0, finding(FAULTY, action="Check its wiring."))
    off = sensor(Sensor.MAG, 1, finding(FAULTY, action="Replace it."))
    assert report_of(shaken, dead, off).action == "Check its wiring."
    assert report_of(shaken).action == "Damp the mount."
    assert report_of(sensor(Sensor.ACCEL, 0, finding(FAULTY))).action == ""
    assert report_of(sensor(Sensor.ACCEL, 0, finding(OK, action="Nothing."))).action == ""


def test_a_finding_is_written_as_plain_json_with_its_limit():
    made = HealthFinding("gravity", Sensor.ACCEL, 1, SUSPICIOUS, "a", "b", 1.5, 0.1, LIMIT, 2.0, 3.0)
    document = json.loads(json.dumps(sensor_health(Sensor.ACCEL, 1, [made]).document))
    assert document["name"] == "accelerometer 2"
    assert document["findings"] == [
        {
            "check": "gravity",
            "sensor": "accel",
            "instance": 1,
            "verdict": "suspicious",
            "text": "a",
            "action": "b",
            "value": 1.5,
            "sd": 0.1,
            "start": 2.0,
            "end": 3.0,
            "limit": {"suspicious": 1.0, "faulty": 5.0, "unit": "m/s2", "source": "a test"},
        }
    ]
    assert finding(OK).document["limit"] is None


@pytest.mark.parametrize(
    ("limit", "worded"),
    [
        (HealthLimit(0.05, 0.3, "1", ""), "5 and 30 %"),
        (HealthLimit(math.radians(1.0), math.radians(5.0), "rad/s", ""), "1 and 5 deg/s"),
        (HealthLimit(0.25, 0.75, "m/s2", ""), "0.25 and 0.75 m/s2"),
        (HealthLimit(2.0, None, "degC", ""), "2 degC"),
        (HealthLimit(0.012, None, "1", ""), "1.2 %"),
    ],
)
def test_limits_are_worded_in_the_units_that_people_read(limit, worded):
    assert limit.worded == worded


def test_a_limit_of_a_flight_keeps_its_two_numbers_in_their_order():
    assert HealthLimit.of(FlightLimit(30.0, 60.0, "m/s2", "VIBE")) == HealthLimit(30.0, 60.0, "m/s2", "VIBE")
