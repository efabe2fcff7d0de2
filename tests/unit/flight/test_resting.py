"""What a rest tells of gravity, level, bias and its drift, by constructed samples without noise to speak of."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mavcal.calib.earth import local_gravity
from mavcal.calib.flight.item import FlightVerdict
from mavcal.calib.flight.rest import Known, Phase, Rest
from mavcal.calib.flight.resting import gravity_of_place, rest_means, resting_items
from mavcal.calib.recording import Channel, ParameterTimeline, Recording, Sensor, Stage

G = 9.80665
PASS, WARN, FAIL, NOT_TESTABLE = FlightVerdict.PASS, FlightVerdict.WARN, FlightVerdict.FAIL, FlightVerdict.NOT_TESTABLE
T = np.arange(0.0, 100.0, 0.05)
BEFORE = Rest(0.0, 30.0, Phase.BEFORE, Known.ARMING)
AFTER = Rest(60.0, 90.0, Phase.AFTER, Known.ARMING)


def unit(sensor, value, instance=0, *, later=None, stage=Stage.CORRECTED, noise=1e-3):
    """Constant readings, and `later` from the second half on."""
    rng = np.random.default_rng(10 * instance + (sensor == Sensor.GYRO))
    values = np.where((T < 50.0)[:, None], value, value if later is None else later)
    unit_of = "m/s2" if sensor == Sensor.ACCEL else "rad/s"
    return Channel(sensor, instance, T, values + noise * rng.normal(size=(len(T), 3)), unit_of, stage, "IMU")


def accel(value=(0.0, 0.0, -G), instance=0, **kw):
    return unit(Sensor.ACCEL, value, instance, **kw)


def gyro(value=(0.0, 0.0, 0.0), instance=0, **kw):
    return unit(Sensor.GYRO, value, instance, noise=1e-5, **kw)


def at(latitude, altitude, t=T[::20]):
    values = np.tile([latitude, 8.0, altitude], (len(t), 1))
    return Channel(Sensor.POSITION, 0, t, values, "deg deg m", Stage.RAW, "GPS")


def attitude(turned, t=T[::2]):
    q = np.tile(turned.as_quat(scalar_first=True), (len(t), 1))
    return Channel(Sensor.ATTITUDE, 0, t, q, "1", Stage.RAW, "ATT")


def item(name, *channels, rests=(BEFORE, AFTER), parameters=None, subject=None):
    timeline = ParameterTimeline.constant({} if parameters is None else parameters)
    made = resting_items(Recording(channels, parameters=timeline), rests)
    return next(i for i in made if i.name == name and subject in (None, i.subject))


@pytest.mark.parametrize(("down", "verdict"), [(0.05, PASS), (0.15, WARN), (-0.15, WARN), (0.8, FAIL), (-0.8, FAIL)])
def test_the_length_of_gravity_at_rest_is_judged_either_way(down, verdict):
    made = item("gravity_at_rest", accel((0.0, 0.0, -G + down)))
    assert made.verdict == verdict
    assert made.value == pytest.approx(abs(down), abs=1e-3)
    assert "gravity is 9.80665 (the place is not known)" in made.text


def test_the_worst_rest_counts_and_is_named():
    made = item("gravity_at_rest", accel(later=(0.0, 0.0, -G - 0.3)))
    assert made.value == pytest.approx(0.3, abs=1e-3)
    assert "at rest (after)" in made.text
    assert made.numbers["lengths"] == pytest.approx([G, G + 0.3], abs=1e-3)


@pytest.mark.parametrize(("latitude", "altitude"), [(0.0, 0.0), (89.0, 0.0), (47.0, 4000.0)])
def test_between_the_gravity_of_the_place_and_that_of_the_firmware_nothing_is_off(latitude, altitude):
    place = local_gravity(latitude, altitude)
    for length, off in ((0.5 * (place + G), 0.0), (max(place, G) + 0.12, 0.12), (min(place, G) - 0.12, 0.12)):
        made = item("gravity_at_rest", accel((0.0, 0.0, -length)), at(latitude, altitude))
        assert made.value == pytest.approx(off, abs=1e-3)
        assert f"gravity is {place:.4f} of the place" in made.text


@pytest.mark.parametrize(
    ("latitude", "altitude", "known"),
    [(47.0, 500.0, True), (0.0, 0.0, True), (91.0, 0.0, False), (47.0, -1000.0, False), (47.0, 50e3, False)],
)
def test_a_place_that_cannot_be_is_not_known(latitude, altitude, known):
    gravity, said = gravity_of_place(Recording((at(latitude, altitude),)))
    assert said is known
    assert gravity == (pytest.approx(local_gravity(latitude, altitude)) if known else G)


def test_a_receiver_without_a_fix_has_no_place():
    none = at(0.0, 0.0)
    none = dataclasses.replace(none, values=np.zeros_like(none.values))
    assert gravity_of_place(Recording((none,))) == (G, False)
    late = dataclasses.replace(none, values=np.vstack([none.values[:-3], at(60.0, 0.0).values[:3]]))
    assert gravity_of_place(Recording((late,))) == (pytest.approx(local_gravity(60.0, 0.0)), True)
    lost = dataclasses.replace(none, values=np.full_like(none.values, np.nan))
    assert gravity_of_place(Recording((lost,))) == (G, False)
    assert gravity_of_place(Recording(())) == (G, False)


@pytest.mark.parametrize("axis", ["x", "y"])
@pytest.mark.parametrize(("deg", "verdict"), [(0.5, PASS), (2.0, WARN), (-2.0, WARN), (8.0, FAIL)])
def test_the_vertical_of_the_accelerometer_is_compared_with_that_of_the_attitude(axis, deg, verdict):
    turned = Rotation.from_euler(axis, deg, degrees=True)
    made = item("level", accel(turned.inv().apply([0.0, 0.0, -G])), attitude(Rotation.identity()))
    assert made.verdict == verdict
    assert made.value == pytest.approx(abs(deg), abs=0.02)
    roll, pitch = made.numbers["roll_pitch_deg"][0]
    assert (roll, pitch) == pytest.approx((deg, 0.0) if axis == "x" else (0.0, deg), abs=0.02)
    both = item("level", accel(turned.inv().apply([0.0, 0.0, -G])), attitude(turned))
    assert both.value == pytest.approx(0.0, abs=0.02)


def test_the_trim_turns_the_board_into_the_vehicle():
    tilted = Rotation.from_euler("x", 4.0, degrees=True).inv().apply([0.0, 0.0, -G])
    trim = {"AHRS_TRIM_X": math.radians(4.0), "AHRS_TRIM_Y": 0.0}
    made = item("level", accel(tilted), attitude(Rotation.identity()), parameters=trim)
    assert made.value == pytest.approx(0.0, abs=0.02)
    assert made.numbers["trim_deg"] == pytest.approx([4.0, 0.0])


def test_what_is_shorter_than_half_of_gravity_has_no_vertical():
    for length, testable in ((0.45, False), (0.55, True)):
        made = item("level", accel((0.0, 0.0, -length * G)), attitude(Rotation.identity()))
        assert (made.verdict != NOT_TESTABLE) == testable
    assert item("level", accel((0.0, 0.0, -2.0))).text == "it reads 2.00 m/s2 at rest: that is not gravity"


def test_an_estimator_is_levelled_after_five_seconds():
    level = attitude(Rotation.identity())
    for seconds, testable in ((4.5, False), (5.5, True)):
        rest = Rest(0.0, seconds, Phase.BEFORE, Known.ARMING)
        made = item("level", accel(), level, rests=(rest,))
        assert (made.verdict != NOT_TESTABLE) == testable
    assert item("level", accel()).text == "the log has no attitude during a rest"


def test_the_attitude_counts_in_the_second_half_of_a_rest():
    """An estimator that starts 20 deg off is levelled meanwhile."""
    level = attitude(Rotation.identity())
    q = level.values.copy()
    q[level.t < 14.0] = Rotation.from_euler("x", 20.0, degrees=True).as_quat(scalar_first=True)
    made = item("level", accel(), dataclasses.replace(level, values=q), rests=(BEFORE,))
    assert made.value == pytest.approx(0.0, abs=0.02)


@pytest.mark.parametrize(("deg", "verdict"), [(0.05, PASS), (0.2, WARN), (6.0, FAIL)])
def test_a_bias_at_rest_is_the_largest_of_the_rests(deg, verdict):
    rate = np.radians(deg) * np.array([0.0, 0.6, 0.8])
    made = item("gyro_bias_at_rest", gyro(later=rate))
    assert made.verdict == verdict
    assert made.numbers["bias"] == pytest.approx(rate, abs=1e-5)
    assert made.text.startswith(f"reads {deg:.3f} deg/s at rest (after): (")


@pytest.mark.parametrize(("deg", "verdict"), [(0.05, PASS), (0.2, WARN), (2.0, FAIL)])
def test_a_bias_drifts_by_what_it_moved_from_the_first_rest_to_the_last(deg, verdict):
    rate = np.radians([deg, 0.0, 0.0])
    made = item("gyro_bias_drift", gyro((0.01, 0.0, 0.0), later=rate + np.array([0.01, 0.0, 0.0])))
    assert made.verdict == verdict
    assert made.numbers["change"] == pytest.approx(rate, abs=1e-5)
    assert made.text == f"its bias moved by {deg:.3f} deg/s in 0.5 min"


def test_a_drift_is_said_with_the_warming_of_the_sensor():
    warm = Channel(Sensor.TEMPERATURE, 0, T, 20.0 + 0.5 * T, "degC", Stage.RAW, "IMU")
    made = item("gyro_bias_drift", gyro(later=(0.01, 0.0, 0.0)), warm)
    assert made.numbers["degrees_c"] == pytest.approx(30.0, abs=0.1)
    assert made.text.endswith("and +30.0 degC")
    blind = dataclasses.replace(warm, values=np.full_like(warm.values, np.nan))
    assert item("gyro_bias_drift", gyro(), blind).numbers["degrees_c"] is None
    for half in (T < 50.0, T > 50.0):
        assert item("gyro_bias_drift", gyro(), warm.take(half)).numbers["degrees_c"] is None


def test_one_rest_tells_no_drift_and_none_tells_nothing():
    made = item("gyro_bias_drift", gyro(), rests=(BEFORE,))
    assert made.verdict == NOT_TESTABLE
    assert "LOG_DISARMED 1, SDLOG_MODE 2" in made.text
    for name in ("gyro_bias_drift", "gyro_bias_at_rest", "gravity_at_rest", "level"):
        none = item(name, gyro(), accel(), rests=())
        assert (none.verdict, none.text) == (NOT_TESTABLE, "no rest of 2 s with the motors off")


@pytest.mark.parametrize(
    ("apart", "weighed", "verdict"),
    [
        ((0.15, 0.0, 0.0), 0.15, PASS),
        ((0.0, 0.3, 0.0), 0.3, WARN),
        ((0.0, 0.0, 0.3), 0.15, PASS),
        ((0.0, 0.0, 0.6), 0.3, WARN),
    ],
)
def test_accelerometers_are_compared_with_the_vertical_counted_half(apart, weighed, verdict):
    made = item("accel_consistency", accel(), accel(np.array([0.0, 0.0, -G]) - apart, 1))
    assert made.subject == "accel 1, 2"
    assert made.verdict == verdict
    assert made.value == pytest.approx(weighed, abs=2e-3)
    assert made.numbers["difference"] == pytest.approx(apart, abs=1e-3)


def test_gyroscopes_are_compared_with_every_axis_whole():
    apart = np.radians([0.0, 0.0, 0.3])
    made = item("gyro_consistency", gyro(apart), gyro(instance=1))
    assert (made.verdict, made.value) == (WARN, pytest.approx(float(np.linalg.norm(apart)), abs=1e-5))
    assert made.text.endswith("judged by its own reading, gyro 1 is the one that is off")
    assert item("gyro_consistency", gyro(), gyro(apart, 1)).text.endswith("gyro 2 is the one that is off")
    assert "off" not in item("gyro_consistency", gyro(apart), gyro(-apart, 1)).text


def test_the_rest_in_which_two_differ_most_is_told_with_every_other():
    made = item("gyro_consistency", gyro(), gyro(instance=1, later=(0.02, 0.0, 0.0)))
    assert "at rest (after)" in made.text
    assert [e[0] for e in made.numbers["every"]] == pytest.approx([0.0, -0.02], abs=1e-5)


def test_a_rest_counts_from_two_seconds_and_32_samples_on():
    for rest, counted in (
        (Rest(0.0, 1.9, Phase.BEFORE, Known.ARMING), 0),
        (Rest(0.0, 2.1, Phase.BEFORE, Known.ARMING), 1),
    ):
        assert len(rest_means(Recording((gyro(),)), Sensor.GYRO, 0, (rest,))) == counted
    for rows, counted in ((31, 0), (32, 1)):
        few = gyro().take(slice(0, rows))
        assert len(rest_means(Recording((few,)), Sensor.GYRO, 0, (BEFORE,))) == counted


def test_a_mean_has_the_error_of_its_samples():
    (mean,) = rest_means(Recording((accel(noise=0.1),)), Sensor.ACCEL, 0, (BEFORE,))
    assert mean.sd == pytest.approx(0.1 / math.sqrt(600.0), rel=0.5)
    assert mean.mean == pytest.approx([0.0, 0.0, -G], abs=0.02)
    assert mean.temperature is None


def test_samples_that_are_no_numbers_or_not_physical_have_no_mean():
    broken = gyro()
    values = broken.values.copy()
    values[::3, 1] = np.nan
    (mean,) = rest_means(Recording((dataclasses.replace(broken, values=values),)), Sensor.GYRO, 0, (BEFORE,))
    assert np.isfinite(mean.mean).all()
    counts = dataclasses.replace(broken, unit="counts")
    assert rest_means(Recording((counts,)), Sensor.GYRO, 0, (BEFORE,)) == ()
    debiased = dataclasses.replace(broken, stage=Stage.DEBIASED)
    assert rest_means(Recording((debiased,)), Sensor.GYRO, 0, (BEFORE,)) == ()
