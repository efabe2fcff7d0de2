from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.fit import FitStatus
from mavcal.calib.logs import read
from mavcal.calib.mag.gyro_aided import fit_gyro_aided
from mavcal.calib.methods import METHODS
from mavcal.calib.recording import Channel, Sensor, Stage

FIELD = 50.0
MOUNTING = Rotation.from_euler("xyz", [4.0, -3.0, 170.0], degrees=True).as_matrix()  # sensor from gyroscope
IRON = np.array([[1.06, 0.03, -0.02], [0.03, 0.95, 0.015], [-0.02, 0.015, 1.03]])
OFFSET = np.array([12.0, -8.0, 20.0])
BIAS = np.array([0.01, -0.006, 0.004])
TRUE = np.linalg.inv(IRON @ MOUNTING)


def moved(rng, seconds=40.0, swing=1.0, delay=0.0, mag_sd=0.3, gyro_sd=0.003, gyro_matrix=None, axes=(1.0, 1.0, 1.0)):
    """A compass at 10 Hz and a gyroscope at 100 Hz on a unit that a hand waves about."""
    t = np.arange(int(seconds * 100.0)) / 100.0
    rate = swing * np.column_stack(
        [np.sin(1.1 * t) + 0.4 * np.cos(2.3 * t), 1.1 * np.cos(0.7 * t + 0.3), 0.9 * np.sin(0.9 * t + 1.0)]
    )
    rate = rate * axes
    body, field = np.eye(3), np.empty((len(t), 3))
    for k, half in enumerate(Rotation.from_rotvec(rate / 200.0).as_matrix()):
        body = body @ half
        field[k] = body.T @ [20.0, 5.0, np.sqrt(FIELD**2 - 425.0)]
        body = body @ half
    gyro = rate if gyro_matrix is None else rate @ np.linalg.inv(gyro_matrix).T
    gyro = gyro + BIAS + gyro_sd * rng.normal(size=rate.shape)
    seen = t[40:-10:10] + delay
    at = np.column_stack([np.interp(t[40:-10:10], t, column) for column in field.T])
    mag = at @ (IRON @ MOUNTING).T + OFFSET + mag_sd * rng.normal(size=at.shape)
    return (
        Channel(Sensor.MAG, 0, seen, mag, "uT", Stage.RAW, "test"),
        Channel(Sensor.GYRO, 0, t, gyro, "rad/s", Stage.RAW, "test"),
    )


def scaled(matrix):
    return matrix / np.cbrt(abs(np.linalg.det(matrix)))


def test_offset_matrix_mounting_and_the_bias_of_the_gyroscope():
    fit = fit_gyro_aided(*moved(np.random.default_rng(1)))
    assert fit.status == FitStatus.OK
    assert np.abs((fit.model.offset - OFFSET) / fit.sd[:3]).max() < 4.0
    length = np.cbrt(np.linalg.det(fit.model.matrix))
    assert np.abs((fit.model.matrix / length - scaled(TRUE)) / fit.sd[3:].reshape(3, 3)).max() < 4.0
    assert fit.sd[:3].max() < 0.3
    assert fit.native["rotation_sd_deg"] < 0.5
    polar = Rotation.from_matrix(np.array(fit.native["gyro_from_mag"]) @ MOUNTING)
    assert np.degrees(polar.magnitude()) < 1.0  # the iron has a little rotation of its own
    assert np.abs((fit.native["gyro_bias"] - BIAS) / fit.native["gyro_bias_sd"]).max() < 4.0
    assert abs(fit.native["delay"]) < 4.0 * fit.native["delay_sd"]
    assert fit.quality["noise_sd"] == pytest.approx(0.3, rel=0.15)
    assert fit.quality["heading_sd_deg"] < 2.0
    assert any("scale" in text for text in fit.warnings)


@pytest.mark.long
def test_the_stated_uncertainty_holds():
    squares = []
    for seed in range(8):
        fit = fit_gyro_aided(*moved(np.random.default_rng([2, seed]), seconds=25.0), delay=0.0)
        error = fit.model.offset - OFFSET
        squares.append(error @ np.linalg.solve(fit.covariance[:3, :3], error) / 3.0)
    assert 0.35 < np.mean(squares) < 2.0  # 24 degrees of freedom


def test_a_little_waving_gives_the_offset_that_an_ellipsoid_cannot():
    fit = fit_gyro_aided(*moved(np.random.default_rng(3), seconds=60.0, swing=0.35))
    assert fit.status == FitStatus.OK
    assert np.abs((fit.model.offset - OFFSET) / fit.sd[:3]).max() < 4.0


@pytest.mark.long
def test_the_delay_of_the_compass_is_found():
    fit = fit_gyro_aided(*moved(np.random.default_rng(4), delay=0.05))
    assert fit.native["delay"] == pytest.approx(0.05, abs=4.0 * fit.native["delay_sd"])
    assert fit.native["delay_sd"] < 0.003


@pytest.mark.long
def test_a_gyroscope_that_is_off_is_estimated_too():
    wrong = np.array([[0.95, 0.02, 0.0], [-0.01, 1.06, 0.0], [0.0, 0.015, 0.97]])
    fit = fit_gyro_aided(*moved(np.random.default_rng(5), gyro_matrix=wrong, mag_sd=0.1))
    assert fit.native["gyro_matrix"] is not None
    assert np.diag(fit.native["gyro_matrix"]) == pytest.approx(np.diag(wrong), abs=0.01)
    assert any("calibrate it" in text for text in fit.warnings)
    assert np.abs((fit.model.offset - OFFSET) / fit.sd[:3]).max() < 4.0


@pytest.mark.long
@settings(max_examples=3)
@given(seed=st.integers(0, 2**31), factor=st.floats(0.3, 3.0), shift=st.floats(-40.0, 40.0))
def test_turning_scaling_and_shifting_the_data_moves_the_answer_accordingly(seed, factor, shift):
    mag, gyro = moved(np.random.default_rng(6), seconds=20.0)
    fit = fit_gyro_aided(mag, gyro, delay=0.0, unit="counts")
    Q = Rotation.random(random_state=seed).as_matrix()
    turned = dataclasses.replace(mag, values=factor * mag.values @ Q.T + shift)
    other = fit_gyro_aided(turned, gyro, delay=0.0, unit="counts")
    assert other.model.offset == pytest.approx(factor * Q @ fit.model.offset + shift, abs=0.02 * factor)
    assert scaled(other.model.matrix) == pytest.approx(scaled(fit.model.matrix) @ Q.T, abs=2e-3)


@pytest.mark.long
def test_what_the_motion_does_not_tell_is_refused():
    rng = np.random.default_rng(7)
    one_axis = fit_gyro_aided(*moved(rng, axes=(0.0, 0.0, 1.0)))
    assert one_axis.status == FitStatus.REFUSED
    assert one_axis.undetermined
    assert "two axes" in one_axis.movements[one_axis.undetermined[0]]
    mag, gyro = moved(rng)
    assert "30 are needed" in fit_gyro_aided(mag.take(slice(0, 10)), gyro).message
    still = fit_gyro_aided(*moved(rng, swing=0.001, gyro_sd=1e-5))
    assert still.status == FitStatus.REFUSED
    noise = dataclasses.replace(mag, values=rng.normal(size=mag.values.shape))
    assert fit_gyro_aided(noise, gyro).status == FitStatus.REFUSED
    stuck = dataclasses.replace(mag, values=np.ones_like(mag.values))
    assert "constant" in fit_gyro_aided(stuck, gyro).message
    later = dataclasses.replace(mag, t=mag.t + 1e4)
    assert "gyroscope's time" in fit_gyro_aided(later, gyro).message.replace(
        "time of the gyroscope", "gyroscope's time"
    )
    with pytest.raises(InvalidInputError, match="rad/s"):
        fit_gyro_aided(mag, dataclasses.replace(gyro, unit="counts"))
    with pytest.raises(InvalidInputError, match="delay"):
        fit_gyro_aided(mag, gyro, delay=2.0)
    with pytest.raises(InvalidInputError, match="goes back"):
        fit_gyro_aided(dataclasses.replace(mag, t=mag.t[::-1]), gyro)


@pytest.mark.long
@pytest.mark.shared
def test_a_tumbling_vehicle_of_real_firmware(shared_data):
    fit = METHODS["mag-gyro"].run(read(shared_data / "sitl_captures/tumble.tlog"), {"instance": 0})[0]
    assert fit.status == FitStatus.OK
    assert fit.model.offset == pytest.approx([-9.0, 5.5, -3.5], abs=0.002)
    assert np.abs((fit.model.offset - [-9.0, 5.5, -3.5]) / fit.sd[:3]).max() < 4.0
    iron = np.array([[1.06, 0.03, -0.02], [0.03, 0.95, 0.015], [-0.02, 0.015, 1.03]])
    assert scaled(fit.model.matrix) == pytest.approx(scaled(iron), abs=0.02)
    assert fit.native["rotation_deg"] < 3.0 * fit.native["rotation_sd_deg"]


@pytest.mark.long
@pytest.mark.shared
def test_turns_with_an_uncalibrated_gyroscope_of_real_firmware(shared_data):
    fit = METHODS["mag-gyro"].run(read(shared_data / "px4_captures/bench_turn.tlog"), {"instance": 0})[0]
    assert fit.model.offset == pytest.approx([9.0, -5.5, 3.5], abs=0.03)
    assert np.diag(fit.native["gyro_matrix"]) == pytest.approx([1 / 1.03, 1 / 0.98, 1 / 1.04], abs=5e-4)
    assert fit.native["gyro_bias"] == pytest.approx([0.0132, -0.0284, 0.0057], abs=1e-3)
