"""Compasses by constructed fields: strength, dip, steadiness, motors, zeros, and one beside the other."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mavcal.calib.earth import earth_field
from mavcal.calib.health.compass import compass_findings
from mavcal.calib.health.finding import HealthVerdict
from mavcal.calib.recording import (
    Channel,
    Event,
    Identity,
    ParameterTimeline,
    Recording,
    Sensor,
    Stage,
)
from tests.unit.health.made import flight

T = np.arange(0.0, 120.0, 0.1)
PLACE = (47.4, 8.5, 500.0)
FIELD = earth_field(*PLACE, 2025.5).north_east_down
NORM = float(np.linalg.norm(FIELD))
DIP = math.degrees(math.asin(FIELD[2] / NORM))
TURNED = Rotation.from_euler("ZYX", np.column_stack([0.1 * T, 0.1 * np.sin(0.3 * T), 0.1 * np.sin(0.4 * T)]))
OK, CANNOT_SAY, SUSPICIOUS, FAULTY = (
    HealthVerdict.OK,
    HealthVerdict.CANNOT_SAY,
    HealthVerdict.SUSPICIOUS,
    HealthVerdict.FAULTY,
)


def channel(sensor, values, unit="1", *, t=T, instance=0, stage=Stage.RAW):
    return Channel(sensor, instance, t, np.asarray(values, dtype=float), unit, stage, "LOG")


def compass(more=(0.0, 0.0, 0.0), *, instance=0, field=FIELD, noise=0.1, turned=TURNED):
    """What a compass reads in the Earth's field, and `more` in its own axes, uT."""
    rng = np.random.default_rng(instance)
    values = turned.inv().apply(field) + more + rng.normal(scale=noise, size=(len(T), 3))
    return channel(Sensor.MAG, values, "uT", instance=instance, stage=Stage.CORRECTED)


ATTITUDE = channel(Sensor.ATTITUDE, TURNED.as_quat(scalar_first=True))
POSITION = channel(Sensor.POSITION, np.tile(PLACE, (len(T), 1)), "deg deg m")


def recording(*channels, events=(), parameters=None):
    timeline = ParameterTimeline.constant({} if parameters is None else parameters)
    return Recording(channels, events=tuple(events), identity=Identity("ardupilot"), parameters=timeline)


def findings(*channels, events=(), parameters=None):
    return list(compass_findings(recording(*channels, events=events, parameters=parameters)))


def found(check, *channels, instance=0, **vehicle):
    made = findings(*channels, **vehicle)
    return next((f for f in made if (f.check, f.instance) == (check, instance)), None)


def test_a_true_compass_is_ok_in_every_check_that_can_be_made():
    made = findings(compass(), ATTITUDE, POSITION)
    assert [f.check for f in made] == ["steady", "earth", "dip"]
    assert {f.verdict for f in made} == {OK}
    assert {f.action for f in made} == {""}


@pytest.mark.parametrize(
    ("factor", "verdict"), [(0.6, FAULTY), (0.8, SUSPICIOUS), (0.95, OK), (1.3, SUSPICIOUS), (1.5, FAULTY)]
)
def test_the_strength_of_the_field_is_compared_with_that_of_the_place(factor, verdict):
    made = found("earth", compass(field=factor * FIELD), ATTITUDE, POSITION)
    assert made.verdict == verdict
    assert made.value == pytest.approx(abs(factor - 1.0), abs=0.002)
    assert made.text == f"reads {factor * NORM:.1f} uT; the World Magnetic Model has {NORM:.1f} uT there"
    dip = found("dip", compass(field=factor * FIELD), ATTITUDE, POSITION)
    assert dip.verdict == OK


@pytest.mark.parametrize(("deg", "verdict"), [(9.5, OK), (10.5, SUSPICIOUS), (-15.0, SUSPICIOUS), (30.0, FAULTY)])
def test_the_dip_of_the_field_is_compared_with_that_of_the_place(deg, verdict):
    north = math.hypot(FIELD[0], FIELD[1])
    tipped = math.radians(DIP - deg)
    field = NORM * np.array(
        [math.cos(tipped) * FIELD[0] / north, math.cos(tipped) * FIELD[1] / north, math.sin(tipped)]
    )
    made = found("dip", compass(field=field), ATTITUDE, POSITION)
    assert made.verdict == verdict
    assert made.value == pytest.approx(abs(deg), abs=0.2)
    assert f"dips by {DIP - deg:.1f} deg; the World Magnetic Model has {DIP:.1f} deg" in made.text
    assert ("rotation parameter" in made.action) == (verdict != OK)
    assert found("earth", compass(field=field), ATTITUDE, POSITION).verdict == OK


def test_without_a_position_the_field_of_the_place_is_not_known():
    for position in ([], [channel(Sensor.POSITION, np.zeros((len(T), 3)), POSITION.unit)]):
        made = found("earth", compass(), ATTITUDE, *position)
        assert made.verdict == CANNOT_SAY
        assert "GPS" in made.action
    nowhere = channel(Sensor.POSITION, np.full((len(T), 3), np.nan), POSITION.unit)
    assert found("earth", compass(), nowhere).verdict == CANNOT_SAY


def test_a_position_before_the_first_fix_is_none():
    late = np.tile(PLACE, (len(T), 1))
    late[: len(T) - 10] = 0.0
    assert found("earth", compass(), ATTITUDE, channel(Sensor.POSITION, late, POSITION.unit)).verdict == OK


def test_the_date_of_the_log_chooses_the_year_of_the_model():
    said = Event(0.0, "utc", "2021-07-02T10:00:00+00:00")
    now, then = (found("earth", compass(), POSITION, events=events) for events in ((), (said,)))
    assert float(now.text.split("Model has ")[1].split()[0]) == pytest.approx(NORM, abs=0.06)
    earlier = float(np.linalg.norm(earth_field(*PLACE, 2021.5).north_east_down))
    assert float(then.text.split("Model has ")[1].split()[0]) == pytest.approx(earlier, abs=0.06)
    assert abs(earlier - NORM) > 0.12


def test_an_attitude_that_covers_too_little_of_the_log_tells_no_dip():
    rows = np.arange(len(T))
    for kept, told in ((rows > 0.2 * len(T), True), (rows > 0.3 * len(T), False), (rows < 0.7 * len(T), False)):
        made = found("dip", compass(), ATTITUDE.take(kept), POSITION)
        assert (made is not None) == told
    assert found("dip", compass(), POSITION) is None


@pytest.mark.parametrize(("amount", "verdict"), [(2.0, OK), (12.0, SUSPICIOUS), (40.0, FAULTY)])
def test_an_offset_makes_the_strength_wander_with_the_heading(amount, verdict):
    made = found("steady", compass((amount, 0.0, 0.0)), ATTITUDE, POSITION)
    assert made.verdict == verdict
    mean, swing = NORM**2 + amount**2, 2.0 * amount * math.hypot(FIELD[0], FIELD[1])
    half = 0.5 * (math.sqrt(mean + swing) - math.sqrt(mean - swing))
    assert made.value == pytest.approx(half / math.sqrt(mean), rel=0.1)
    assert ("Calibrate the compass outdoors" in made.action) == (verdict != OK)


def test_noise_of_single_samples_is_no_unsteadiness():
    assert found("steady", compass(noise=4.0), ATTITUDE).verdict == OK


def test_fewer_than_fifty_samples_tell_no_steadiness():
    for rows, verdict in ((49, CANNOT_SAY), (50, OK)):
        made = found("steady", compass().take(slice(0, rows)), POSITION)
        assert made.verdict == verdict
    assert found("steady", compass().take(slice(0, 49))).text == "49 samples: 50 are needed"
    assert found("earth", compass().take(slice(0, 49)), POSITION) is None


NEUTRAL = {f"COMPASS_OFS_{a}": 0.0 for a in "XYZ"}


def test_a_compass_that_was_never_calibrated_is_said_to_be_where_it_is_bad():
    bad = compass((40.0, 0.0, 0.0))
    for check in ("steady", "earth"):
        said = "It was never calibrated: its offsets are 0"
        assert said in found(check, bad, POSITION, parameters=NEUTRAL).text
        assert said not in found(check, bad, POSITION, parameters={**NEUTRAL, "COMPASS_OFS_X": 5.0}).text
        assert said not in found(check, compass(), POSITION, parameters=NEUTRAL).text


def motors(size, sensor=Sensor.THROTTLE, *, along=(0.0, 0.0, 1.0)):
    """A drive that goes up and down, and the field that it makes, uT at its full range."""
    drive = 0.5 + 0.5 * np.sin(1.7 * T)
    own = compass()
    driven = dataclasses.replace(own, values=own.values + size * drive[:, None] * np.array(along))
    scale, unit = (20.0, "A") if sensor == Sensor.CURRENT else (1.0, "1")
    return driven, channel(sensor, scale * drive, unit)


@pytest.mark.parametrize("sensor", [Sensor.THROTTLE, Sensor.CURRENT])
@pytest.mark.parametrize(("size", "verdict"), [(1.0, OK), (8.0, SUSPICIOUS), (25.0, FAULTY)])
def test_a_field_that_follows_the_motors_is_interference(size, verdict, sensor):
    made = found("motors", *motors(size, sensor), ATTITUDE)
    assert made.verdict == verdict
    named = "current" if sensor == Sensor.CURRENT else "throttle"
    assert f"% with the {named} (correlation +" in made.text
    if verdict != OK:
        assert made.action == "Move the compass away from the power leads, or compensate: mavcal fit mag-motor."
        strength = float(np.median(np.linalg.norm(motors(size, sensor)[0].values, axis=1)))
        assert made.value == pytest.approx(size / strength, rel=0.1)


def test_a_field_along_the_vertical_is_seen_by_the_vertical_part():
    driven, throttle = motors(12.0, along=(0.0, 0.0, -1.0))
    with_attitude = found("motors", driven, throttle, ATTITUDE)
    assert "its vertical part moves by" in with_attitude.text
    assert "(correlation -" in with_attitude.text
    assert "its strength moves by" in found("motors", driven, throttle).text


def test_a_drive_that_did_not_move_tells_nothing_of_its_field():
    driven, throttle = motors(20.0)
    for spread, told in ((0.04, False), (0.08, True)):
        still = dataclasses.replace(throttle, values=0.4 + spread * (throttle.values - 0.5))
        assert (found("motors", driven, still) is not None) == told
    driven, current = motors(20.0, Sensor.CURRENT)
    for spread, told in ((0.8, False), (1.3, True)):
        still = dataclasses.replace(current, values=5.0 + spread * (current.values / 20.0 - 0.5))
        assert (found("motors", driven, still) is not None) == told
    assert found("motors", driven, current.take(slice(0, 49))) is None


def test_what_does_not_follow_the_motors_is_not_theirs():
    _, throttle = motors(0.0)
    heading = found("motors", compass((15.0, 0.0, 0.0)), throttle)
    assert heading.verdict == OK


def test_where_the_motors_are_the_cause_their_remedy_is_told():
    driven, throttle = motors(30.0)
    made = {f.check: f for f in findings(driven, throttle, ATTITUDE)}
    assert made["steady"].verdict in (SUSPICIOUS, FAULTY)
    assert made["steady"].action == made["motors"].action


def test_parameters_that_are_no_numbers_are_told_of_their_own_compass():
    made = findings(
        parameters={
            "COMPASS_OFS2_X": math.nan,
            "COMPASS_DIA2_Y": math.inf,
            "COMPASS_MOT_Z": math.nan,
            "ATC_X": math.nan,
        }
    )
    assert [(f.instance, f.verdict) for f in made] == [(1, FAULTY), (0, FAULTY)]
    assert made[0].text == "its parameters COMPASS_DIA2_Y, COMPASS_OFS2_X are not a number"
    assert made[1].text == "its parameter COMPASS_MOT_Z is not a number"
    assert made[1].action == "Set COMPASS_MOT_Z to 0 and calibrate the compass."
    assert findings(parameters={"COMPASS_OFS_X": 1e30}) == []


def rotated(deg, instance):
    """A compass whose board is mounted `deg` about the down axis from where its parameter says."""
    own = compass(instance=instance)
    return dataclasses.replace(own, values=Rotation.from_euler("Z", deg, degrees=True).apply(own.values))


def apart_by(deg):
    """Angle between two fields of this dip whose boards differ by `deg` of heading."""
    across = math.radians(DIP)
    cosine = math.sin(across) ** 2 + math.cos(across) ** 2 * math.cos(math.radians(deg))
    return math.degrees(math.acos(cosine))


@pytest.mark.parametrize(("deg", "verdict"), [(20.0, OK), (90.0, SUSPICIOUS), (180.0, SUSPICIOUS)])
def test_two_compasses_that_differ_do_not_tell_which_is_off(deg, verdict):
    pair = compass(), rotated(deg, 1)
    for instance in (0, 1):
        made = found("compasses", *pair, instance=instance)
        assert made.verdict == verdict
        assert made.value == pytest.approx(apart_by(deg), abs=2.0)
        assert f"away from that of compass {2 - instance}" in made.text
        assert made.text.endswith("which is off, this comparison cannot say") == (verdict != OK)


def test_a_compass_that_is_off_two_others_is_faulty_and_they_are_not():
    made = [found("compasses", compass(), rotated(150.0, 1), compass(instance=2), instance=i) for i in range(3)]
    assert [f.verdict for f in made] == [OK, FAULTY, OK]
    assert made[0].text == "agrees with 1 other compass"
    assert "which agree" in made[1].text


def test_three_compasses_that_all_differ_are_each_told_by_the_furthest():
    trio = compass(), rotated(100.0, 1), rotated(-100.0, 2)
    made = [found("compasses", *trio, instance=i) for i in range(3)]
    assert {f.verdict for f in made} <= {SUSPICIOUS, FAULTY}
    assert all("which agree" not in f.text for f in made)
    assert made[0].value == pytest.approx(apart_by(100.0), abs=3.0)


def test_a_compass_with_few_samples_is_compared_with_none():
    assert found("compasses", compass(), compass(instance=1).take(slice(0, 49))) is None
    assert found("compasses", compass(), compass(instance=1).take(slice(0, 50))) is not None


def test_a_compass_in_counts_is_not_judged_and_compared_with_none():
    counts = dataclasses.replace(compass(instance=1), unit="counts")
    made = findings(compass(), counts, ATTITUDE, POSITION)
    assert [(f.check, f.verdict) for f in made if f.instance == 1] == [("field", CANNOT_SAY)]
    assert "compasses" not in {f.check for f in made}


@pytest.mark.parametrize(
    ("strength", "verdict"),
    [(117.0, FAULTY), (85.0, SUSPICIOUS), (12.0, FAULTY), (49.0, CANNOT_SAY), (66.0, CANNOT_SAY)],
)
def test_without_a_position_the_earth_has_22_to_67_anywhere(strength, verdict):
    recording = flight(1).with_channels(c for c in flight(1).channels if c.sensor != Sensor.POSITION)
    mag = recording.channel(Sensor.MAG, 0)
    size = np.median(np.linalg.norm(mag.values, axis=1))
    scaled = dataclasses.replace(mag, values=mag.values * strength / size)
    made = recording.with_channels(scaled if c is mag else c for c in recording.channels)
    (found,) = [f for f in compass_findings(made) if (f.check, f.instance) == ("earth", 0)]
    assert found.verdict == verdict
    assert "the Earth has 22 to 67 uT anywhere" in found.text
