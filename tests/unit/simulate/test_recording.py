from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest

from mavcal.calib.errors import InvalidInputError, UnreadableError
from mavcal.calib.logs.tables import read_table, write_table
from mavcal.calib.methods import METHODS
from mavcal.calib.recording import Rounding, Sensor
from mavcal.calib.simulate import MotionOptions, SensorErrors, SensorSuite, in_frame, motion_of, simulate, trajectory
from mavcal.calib.simulate.document import errors_from_json, errors_to_json, stated_in, truth_to_json
from mavcal.calib.simulate.recording import suite_in_frame
from mavcal.calib.simulate.typical import typical

FIELD = np.array([20.0, 1.0, 43.0])


def made(name: str, suite: SensorSuite, seed: int = 1, rate: float = 50.0, mag_rate: float | None = None, **options):
    rng = np.random.default_rng(seed)
    motion = motion_of(name, MotionOptions(**options), rng)
    return simulate(trajectory(motion.legs, rate, field=FIELD, start=motion.start), suite, rng, mag_rate=mag_rate)


def test_an_ideal_recording_reads_the_trajectory():
    simulated = made("tumble", SensorSuite(), duration=10.0, mag_rate=10.0)
    path, recording = simulated.trajectory, simulated.recording
    np.testing.assert_array_equal(recording.channel(Sensor.ACCEL).values, path.force)
    np.testing.assert_array_equal(recording.channel(Sensor.GYRO).values, path.rate)
    np.testing.assert_array_equal(recording.channel(Sensor.MAG).values, path.field[::5])
    with pytest.raises(InvalidInputError, match="rate"):
        made("tumble", SensorSuite(), duration=10.0, mag_rate=51.0)


@pytest.mark.parametrize("frame", ["ned", "enu"])
def test_the_table_comes_back_as_it_was(tmp_path, frame):
    recording = made("six-faces", typical(np.random.default_rng(4)), duration=2.0, rate=20.0).recording
    file = tmp_path / "made.csv"
    write_table(in_frame(recording, frame), file)
    flu = {"world": "enu", "body": "flu"} if frame == "enu" else {}
    again = read_table(file, **flu)
    for sensor in (Sensor.ACCEL, Sensor.GYRO, Sensor.MAG, Sensor.TEMPERATURE):
        np.testing.assert_array_equal(again.channel(sensor).values, recording.channel(sensor).values)
    products = (again.channel(Sensor.ATTITUDE).values * recording.channel(Sensor.ATTITUDE).values).sum(axis=1)
    np.testing.assert_allclose(np.abs(products), 1.0, atol=1e-12)
    assert [s.label for s in again.segments] == [s.label for s in recording.segments]


def test_level_in_enu_reads_g_upward():
    recording = in_frame(made("rest", SensorSuite(), duration=1.0).recording, "enu")
    np.testing.assert_allclose(recording.channel(Sensor.ACCEL).values[0], [0.0, 0.0, 9.80665])
    np.testing.assert_allclose(recording.channel(Sensor.MAG).values[0], [20.0, -1.0, -43.0])  # facing north: x north
    np.testing.assert_allclose(recording.channel(Sensor.ATTITUDE).values[0], np.array([1, 0, 0, 1]) / np.sqrt(2))


def test_methods_find_what_was_put_in():
    suite = typical(np.random.default_rng(5))
    quiet = {"noise_density": np.full(3, 1e-6)}
    suite = SensorSuite(**{s.value: dataclasses.replace(e, **quiet) for s, e in suite.by_sensor.items()})
    (fit,) = METHODS["accel-six-face"].run(made("six-faces", suite).recording)
    np.testing.assert_allclose(fit.model.matrix, suite.accel.correction.matrix, atol=1e-5)
    np.testing.assert_allclose(fit.model.offset, suite.accel.bias, atol=1e-5)
    (fit,) = METHODS["gyro-rest"].run(made("rest", suite, duration=20.0).recording)
    np.testing.assert_allclose(fit.model.offset, suite.gyro.bias, atol=1e-6)
    (fit,) = METHODS["mag-ellipsoid"].run(made("tumble", suite).recording)
    np.testing.assert_allclose(fit.model.offset, suite.mag.bias, atol=1e-3)
    expected = suite.mag.correction.symmetric().matrix
    np.testing.assert_allclose(fit.model.matrix / fit.model.matrix[0, 0], expected / expected[0, 0], atol=1e-5)


def test_the_die_runs_ahead_of_a_lagging_thermometer():
    from mavcal.calib.simulate import Warming

    motion = motion_of("warm-up", MotionOptions(duration=300.0), np.random.default_rng(0))
    path = trajectory(motion.legs, 10.0, field=FIELD, start=motion.start, warming=Warming(20.0, 60.0, 100.0))
    drift = SensorErrors(temperature=[[1.0]] * 3, t_ref=0.0, thermal_lag=30.0)
    read = simulate(path, SensorSuite(gyro=drift), np.random.default_rng(0)).recording.channel(Sensor.GYRO)
    shown = 60.0 - 40.0 * np.exp(-read.t / 100.0)
    die = shown + 30.0 * (40.0 / 100.0) * np.exp(-read.t / 100.0)
    np.testing.assert_allclose(read.values[1:-1, 0], die[1:-1], atol=1e-3)


def test_a_streamed_suite_is_truncated_as_mavlink_does():
    recording = made("rest", typical(np.random.default_rng(6)).streamed(), duration=2.0).recording
    gyro = recording.channel(Sensor.GYRO)
    assert (gyro.quantum, gyro.rounding) == (1e-3, Rounding.TOWARD_ZERO)
    steps = gyro.values / 1e-3
    assert np.all((gyro.values == 0.0) | (np.abs(steps - np.trunc(steps)) - 0.5 < 1e-9))
    assert recording.channel(Sensor.MAG).quantum == pytest.approx(0.1)


def test_axes_of_enu_turn_there_and_back():
    suite = typical(np.random.default_rng(8))
    there = suite_in_frame(suite, "enu")
    np.testing.assert_allclose(there.accel.bias, suite.accel.bias * [1, -1, -1])
    assert there.accel.matrix[0, 1] == -suite.accel.matrix[0, 1]
    back = suite_in_frame(there, "enu")
    np.testing.assert_array_equal(back.gyro.matrix, suite.gyro.matrix)


def test_the_truth_states_the_sensors_again():
    simulated = made("turntable", typical(np.random.default_rng(9)), duration=2.0)
    document = json.loads(json.dumps(truth_to_json(simulated, frame="enu", seed=9), allow_nan=False))
    again = stated_in(json.dumps(document["sensors"]), ".json", frame="enu").suite
    for sensor, errors in simulated.suite.by_sensor.items():
        assert errors_to_json(again.by_sensor[sensor]) == errors_to_json(errors)
    np.testing.assert_array_equal(document["models"]["gyro"]["offset"], simulated.suite.gyro.bias)
    assert document["segments"][1]["rate"][0] == pytest.approx(-np.pi / 2)


@pytest.mark.parametrize(
    ("text", "suffix", "error"),
    [
        ("not json", ".json", UnreadableError),
        ("[1]", ".json", UnreadableError),
        ('{"accel": 3}', ".json", UnreadableError),
        ('{"lidar": {}}', ".json", InvalidInputError),
        ('{"accel": {"bais": [0, 0, 0]}}', ".json", InvalidInputError),
        ('{"accel": {"rounding": "up"}}', ".json", InvalidInputError),
        ('{"accel": {"resolution": "fine"}}', ".json", InvalidInputError),
        ('{"accelparams": {"Bias": 1}}', ".json", InvalidInputError),
        ("SIM_ACC1_BIAS_X", ".param", UnreadableError),
        ("SIM_ACC1_BIAS_X,nan", ".param", UnreadableError),
        ("INS_ACCOFFS_X,0.1", ".param", InvalidInputError),
    ],
)
def test_files_that_state_no_sensor_are_refused(text, suffix, error):
    with pytest.raises(error):
        stated_in(text, suffix)


def test_fields_left_out_are_ideal():
    errors = errors_from_json({"bias": [1, 2, 3], "full_scale": None, "rounding": "toward_zero"})
    assert errors.full_scale == np.inf
    assert errors.rounding == Rounding.TOWARD_ZERO
    np.testing.assert_array_equal(errors.matrix, np.eye(3))


def test_gyroscope_methods_find_the_truth_within_their_uncertainty():
    suite = typical(np.random.default_rng(12))
    simulated = made("turntable", suite, rate=100.0, duration=10.0)
    rates = {f.segment.label: np.degrees(f.rate).sum() for f in simulated.trajectory.facts if f.rate is not None}
    stated = ",".join(f"{label}={rate:.9g}" for label, rate in rates.items())
    (fit,) = METHODS["gyro-turntable"].run(simulated.recording, {"rate_true": stated, "rate_sd": 1e-4})
    z = (fit.model.matrix - suite.gyro.correction.matrix) / fit.sd[3:12].reshape(3, 3)
    assert np.abs(z).max() < 4.0
    simulated = made("thread", suite, rate=100.0, duration=20.0)
    (fit,) = METHODS["gyro-thread"].run(simulated.recording, {"turns": 10, "angle_sd": 0.1})
    assert abs(fit.model.matrix[2, 2] - suite.gyro.correction.matrix[2, 2]) < 4.0 * fit.sd[3 + 8] + 1e-4
    assert abs(fit.model.offset[2] - suite.gyro.bias[2]) < 4.0 * fit.sd[2]
