"""Why a compass and a gyroscope give no fit, each reason by its number, and what a fit warns of."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.fit import FitStatus
from mavcal.calib.mag.gyro_aided import fit_gyro_aided
from mavcal.calib.recording import Channel, Sensor, Stage
from tests.fields import field_of

OFFSET = np.array([10.0, -5.0, 15.0])
FIELD = np.array([20.0, 5.0, 45.0])  # uT, north-east-down


def waved(seconds=16.0, *, bias=(0.01, -0.006, 0.004), noise=0.2, strength=1.0, speed=1.0, seed=1):
    """A compass at 10 Hz and a gyroscope at 100 Hz that a hand waves about."""
    rng = np.random.default_rng(seed)
    t = np.arange(int(seconds * 100.0)) / 100.0
    rate = speed * np.column_stack([np.sin(1.1 * t), 1.1 * np.cos(0.7 * t + 0.3), 0.9 * np.sin(0.9 * t + 1.0)])
    body, field = np.eye(3), np.empty((len(t), 3))
    for k, half in enumerate(Rotation.from_rotvec(rate / 200.0).as_matrix()):
        body = body @ half
        field[k] = body.T @ (strength * FIELD)
        body = body @ half
    mag = field[40:-10:10] + OFFSET + noise * rng.normal(size=(len(t[40:-10:10]), 3))
    return (
        Channel(Sensor.MAG, 0, t[40:-10:10], mag, "uT", Stage.RAW, "made"),
        Channel(Sensor.GYRO, 0, t, rate + bias + 0.003 * rng.normal(size=rate.shape), "rad/s", Stage.RAW, "made"),
    )


@pytest.fixture(scope="module")
def hand():
    return waved()


def reason(mag, gyro, **options):
    fit = fit_gyro_aided(mag, gyro, **options)
    assert fit.status == FitStatus.REFUSED
    assert fit.undetermined
    return fit.message


def with_values(channel, values):
    return dataclasses.replace(channel, values=values)


@pytest.mark.parametrize("n", [29, 30])
def test_thirty_samples_of_the_compass_are_the_least(hand, n):
    mag, gyro = hand
    elsewhere = dataclasses.replace(mag.take(slice(0, n)), t=100.0 + mag.t[:n])  # refused anyway, for another reason
    said = reason(elsewhere, gyro)
    assert ("29 finite" in said and "the mag:" in said) is (n == 29)


@pytest.mark.parametrize("n", [59, 60])
def test_sixty_samples_of_the_gyroscope_are_the_least(hand, n):
    mag, gyro = hand
    said = reason(mag, gyro.take(slice(0, n)))
    assert ("59 finite" in said and "the gyro:" in said) is (n == 59)


def test_rows_without_numbers_do_not_count(hand):
    mag, gyro = hand
    values = mag.values.copy()
    values[25:, 1] = np.nan
    said = reason(with_values(mag, values), gyro)
    assert "25 finite" in said
    assert "the mag:" in said


@pytest.mark.parametrize("which", [0, 1])
def test_numbers_that_no_sensor_measures_are_named(hand, which):
    channels = list(hand)
    channels[which] = with_values(channels[which], channels[which].values * 1e13)
    name, unit = (("mag", "uT"), ("gyro", "rad/s"))[which]
    said = reason(*channels)
    assert f"the {name} " in said
    assert f"{np.abs(channels[which].values).max():.3g} {unit}" in said


@pytest.mark.parametrize("which", [0, 1])
def test_a_sensor_that_stands_on_an_axis_is_named(hand, which):
    channels = list(hand)
    channels[which] = with_values(channels[which], channels[which].values * [1.0, 0.0, 1.0])
    said = reason(*channels)
    assert ("the mag ", "the gyro ")[which] in said
    assert "constant value" in said


def test_samples_outside_of_the_gyroscopes_time_do_not_serve(hand):
    mag, gyro = hand
    late = dataclasses.replace(mag, t=mag.t + 13.5)
    inside = int((late.t <= gyro.t[-1]).sum())
    assert 0 < inside < 30
    assert reason(late, gyro) == f"{inside} samples of the compass lie in the time of the gyroscope: 30 are needed"


def test_degrees_that_pass_for_radians_are_told_by_their_speed(hand):
    mag, gyro = hand
    fast = with_values(gyro, np.degrees(gyro.values) * 2.0)
    said = reason(mag, fast)
    assert "gyroscope" in said
    assert f"{np.median(np.linalg.norm(fast.values, axis=1)):.3g} rad/s" in said
    assert "deg/s" in said


def test_a_unit_that_hardly_turns_is_told_by_how_much(hand):
    mag, gyro = hand
    quiet = with_values(gyro, np.outer(0.01 * np.sin(gyro.t), [1.0, 1.0, 1.0]))
    # the mean of |0.01 sin t| over sixteen seconds, on three axes, in degrees
    assert "10 degrees" in reason(mag, quiet)


def test_impossible_input_is_an_error(hand):
    mag, gyro = hand
    with pytest.raises(InvalidInputError, match=r"the delay of a compass is at most 0\.3 s either way, not -0\.31"):
        fit_gyro_aided(mag, gyro, delay=-0.31)
    with pytest.raises(InvalidInputError, match="the mag needs three columns, not 2"):
        fit_gyro_aided(with_values(mag, mag.values[:, :2]), gyro)
    with pytest.raises(InvalidInputError, match="the time of the gyro goes back or is not finite: sort the samples"):
        fit_gyro_aided(mag, dataclasses.replace(gyro, t=gyro.t[::-1]))


def warned(fit, text):
    assert fit.status == FitStatus.OK
    return any(text in warning for warning in fit.warnings)


def test_an_offset_of_the_gyroscope_that_is_large_is_said(hand):
    large = fit_gyro_aided(*waved(bias=(0.1, 0.1, 0.0)), delay=0.0)
    size = float(np.linalg.norm(large.native["gyro_bias"]))
    assert size == pytest.approx(0.1414, rel=0.02)
    assert warned(large, f"{size:.3g} rad/s")
    assert not warned(fit_gyro_aided(*hand, delay=0.0), "rad/s")


@pytest.mark.parametrize(("strength", "told"), [(0.38, True), (0.45, False), (1.38, False), (1.55, True)])
def test_a_field_that_is_not_the_earths_is_said(strength, told):
    """Beyond 22 to 67 uT by 12 %, of a field of 49.5 times the factor."""
    mag, gyro = waved(strength=strength)
    assert warned(fit_gyro_aided(mag, gyro, delay=0.0), "67 uT") is told


def test_a_known_field_gives_the_scale_and_its_uncertainty(hand):
    mag, gyro = hand
    size = float(np.linalg.norm(FIELD))
    place = field_of(size, np.radians(60.0), 0.0, norm_sd=0.05 * size)
    bare, known = fit_gyro_aided(mag, gyro, delay=0.0), fit_gyro_aided(mag, gyro, delay=0.0, field=place)
    assert warned(bare, "field strength unknown: the matrix keeps the mean radius")
    assert not warned(known, "field strength unknown")
    corrected = np.linalg.norm(known.model.apply(mag.values), axis=1)
    assert corrected == pytest.approx(np.full(len(mag), size), rel=0.03)
    assert known.sd[3] == pytest.approx(0.05, rel=0.05)  # a twentieth of a number of about one
    assert bare.sd[3] < 0.02
