"""Accelerometers and gyroscopes beside gravity, a rest, an attitude and each other, by constructed samples."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mavcal.calib.flight.rest import TimeSpan
from mavcal.calib.health.finding import HealthVerdict
from mavcal.calib.health.inertial import inertial_findings, motionless
from mavcal.calib.recording import Channel, Recording, Sensor, Stage

G = 9.80665
T = np.arange(0.0, 120.0, 0.02)
OK, CANNOT_SAY, SUSPICIOUS, FAULTY = (
    HealthVerdict.OK,
    HealthVerdict.CANNOT_SAY,
    HealthVerdict.SUSPICIOUS,
    HealthVerdict.FAULTY,
)


def unit(sensor, instance, offset=(0.0, 0.0, 0.0), *, t=T, noise=0.02, shake=0.0):
    """A motionless sensor; `shake` has it swing, so that no stillness is found."""
    rng = np.random.default_rng(100 * instance + (sensor == Sensor.GYRO))
    base = [0.0, 0.0, -G] if sensor == Sensor.ACCEL else [0.0, 0.0, 0.0]
    size = noise if sensor == Sensor.ACCEL else 0.05 * noise
    values = rng.normal(scale=size, size=(len(t), 3)) + base + offset
    values[:, 0] += shake * np.sin(9.0 * t)
    unit_of = "m/s2" if sensor == Sensor.ACCEL else "rad/s"
    return Channel(sensor, instance, t, values, unit_of, Stage.CORRECTED, "IMU")


def level(t=T):
    return Channel(Sensor.ATTITUDE, 0, t, Rotation.identity(len(t)).as_quat(scalar_first=True), "1", Stage.RAW, "ATT")


WHOLE = (TimeSpan(0.0, 120.0),)


def found(*channels, off=WHOLE):
    """Findings by check, sensor and instance."""
    made = list(inertial_findings(Recording(channels), off))
    return {(f.check, f.sensor, f.instance): f for f in made}


def of(made, check, sensor=Sensor.ACCEL, instance=0):
    return made[check, sensor, instance]


def pair(accel=(0.0, 0.0, 0.0), gyro=(0.0, 0.0, 0.0), instance=0, **kw):
    return unit(Sensor.ACCEL, instance, accel, **kw), unit(Sensor.GYRO, instance, gyro, **kw)


@pytest.mark.parametrize(
    ("down", "verdict"),
    [(-0.5, SUSPICIOUS), (-0.2, OK), (0.0, OK), (0.2, OK), (0.5, SUSPICIOUS), (-1.0, FAULTY), (1.0, FAULTY)],
)
def test_gravity_while_motionless_is_judged_by_its_length(down, verdict):
    made = of(found(*pair(accel=(0.0, 0.0, down))), "gravity")
    assert made.verdict == verdict
    assert "while motionless; gravity is 9.81" in made.text
    assert made.text.startswith(f"reads {G - down:.2f} ± 0.02 m/s2")
    assert made.value == pytest.approx(max(9.78 - (G - down), (G - down) - 9.83, 0.0), abs=0.005)


def test_an_offset_across_gravity_hardly_changes_its_length_and_is_not_found_by_it():
    assert of(found(*pair(accel=(0.6, 0.0, 0.0))), "gravity").verdict == OK


def test_a_faulty_sensor_is_not_flown_and_a_suspicious_one_is_calibrated():
    faulty = of(found(*pair(accel=(0.0, 0.0, 1.0))), "gravity")
    assert faulty.action == (
        "Calibrate the accelerometer: six faces and four oblique poses. "
        "Do not fly with it. If it comes back, replace the sensor."
    )
    suspicious = of(found(*pair(gyro=(0.04, 0.0, 0.0))), "offset", Sensor.GYRO)
    assert suspicious.action == "Calibrate the gyroscope: ten seconds at rest."
    assert of(found(*pair()), "gravity").action == ""


@pytest.mark.parametrize(("deg", "verdict"), [(0.5, OK), (1.5, SUSPICIOUS), (4.5, SUSPICIOUS), (6.0, FAULTY)])
def test_a_rate_at_rest_is_judged_by_its_length_in_deg_s(deg, verdict):
    axis = np.radians(deg) * np.array([0.6, -0.8, 0.0])
    made = of(found(*pair(gyro=axis)), "offset", Sensor.GYRO)
    assert made.verdict == verdict
    assert f"reads {deg:.2f} ± 0.01 deg/s at rest" in made.text
    assert f"({0.6 * deg:+.2f}, {-0.8 * deg:+.2f}, " in made.text


def test_a_rest_is_one_with_the_motors_off():
    for off in ((), (TimeSpan(0.0, 1.0),)):
        hover = of(found(*pair(), off=off), "offset", Sensor.GYRO)
        assert "motionless" in hover.text
        assert "at rest" not in hover.text


def test_a_vehicle_that_swung_is_judged_beside_its_attitude():
    made = found(*pair(gyro=(0.04, 0.0, 0.0), accel=(0.0, 0.0, 0.5), shake=3.0), level(), off=())
    gravity, offset = of(made, "gravity"), of(made, "offset", Sensor.GYRO)
    assert "along the vertical under way" in gravity.text
    assert gravity.verdict == SUSPICIOUS
    assert "beyond the turn of the attitude" in offset.text
    assert offset.verdict == SUSPICIOUS


def test_without_a_rest_and_an_attitude_nothing_is_told():
    made = found(*pair(shake=3.0), off=())
    gravity, offset = of(made, "gravity"), of(made, "offset", Sensor.GYRO)
    assert (gravity.verdict, offset.verdict) == (CANNOT_SAY, CANNOT_SAY)
    assert gravity.text.endswith("gravity cannot be told from motion")
    assert offset.text.endswith("an offset cannot be told from a turn")
    assert gravity.action == offset.action == "Log the attitude and faster samples, or a rest."


def drifting(amount, *, t=T, spans=12):
    """A gravity that grows by `amount` over as many motionless spans, which shakes of two seconds part."""
    accel, gyro = pair(t=t)
    part = t[-1] / spans
    step = np.floor(t / part) / (spans - 1)
    shaken = 3.0 * np.sin(9.0 * t) * ((t % part < 2.0) & (t > 2.0))
    moved = np.column_stack([shaken, np.zeros_like(t), -amount * step])
    return dataclasses.replace(accel, values=accel.values + moved), gyro


@pytest.mark.parametrize(
    ("amount", "verdict"), [(0.0, OK), (0.3, OK), (0.4, SUSPICIOUS), (0.6, SUSPICIOUS), (0.8, FAULTY)]
)
def test_gravity_that_wanders_while_nothing_moves_is_a_drift(amount, verdict):
    """The span from the 5th to the 95th percentile of twelve equal steps, less two of these, is 0.72 of their sum."""
    made = of(found(*drifting(amount)), "drift")
    assert made.verdict == verdict
    assert made.value == pytest.approx(0.9 * amount, abs=0.005)
    assert made.sd == pytest.approx(amount / 11.0, abs=0.005)
    assert f"wandered by {made.value:.2f} m/s2 in 2 min while motionless" in made.text
    assert ("m/s2 in 2 min while motionless, between 9.8" in made.text) == (verdict != OK)
    assert (made.start, made.end) == (pytest.approx(0.0, abs=2.0), pytest.approx(120.0, abs=2.0))


@pytest.mark.parametrize(
    ("seconds", "spans", "told"), [(120.0, 12, True), (120.0, 2, False), (60.0, 6, False), (120.0, 20, False)]
)
def test_a_drift_is_told_from_a_minute_in_three_spans_of_five_seconds(seconds, spans, told):
    """Twenty spans of a 120 s log are too short each: less than five seconds are left of them."""
    made = of(found(*drifting(0.8, t=T[seconds > T], spans=spans)), "drift")
    assert (made.verdict == FAULTY) == told
    if not told:
        assert made.verdict == CANNOT_SAY
        assert made.text.endswith("s in all: 60 s in 3 spans tell of a drift")
        assert (made.value, made.action) == (None, "")


def test_two_units_that_differ_and_read_right_are_both_suspicious():
    """A tilt of one board by 4 deg: neither length shows it."""
    made = found(*pair(), *pair(accel=(0.7, 0.0, 0.0), instance=1))
    for instance in (0, 1):
        units = of(made, "units", Sensor.ACCEL, instance)
        assert units.verdict == SUSPICIOUS
        assert units.text.startswith(f"differs from unit {2 - instance} by 0.70 ± 0.01 m/s2")
        assert units.text.endswith("which of them is off, this comparison cannot say")


def test_the_unit_that_is_off_by_itself_takes_the_blame():
    made = found(*pair(), *pair(accel=(0.0, 0.0, 1.0), instance=1))
    good, bad = of(made, "units", Sensor.ACCEL, 0), of(made, "units", Sensor.ACCEL, 1)
    assert (good.verdict, bad.verdict) == (OK, FAULTY)
    assert good.text.endswith("by its own check unit 2 is off")
    assert "which" not in bad.text


def test_of_two_good_gyroscopes_the_clearly_worse_one_takes_the_blame():
    """0.9 deg/s is within the limit of one, and 1.8 deg/s apart is not within that of two."""
    shift = np.radians([0.95, 0.0, 0.0])
    made = found(*pair(gyro=0.1 * shift), *pair(gyro=-shift, instance=1))
    assert of(made, "units", Sensor.GYRO, 0).verdict == OK
    apart = found(*pair(gyro=0.65 * shift), *pair(gyro=-shift, instance=1))
    text = of(apart, "units", Sensor.GYRO, 0).text
    assert text.startswith("differs from unit 2 by 1.57 ± 0.01 deg/s")
    assert text.endswith("this comparison cannot say")
    assert of(apart, "units", Sensor.GYRO, 1).verdict == SUSPICIOUS


def test_two_of_three_outvote_the_third():
    made = found(*pair(), *pair(instance=1), *pair(accel=(0.7, 0.0, 0.0), instance=2))
    assert [of(made, "units", Sensor.ACCEL, i).verdict for i in range(3)] == [OK, OK, SUSPICIOUS]
    assert of(made, "units", Sensor.ACCEL, 0).text == "agrees with unit 2"
    assert of(made, "units", Sensor.ACCEL, 2).text.startswith("differs from unit ")


def test_three_that_agree_are_all_named():
    made = found(*pair(), *pair(instance=1), *pair(instance=2))
    assert of(made, "units", Sensor.ACCEL, 1).text == "agrees with unit 1, 3"
    assert ("units", Sensor.ACCEL, 0) not in found(*pair())


def test_samples_that_are_not_physical_are_said_to_be_and_compared_with_nothing():
    accel, gyro = pair(instance=1)
    made = found(*pair(), dataclasses.replace(accel, unit="counts"), gyro)
    assert of(made, "offset", Sensor.ACCEL, 1).verdict == CANNOT_SAY
    assert ("units", Sensor.ACCEL, 0) not in made
    assert ("units", Sensor.GYRO, 0) in made


def test_a_stillness_does_not_need_more_than_a_hundred_samples_a_second():
    fast = np.arange(0.0, 20.0, 0.001)
    spans = motionless(Recording(pair(t=fast)), 0)
    assert sum(s.duration for s in spans) == pytest.approx(20.0, abs=2.0)
    assert not motionless(Recording(pair(shake=3.0)), 0)
    assert not motionless(Recording(()), 0)


def test_a_gyroscope_far_off_does_not_hide_that_nothing_moved():
    made = of(found(*pair(gyro=np.radians([0.0, 0.0, 100.0]))), "offset", Sensor.GYRO)
    assert made.verdict == FAULTY
    assert "reads 100.00 ± 0.01 deg/s at rest" in made.text
