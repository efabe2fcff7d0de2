from __future__ import annotations

import math

import numpy as np
import pytest

from mavcal.calib.earth import local_gravity
from mavcal.calib.preflight import limits
from mavcal.calib.preflight.check import CheckId, Verdict
from mavcal.calib.preflight.inertial import accel_force, force_measures, gyro_noise, gyro_rest, rest_measures
from mavcal.calib.preflight.rest import Mean, Silent, evidence_lines, mean_at_rest, moved
from mavcal.calib.recording import Channel, Recording, Sensor, Stage

G = 9.80665


def mean(*value: float, sd: float = 1e-4, noise: float = 1e-3, change: float = 0.0) -> Mean:
    return Mean(np.array(value), np.full(3, sd), np.full(3, noise), change, 300, 6.0)


def rate(deg_s: float, **more: float) -> Mean:
    return mean(0.0, math.radians(deg_s), 0.0, **more)


@pytest.mark.parametrize(("deg_s", "verdict"), [(0.0, Verdict.PASS), (0.49, Verdict.PASS), (0.6, Verdict.FAIL)])
def test_a_gyroscope_at_rest_reads_zero(deg_s, verdict):
    found = gyro_rest({0: rate(0.1), 1: rate(deg_s)}, (), None)
    assert found.verdict is verdict
    if verdict is Verdict.FAIL:
        assert "gyroscope 2" in found.reason
        assert "gyroscopes at rest" in found.remedy


def test_the_turn_of_the_earth_is_no_certainty():
    [measure] = rest_measures({0: rate(0.505)}).values()
    assert measure.verdict is Verdict.WARN
    assert measure.sd >= limits.EARTH_RATE_DEG_S


@pytest.mark.parametrize(("deg_s", "verdict"), [(0.05, Verdict.PASS), (0.52, Verdict.WARN), (0.7, Verdict.FAIL)])
def test_a_gyroscope_is_as_quiet_as_its_worst_axis(deg_s, verdict):
    noisy = Mean(np.zeros(3), np.full(3, 1e-4), np.radians([0.01, 0.01, deg_s]), 0.0, 300, 6.0)
    assert gyro_noise({0: rate(0.0), 1: noisy}, (), None).verdict is verdict


@pytest.mark.parametrize("check", [gyro_rest, gyro_noise, lambda *asked: accel_force(*asked, None)])
def test_what_moves_or_is_silent_is_not_judged(check):
    there = {0: mean(1.0, 2.0, 3.0)}
    moving = check(there, (), "the vehicle was moved")
    assert (moving.verdict, "the vehicle was moved" in moving.reason) == (Verdict.UNKNOWN, True)
    assert "was heard" in check({}, (), None).reason
    silent = check({}, ("only 2 samples came",), "the vehicle was moved")
    assert (silent.verdict, "only 2 samples came" in silent.reason) == (Verdict.UNKNOWN, True)


@pytest.mark.parametrize(("off", "verdict"), [(0.0, Verdict.PASS), (0.1, Verdict.PASS), (0.3, Verdict.FAIL)])
def test_an_accelerometer_reads_gravity_whichever_way_it_lies(off, verdict):
    lying = mean(*((G + off) * np.array([0.6, 0.0, -0.8])))
    found = accel_force({0: lying}, (), None, None)
    assert found.verdict is verdict
    assert found.value == pytest.approx(off, abs=1e-9)


def test_gravity_is_that_of_the_place():
    pole = local_gravity(90.0, 0.0)
    there = {0: mean(0.0, 0.0, -pole)}
    [known] = force_measures(there, (90.0, 0.0)).values()
    [standard] = force_measures(there, None).values()
    assert known.value == pytest.approx(0.0, abs=1e-9)
    assert standard.value == pytest.approx(pole - G, abs=1e-9)


def test_two_accelerometers_that_read_g_in_two_directions_differ():
    tilted = mean(G * math.sin(0.1), 0.0, -G * math.cos(0.1))
    found = accel_force({0: mean(0.0, 0.0, -G), 1: tilted}, (), None, None)
    assert found.verdict is Verdict.FAIL
    assert found.value == pytest.approx(2.0 * G * math.sin(0.05), rel=1e-6)
    assert "difference of accelerometers 1 and 2" in found.reason
    assert found.suspects == ("accelerometer 1", "accelerometer 2")  # both read g
    assert "another side" in found.remedy


@pytest.mark.parametrize("off", [0, 1])
def test_of_two_accelerometers_gravity_tells_which_is_off(off):
    there = {i: mean(0.05, 0.0, -G + 0.3 * (i == off)) for i in (0, 1)}
    found = accel_force(there, (), None, None)
    assert (found.verdict, found.suspects) == (Verdict.FAIL, (f"accelerometer {off + 1}",))


def test_a_check_on_fewer_than_are_installed_never_says_all():
    two = {0: rate(0.0), 2: rate(0.0)}
    for check in (gyro_rest(two, (), None, installed=3), gyro_noise(two, (), None, installed=3)):
        assert check.verdict == Verdict.PASS
        assert check.reason.startswith("2 of")
        assert "3 gyroscopes" in check.reason
    assert gyro_rest(two, (), None).reason.startswith("All 2")
    assert "only accelerometer" in accel_force({0: mean(0.0, 0.0, -G)}, (), None, None).reason


def test_of_three_the_one_that_is_off_is_named():
    level = mean(0.0, 0.0, -G)
    tilted = mean(G * math.sin(0.1), 0.0, -G * math.cos(0.1))
    found = accel_force({0: level, 1: tilted, 2: level}, (), None, None)
    assert found.reason.startswith("vector of accelerometer 2 from the others")
    assert len([line for line in found.evidence if "vector of" in line]) == 3


def test_every_check_says_what_it_looked_at():
    there = {1: mean(0.0, 0.0, -G)}
    assert evidence_lines(there, "accelerometer") == ("accelerometer 2: 300 samples over 6.0 s",)
    found = accel_force(there, ("accel 1 was not heard",), None, None)
    assert found.id is CheckId.ACCEL_FORCE
    assert {"accelerometer 2: 300 samples over 6.0 s", "accel 1 was not heard"} <= set(found.evidence)


T = np.arange(300) / 50.0


def recorded(values, t=T, sensor=Sensor.GYRO, instance=0):
    return Recording((Channel(sensor, instance, t, values, "rad/s", Stage.CORRECTED, "IMU"),))


def noise(seed=1, sd=0.01):
    return sd * np.random.default_rng(seed).normal(size=(len(T), 3))


def test_the_mean_at_rest_has_its_uncertainty():
    off = np.array([0.1, -0.2, 0.3])
    misses = []
    for seed in range(20):
        found = mean_at_rest(recorded(off + noise(seed)), Sensor.GYRO, 0)
        assert found.noise == pytest.approx([0.01] * 3, rel=0.2)
        misses.append((found.value - off) / found.sd)
    assert np.std(misses) == pytest.approx(1.0, abs=0.3)
    assert (found.samples, found.seconds) == (300, pytest.approx(T[-1]))


def test_spikes_and_gaps_cost_nothing():
    values = noise()
    values[10], values[20, 1] = 50.0, np.nan
    found = mean_at_rest(recorded(values), Sensor.GYRO, 0)
    assert np.abs(found.value).max() < 0.005
    assert found.samples == 298


@pytest.mark.parametrize(("count", "instance", "why"), [(19, 0, "only 19 samples"), (300, 1, "was not heard")])
def test_too_few_samples_say_nothing(count, instance, why):
    found = mean_at_rest(recorded(noise()[:count], T[:count]), Sensor.GYRO, instance)
    assert isinstance(found, Silent)
    assert why in found.why
    assert f"gyro {instance + 1}" in found.why


def test_the_change_is_that_of_the_half_second_that_differs_most():
    values = noise(sd=1e-6)
    values[100:125, 0] += 0.12  # half a second of six
    found = mean_at_rest(recorded(values), Sensor.GYRO, 0)
    assert found.change == pytest.approx(0.12 * 11 / 12, rel=0.01)


def test_a_vehicle_was_moved_if_every_unit_says_so():
    still, turning = rate(0.0), rate(0.0, change=math.radians(5.0))
    level, shaken = mean(0.0, 0.0, -G), mean(0.0, 0.0, -G, change=1.0)
    assert moved({0: still, 1: turning}, {0: level, 1: shaken}) is None  # each by itself is a fault of its own
    assert "rate changed by 5.0 deg/s" in moved({0: turning, 1: turning}, {0: level})
    assert "force changed by 1.00 m/s2" in moved({0: still}, {0: shaken})
    assert moved({}, {}) is None


def test_the_length_of_a_mean_is_as_uncertain_as_the_mean_along_it():
    long = Mean(np.array([0.0, 3.0, 4.0]), np.array([1.0, 0.1, 0.0]), np.zeros(3), 0.0)
    assert (long.norm, long.norm_sd) == (5.0, pytest.approx(0.06))
    short = Mean(np.array([0.0, 0.03, 0.04]), np.array([1.0, 0.1, 0.0]), np.zeros(3), 0.0)
    assert short.norm_sd == pytest.approx(math.hypot(1.0, 0.1))  # it may be of any length
