from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavcal.calib.fit import FitStatus
from mavcal.calib.gyro.rest import LARGEST_BIAS, PLAUSIBLE_BIAS, fit_gyro_rest, steady_turn
from mavcal.calib.recording import Channel, Sensor, Stage

G = 9.80665
OFFSET = np.array([0.0132, -0.0084, 0.0057])


def series(sensor, values, unit, rate=50.0):
    return Channel(sensor, 0, np.arange(len(values)) / rate, np.asarray(values, dtype=float), unit, Stage.RAW, "test")


def gyro_of(rng, mean, n=500, sd=0.002):
    return series(Sensor.GYRO, mean + sd * rng.normal(size=(n, 3)), "rad/s")


def accel_of(rng, n=500, turn=(0.0, 0.0, 0.0), rate=50.0, tilt=0.0):
    """Gravity seen by a body that turns with `turn` (rad/s) from level, or from a tilt about x."""
    force = np.tile([0.0, -G * np.sin(tilt), -G * np.cos(tilt)], (n, 1))
    angle = np.asarray(turn) * (np.arange(n) / rate)[:, None]
    moved = force - np.cross(angle, force)
    return series(Sensor.ACCEL, moved + 0.02 * rng.normal(size=(n, 3)), "m/s2")


def mag_of(rng, n=500, yaw_rate=0.0, rate=50.0):
    psi = yaw_rate * np.arange(n) / rate
    field = np.column_stack([20.0 * np.cos(psi), -20.0 * np.sin(psi), np.full(n, 40.0)])
    return series(Sensor.MAG, field + [10.0, -5.0, 3.0] + 0.2 * rng.normal(size=(n, 3)), "uT")


def test_the_offset_is_the_mean_with_its_standard_error():
    rng = np.random.default_rng(1)
    fit = fit_gyro_rest(gyro_of(rng, OFFSET, n=5000), accel=accel_of(rng, n=5000), temperature=31.5)
    assert fit.status == FitStatus.OK
    assert np.abs(fit.model.offset - OFFSET).max() < 4.0 * 0.002 / np.sqrt(5000)
    assert fit.sd[:3] == pytest.approx(0.002 / np.sqrt(5000), rel=0.25)
    assert (fit.sd[3:] == 0.0).all()
    assert (fit.model.matrix == np.eye(3)).all()
    assert fit.temperature == 31.5
    assert fit.undetermined == ()


def test_the_stated_sd_holds():
    rng = np.random.default_rng(2)
    z = []
    for _ in range(100):
        fit = fit_gyro_rest(gyro_of(rng, OFFSET, n=300))
        z.append((fit.model.offset - OFFSET) / fit.sd[:3])
    assert 0.8 < np.mean(np.square(z)) < 1.25


@given(seed=st.integers(0, 100), order=st.permutations([0, 1, 2]), scale=st.floats(0.1, 3.0))
def test_axes_may_be_permuted_and_scaled(seed, order, scale):
    gyro = gyro_of(np.random.default_rng(seed), OFFSET, n=100)
    other = dataclasses.replace(gyro, values=scale * gyro.values[:, order])
    assert fit_gyro_rest(other).model.offset == pytest.approx(
        scale * fit_gyro_rest(gyro).model.offset[order], abs=1e-12
    )


def test_a_quiet_truncated_gyroscope_says_that_more_samples_do_not_help(raw_channel):
    t = np.arange(1000) / 50.0
    values = np.random.default_rng(3).normal([0.0003, 0.0014, -0.0025], 4e-5, (1000, 3))
    fit = fit_gyro_rest(raw_channel(Sensor.GYRO, t, values, "rad/s", quantum=1e-3))
    assert fit.status == FitStatus.OK
    assert fit.model.offset == pytest.approx([0.0, 0.0015, -0.0025])
    assert fit.sd[:3] == pytest.approx([2e-3 / np.sqrt(12), 1e-3 / np.sqrt(12), 1e-3 / np.sqrt(12)])
    assert any("one bin" in w and "HIGHRES_IMU" in w for w in fit.warnings)


def test_a_constant_axis_of_unknown_resolution_is_named_and_not_estimated():
    gyro = gyro_of(np.random.default_rng(4), OFFSET)
    gyro.values[:, 2] = -2.0e-3
    fit = fit_gyro_rest(gyro)
    assert fit.status == FitStatus.PARTIAL
    assert fit.undetermined == ("offset_z",)
    assert fit.model.offset[2] == 0.0
    assert np.isnan(fit.sd[2])
    stuck = dataclasses.replace(gyro, values=np.full((500, 3), 0.01))
    assert "stuck" in fit_gyro_rest(stuck).message


def test_a_turn_about_a_level_axis_moves_gravity():
    rng = np.random.default_rng(5)
    turn = np.array([0.03, 0.0, 0.0])
    fit = fit_gyro_rest(gyro_of(rng, turn), accel=accel_of(rng, turn=turn))
    assert fit.status == FitStatus.REFUSED
    assert "gravity turns" in fit.message
    assert "put the vehicle down" in fit.message


def test_a_turn_about_the_vertical_of_a_tilted_vehicle_leaves_gravity_but_not_the_compass():
    rng = np.random.default_rng(6)
    turn = np.array([0.0, 0.0, 0.05])
    gyro, accel = gyro_of(rng, turn), accel_of(rng)
    assert "compass turns" in (steady_turn(gyro, accel, mag_of(rng, yaw_rate=0.05)) or "")
    assert steady_turn(gyro, accel, mag_of(rng)) is None


def test_without_a_compass_only_the_size_tells():
    rng = np.random.default_rng(7)
    below, above = [0.0, 0.0, 0.9 * PLAUSIBLE_BIAS], [0.0, 0.0, 1.1 * PLAUSIBLE_BIAS]
    assert fit_gyro_rest(gyro_of(rng, below), accel=accel_of(rng)).status == FitStatus.OK
    refused = fit_gyro_rest(gyro_of(rng, above), accel=accel_of(rng))
    assert refused.status == FitStatus.REFUSED
    assert "more than a bias" in refused.message
    vouched = fit_gyro_rest(gyro_of(rng, above), accel=accel_of(rng), mag=mag_of(rng))
    assert vouched.status == FitStatus.OK
    assert fit_gyro_rest(gyro_of(rng, [0.0, 0.0, 1.1 * LARGEST_BIAS]), mag=mag_of(rng)).status == FitStatus.REFUSED


def test_a_rest_that_was_disturbed_is_refused():
    rng = np.random.default_rng(8)
    gyro = gyro_of(rng, OFFSET, n=600)
    gyro.values[450:, 1] += 0.01
    fit = fit_gyro_rest(gyro)
    assert fit.status == FitStatus.REFUSED
    assert "the rate about y changed" in fit.message


def test_a_slow_drift_is_not_a_motion():
    rng = np.random.default_rng(9)
    gyro = gyro_of(rng, OFFSET, n=3000)
    drift = np.linspace(0.0, np.radians(0.05), 3000)  # 0.05 deg/s a minute, as the simulated ArduPilot's
    gyro.values[:, 2] += drift
    fit = fit_gyro_rest(gyro)
    assert fit.status == FitStatus.OK
    assert abs(fit.model.offset[2] - OFFSET[2] - drift.mean()) < 4.0 * fit.sd[2]
    assert fit.sd[2] > 1.5 * fit.sd[0]


@pytest.mark.parametrize("n", [0, 1, 31])
def test_too_few_samples(n):
    fit = fit_gyro_rest(gyro_of(np.random.default_rng(10), OFFSET, n=n))
    assert fit.status == FitStatus.REFUSED
    assert "32 are needed" in fit.message


def test_rows_without_numbers_do_not_count():
    gyro = gyro_of(np.random.default_rng(11), OFFSET)
    gyro.values[::5] = np.nan
    fit = fit_gyro_rest(gyro)
    assert fit.status == FitStatus.OK
    assert (fit.n_samples, fit.n_used) == (500, 400)


def test_counts_are_fitted_but_a_turn_cannot_be_told():
    gyro = dataclasses.replace(gyro_of(np.random.default_rng(12), 32_768.0, sd=5.0), unit="counts")
    fit = fit_gyro_rest(gyro)
    assert fit.status == FitStatus.OK
    assert fit.unit == "counts"
    assert any("steady turn" in w for w in fit.warnings)


def test_an_unknown_calibration_in_force_marks_the_fit():
    assert fit_gyro_rest(gyro_of(np.random.default_rng(13), OFFSET), relative=True).relative
