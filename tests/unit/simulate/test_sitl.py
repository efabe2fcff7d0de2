from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.firmware.in_force.undo import undo
from mavcal.calib.logs import read
from mavcal.calib.recording import Sensor
from mavcal.calib.simulate import SensorErrors, SensorSuite, Warming, from_sitl, to_sitl
from mavcal.calib.simulate.typical import typical
from mavcal.calib.stats.still_limits import HELD
from mavcal.calib.stats.stillness import find_still, pose_means


def vector(name: str, values) -> dict[str, float]:
    return {f"{name}_{axis}": float(v) for axis, v in zip("XYZ", values, strict=True)}


def test_a_scaled_accelerometer_is_divided_and_then_biased():
    sensors = from_sitl({**vector("SIM_ACC1_SCAL", (1.25, 0.8, 0.0)), **vector("SIM_ACC1_BIAS", (0.1, -0.2, 0.3))})
    reading = sensors.suite.accel.systematic(np.array([[10.0, 10.0, -9.8]]))
    np.testing.assert_allclose(reading, [[8.1, 12.3, -9.5]])
    # INS_ACCSCAL = SIM_ACC_SCAL and INS_ACCOFFS = SIM_ACC_BIAS undo it: scale (reading - offset)
    np.testing.assert_allclose(sensors.suite.accel.correction.matrix, np.diag([1.25, 0.8, 1.0]))
    np.testing.assert_allclose(sensors.suite.accel.correction.offset, [0.1, -0.2, 0.3])


def test_a_gyro_is_scaled_in_percent_with_its_drift_and_then_biased():
    parameters = {
        **vector("SIM_GYR1_SCALE", (3.0, -2.0, 4.0)),
        **vector("SIM_GYR1_BIAS", (0.0132, -0.0084, 0.0057)),
        **vector("SIM_IMUT1_GYR1", (350.0, -250.0, 150.0)),
        "SIM_IMUT1_TMIN": 0.0,
        "SIM_IMUT1_TMAX": 70.0,
    }
    gyro = from_sitl(parameters).suite.gyro
    reading = gyro.systematic(np.array([[1.0, 1.0, 1.0]]), np.array([45.0]))
    np.testing.assert_allclose(
        reading, [[1.0035 * 1.03 + 0.0132, 0.9975 * 0.98 - 0.0084, 1.0015 * 1.04 + 0.0057]], rtol=1e-12
    )


def test_a_compass_is_what_the_firmware_corrects_with_equal_numbers():
    diagonal, off, offsets = np.array([1.06, 0.95, 1.03]), np.array([0.03, -0.02, 0.015]), np.array([90.0, -55.0, 35.0])
    mag = from_sitl(
        {**vector("SIM_MAG1_DIA", diagonal), **vector("SIM_MAG1_ODI", off), **vector("SIM_MAG1_OFS", offsets)}
    ).suite.mag
    field = np.array([20.0, -3.0, 41.0])
    raw_mgauss = 10.0 * mag.systematic(field[None])[0]
    ellipsoid = np.array([[1.06, 0.03, -0.02], [0.03, 0.95, 0.015], [-0.02, 0.015, 1.03]])
    np.testing.assert_allclose(ellipsoid @ (raw_mgauss + offsets), 10.0 * field)
    scaled = from_sitl({"SIM_MAG1_SCALING": 2.0, **vector("SIM_MAG1_OFS", offsets)}).suite.mag
    np.testing.assert_allclose(10.0 * scaled.systematic(field[None])[0], 2.0 * (10.0 * field - offsets))


def test_a_trim_turns_the_accelerometer():
    accel = from_sitl({"SIM_ACC_TRIM_X": 0.1}).suite.accel  # rolled by 0.1: level reads a side force
    reading = accel.systematic(np.array([[0.0, 0.0, -9.8]]))
    np.testing.assert_allclose(reading, [[0.0, -9.8 * np.sin(0.1), -9.8 * np.cos(0.1)]])


def test_names_without_a_number_are_the_first_instance():
    old = {"SIM_ACC_BIAS_X": 0.2, "SIM_MAG_OFS_Y": 10.0}
    assert from_sitl(old).suite.accel.bias[0] == 0.2
    assert from_sitl(old).suite.mag.bias[1] == -1.0
    assert from_sitl(old, instance=1).suite.accel.bias[0] == 0.0


def test_temperature_and_what_has_no_counterpart():
    sensors = from_sitl(
        {"SIM_IMUT_START": 12.0, "SIM_IMUT_END": 62.0, "SIM_IMUT_TCONST": 60.0, "SIM_DRIFT_SPEED": 0.05}
    )
    assert sensors.warming == Warming(12.0, 62.0, 60.0)
    assert sensors.ignored == ("SIM_DRIFT_SPEED",)
    assert from_sitl({"SIM_ACC1_BIAS_X": 1.0}).warming is None
    assert from_sitl({"SIM_IMUT_FIXED": 40.0, "SIM_IMUT_START": 1.0}).warming == Warming(40.0, 40.0)


def test_noise_is_uniform_of_the_fixed_size():
    sensors = from_sitl({"SIM_MAG_RND": 3.0}, rate=50.0).suite
    x = sensors.accel.random(20_000, 50.0, np.random.default_rng(1))
    assert x.std() == pytest.approx(0.01 / np.sqrt(3.0), rel=0.02)
    assert sensors.mag.random(20_000, 50.0, np.random.default_rng(1)).std() == pytest.approx(0.3 / np.sqrt(3), rel=0.02)
    assert not from_sitl({"SIM_MAG_RND": 3.0}).suite.mag.noise_density.any()


def test_the_captures_were_made_with_what_their_readme_says(shared_data):
    parameters = read(shared_data / "sitl_captures" / "warm_up.tlog").parameters.final()
    sensors = from_sitl(parameters)
    np.testing.assert_allclose(sensors.suite.accel.bias, [0.31, -0.22, 0.17], rtol=1e-6)
    np.testing.assert_allclose(np.diag(sensors.suite.accel.matrix), 1.0 / np.array([1.021, 0.984, 1.013]), rtol=1e-6)
    assert sensors.suite.accel.t_ref == 35.0
    np.testing.assert_allclose(sensors.suite.accel.temperature[0], [7e-3, 6e-5, 0.0], rtol=1e-6)
    np.testing.assert_allclose(sensors.suite.mag.bias, [-9.0, 5.5, -3.5], rtol=1e-6)
    second = from_sitl(parameters, instance=1).suite
    assert not second.accel.bias.any()
    np.testing.assert_array_equal(second.mag.matrix, np.eye(3))


triples = st.tuples(*[st.floats(-0.2, 0.2)] * 3)


@given(triples, triples, triples, triples, st.integers(0, 2))
def test_there_and_back_reads_the_same(bias, scale, slope, cross, instance):
    iron = np.eye(3) + np.diag(scale) + 0.3 * (np.outer(cross, slope) + np.outer(slope, cross))
    suite = SensorSuite(
        accel=SensorErrors(
            bias=bias, matrix=np.diag(1 + np.array(scale)), t_ref=30.0, temperature=np.array([slope] * 3)
        ),
        gyro=SensorErrors(
            bias=slope, matrix=np.diag(1 + np.array(cross)), t_ref=30.0, temperature=np.array([bias] * 3)
        ),
        mag=SensorErrors(bias=np.array(bias) * 100, matrix=iron),
    )
    made = to_sitl(suite, instance=instance, warming=Warming(10.0, 50.0, 60.0))
    assert made.not_held == ()
    again = from_sitl(made.values, instance=instance)
    assert again.warming == Warming(10.0, 50.0, 60.0)
    x, at = np.array([[1.0, -2.0, 3.0]]), np.array([55.0])
    for sensor in (Sensor.ACCEL, Sensor.GYRO, Sensor.MAG):
        before, after = suite.by_sensor[sensor], again.suite.by_sensor[sensor]
        np.testing.assert_allclose(after.systematic(x, at), before.systematic(x, at), rtol=1e-9, atol=1e-9)


def test_what_sitl_cannot_hold_is_said():
    lost = " ".join(to_sitl(typical(np.random.default_rng(1))).not_held)
    for word in ("cross terms of the accelerometer", "cross terms of the gyroscope", "noise of the mag"):
        assert word in lost
    twisted = SensorSuite(mag=SensorErrors(matrix=np.eye(3) + np.array([[0, 0.1, 0], [-0.1, 0, 0], [0, 0, 0]])))
    assert "antisymmetric" in to_sitl(twisted).not_held[0]
    steep = SensorSuite(accel=SensorErrors(temperature=np.ones((3, 4)) * 1e-6))
    assert "third" in to_sitl(steep).not_held[0]


def test_parameters_of_no_sensor_are_refused():
    with pytest.raises(InvalidInputError, match="no SIM_ACC"):
        from_sitl({"INS_ACCOFFS_X": 1.0})
    with pytest.raises(InvalidInputError, match="inverse"):
        from_sitl({**vector("SIM_MAG1_DIA", (1, 1, 1)), **vector("SIM_MAG1_ODI", (1, 1, 1))})
    suite = typical(np.random.default_rng(1))
    with pytest.raises(InvalidInputError, match="positive"):
        to_sitl(dataclasses.replace(suite, accel=SensorErrors(matrix=np.diag([-1.0, 1.0, 1.0]))))
    with pytest.raises(InvalidInputError, match="T_mid"):
        to_sitl(
            SensorSuite(
                accel=SensorErrors(t_ref=25.0, temperature=np.ones((3, 1))),
                gyro=SensorErrors(t_ref=35.0, temperature=np.ones((3, 1))),
            )
        )


def test_the_errors_of_sim_parameters_are_those_of_the_running_simulator(shared_data):
    """What a real ArduPilot streamed, its calibration undone, corrected by the model of its own SIM_* parameters."""
    recording = read(shared_data / "sitl_captures" / "six_faces.tlog")
    suite = from_sitl(recording.parameters.final()).suite
    raw = undo(recording)
    temperature = raw.channel(Sensor.TEMPERATURE)
    poses = pose_means(raw.channel(Sensor.ACCEL), find_still(raw, instance=0, limits=HELD))
    at = [float(np.interp(0.5 * (p.start + p.end), temperature.t, temperature.values[:, 0])) for p in poses]
    force = suite.accel.correction.apply(np.array([p.mean for p in poses]), at)
    assert len(force) == 10
    np.testing.assert_allclose(np.linalg.norm(force, axis=1), 9.80665, atol=5e-4)
    assert force[0, 2] < -9.7  # level first
    field = np.linalg.norm(suite.mag.correction.apply(raw.channel(Sensor.MAG).values), axis=1)
    still = np.abs(field - np.median(field)) < 0.02
    assert still.mean() > 0.9  # the rest was read while it turned


def test_the_drift_of_sim_parameters_is_that_of_the_running_simulator(shared_data):
    recording = read(shared_data / "sitl_captures" / "warm_up.tlog")
    suite = from_sitl(recording.parameters.final()).suite
    raw = undo(recording)
    temperature = raw.channel(Sensor.TEMPERATURE)
    assert np.ptp(temperature.values) > 30.0
    for sensor, errors, rest, near in (
        (Sensor.ACCEL, suite.accel, [0.0, 0.0, -9.80665], 0.01),
        (Sensor.GYRO, suite.gyro, [0.0, 0.0, 0.0], 1e-3),
    ):
        channel = raw.channel(sensor)
        at = np.interp(channel.t, temperature.t, temperature.values[:, 0])
        corrected = errors.correction.apply(channel.values, at)
        blocks = corrected[: len(corrected) // 50 * 50].reshape(-1, 50, 3).mean(axis=1)
        assert np.abs(np.median(blocks, axis=0) - rest).max() < near
        assert np.abs(blocks[5:] - blocks[5:].mean(axis=0)).max() < 3 * near
