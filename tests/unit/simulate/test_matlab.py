from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.recording import Rounding, Sensor
from mavcal.calib.report import to_json
from mavcal.calib.simulate import SensorErrors, from_matlab, to_matlab

SENSORS = (Sensor.ACCEL, Sensor.GYRO, Sensor.MAG)


def imu_sensor(p: dict, ideal: np.ndarray, temperature: float, acceleration: np.ndarray | None = None) -> np.ndarray:
    """What the documentation of imuSensor says a noiseless sensor reads; `ideal` in its own sign and axes."""
    three = {
        k: np.broadcast_to(np.asarray(p.get(k, 0.0), dtype=float), 3)
        for k in ("ConstantBias", "TemperatureBias", "TemperatureScaleFactor", "AccelerationBias")
    }
    gain = np.asarray(p.get("AxesMisalignment", 100 * np.eye(3))) / 100.0
    d = temperature - 25.0
    reading = ideal @ gain.T + three["ConstantBias"] + d * three["TemperatureBias"]
    if acceleration is not None:
        reading = reading + acceleration * three["AccelerationBias"]
    reading = reading * (1.0 + d / 100.0 * three["TemperatureScaleFactor"])
    limit, step = p.get("MeasurementRange", np.inf), p.get("Resolution", 0.0)
    reading = np.clip(reading, -limit, limit)
    return step * np.round(reading / step) if step else reading


def test_misalignment_of_a_scalar_and_of_a_row():
    assert from_matlab({"AxesMisalignment": 2}, Sensor.GYRO).matrix.tolist() == [
        [1.0, 0.02, 0.02],
        [0.02, 1.0, 0.02],
        [0.02, 0.02, 1.0],
    ]
    row = from_matlab({"AxesMisalignment": [1, 2, 3]}, Sensor.GYRO).matrix
    np.testing.assert_allclose(row, [[1, 0.02, 0.03], [0.01, 1, 0.03], [0.01, 0.02, 1]])
    full = [[101.0, 1.0, 0.0], [0.0, 99.0, 0.0], [2.0, 0.0, 100.0]]
    np.testing.assert_allclose(100 * from_matlab({"AxesMisalignment": full}, Sensor.MAG).matrix, full)


def test_no_property_is_an_ideal_sensor():
    errors = from_matlab({}, Sensor.ACCEL)
    truth = np.array([[1.0, 2.0, 3.0]])
    np.testing.assert_array_equal(errors.read(truth, 1.0, np.random.default_rng(0)).values, truth)


@pytest.mark.parametrize("frame", ["ned", "enu"])
@pytest.mark.parametrize("sensor", SENSORS)
def test_the_reading_is_that_of_imusensor(sensor, frame):
    rng = np.random.default_rng(3)
    properties = {
        "MeasurementRange": 30.0,
        "Resolution": 0.01,
        "ConstantBias": [0.3, -0.2, 0.1],
        "AxesMisalignment": (100 * np.eye(3) + rng.normal(size=(3, 3))).tolist(),
        "TemperatureBias": [0.01, 0.02, -0.03],
        "TemperatureScaleFactor": [0.1, 0.2, 0.3],
    }
    if sensor == Sensor.GYRO:
        properties["AccelerationBias"] = [1e-2, 2e-2, -3e-2]
    truth = 15.0 * rng.normal(size=(200, 3))  # specific force, rate or field, forward-right-down
    force = rng.normal(size=(200, 3))
    axes = np.array([1.0, 1.0, 1.0]) if frame == "ned" else np.array([1.0, -1.0, -1.0])
    sign = -1.0 if sensor == Sensor.ACCEL else 1.0  # imuSensor's accelerometer reads gravity less acceleration
    acceleration = force * axes if sensor == Sensor.GYRO else None
    matlab = imu_sensor(properties, sign * axes * truth, 40.0, acceleration)
    errors = from_matlab(properties, sensor, frame=frame)
    assert errors.rounding == Rounding.NEAREST
    ours = errors.read(truth, 1.0, rng, temperature=np.full(200, 40.0), force=force).values
    apart = np.abs(ours - sign * axes * matlab)
    assert np.quantile(apart, 0.99) < 1e-9  # halves may round either way
    assert apart.max() < 0.0101


def test_noise_of_either_type():
    double = from_matlab({"NoiseDensity": 0.1, "RandomWalk": 0.2, "BiasInstability": 0.3}, Sensor.GYRO)
    rate, count = 100.0, 20_000
    noise = double.random(count, rate, np.random.default_rng(1))
    parts = {"NoiseDensity": 0.1 * np.sqrt(rate / 2), "RandomWalk": 0.2 / np.sqrt(rate / 2), "BiasInstability": 0.3}
    for name, expected in parts.items():  # standard deviation of a sample, of a step, of what drives the filter
        alone = from_matlab({name: {"NoiseDensity": 0.1, "RandomWalk": 0.2, "BiasInstability": 0.3}[name]}, Sensor.GYRO)
        x = alone.random(count, rate, np.random.default_rng(2))
        x = np.diff(x, axis=0) if name == "RandomWalk" else x
        x = x[1:] - 0.5 * x[:-1] if name == "BiasInstability" else x
        assert x.std() == pytest.approx(expected, rel=0.02)
    single = from_matlab({"NoiseDensity": 0.1, "NoiseType": "single-sided"}, Sensor.GYRO)
    assert single.random(count, rate, np.random.default_rng(1)).std() == pytest.approx(1.0, rel=0.02)
    assert noise.shape == (count, 3)


numbers = st.floats(-0.3, 0.3)
triples = st.tuples(numbers, numbers, numbers)


@given(triples, triples, triples, st.floats(0.0, 45.0), st.sampled_from(SENSORS), st.sampled_from(["ned", "enu"]))
def test_there_and_back_reads_the_same(bias, slope, cross, t_ref, sensor, frame):
    errors = SensorErrors(
        bias=np.array(bias),
        matrix=np.eye(3) + np.outer(cross, slope),
        t_ref=t_ref,
        temperature=np.array(slope)[:, None],
        temperature_scale=np.abs(cross) * 0.01,
        noise_density=np.abs(bias),
        bias_instability=np.abs(slope),
        random_walk=np.abs(cross),
        g_sensitivity=np.diag(bias) if sensor == Sensor.GYRO else np.zeros((3, 3)),
        full_scale=20.0,
        resolution=0.001,
    )
    made = to_matlab(errors, sensor, frame=frame)
    assert made.not_held == ()
    stored = json.loads(json.dumps(to_json(made.values), allow_nan=False))
    again = from_matlab(stored, sensor, frame=frame)
    x, force = np.array([[1.0, -2.0, 3.0]]), np.array([[0.1, 0.2, -9.8]])
    for temperature in (0.0, 25.0, 60.0):
        at = np.array([temperature])
        np.testing.assert_allclose(
            again.systematic(x, at, force), errors.systematic(x, at, force), rtol=1e-9, atol=1e-9
        )
    np.testing.assert_allclose(
        again.random_walk * (1 + again.temperature_scale * (t_ref - 25.0)), errors.random_walk, atol=1e-12
    )


def test_what_matlab_cannot_hold_is_said():
    errors = SensorErrors(
        temperature=np.array([[0.0, 1e-3]] * 3),
        thermal_lag=3.0,
        resolution=0.1,
        rounding=Rounding.TOWARD_ZERO,
        g_sensitivity=np.ones((3, 3)),
        temperature_scale=-0.001,
    )
    assert len(to_matlab(errors, Sensor.GYRO).not_held) == 5
    assert to_matlab(SensorErrors(), Sensor.MAG).not_held == ()
    assert to_matlab(SensorErrors(), Sensor.MAG).values["MeasurementRange"] == np.inf
    assert "AccelerationBias" not in to_matlab(SensorErrors(), Sensor.MAG).values


def test_flicker_becomes_the_poles_of_a_fractional_filter():
    assert to_matlab(SensorErrors(), Sensor.GYRO, poles=2).values["BiasInstabilityCoefficients"] == {
        "Numerator": [1.0],
        "Denominator": [1.0, -0.5],  # the default of the MATLAB objects
    }


@pytest.mark.parametrize(
    ("properties", "said"),
    [
        ({"Range": 1.0}, "Range"),
        ({"AccelerationBias": 1.0}, "AccelerationBias"),
        ({"ConstantBias": [1.0, 2.0]}, "ConstantBias"),
        ({"ConstantBias": "x"}, "ConstantBias"),
        ({"ConstantBias": float("nan")}, "ConstantBias"),
        ({"AxesMisalignment": [[1.0, 2.0]]}, "AxesMisalignment"),
        ({"NoiseType": "one-sided"}, "NoiseType"),
        ({"MeasurementRange": [1, 2]}, "MeasurementRange"),
        ({"BiasInstabilityCoefficients": {"Numerator": [1, 2], "Denominator": [1]}}, "numerator"),
        ({"BiasInstabilityCoefficients": 3}, "Denominator"),
    ],
)
def test_properties_that_cannot_be_are_refused(properties, said):
    with pytest.raises(InvalidInputError, match=said):
        from_matlab(properties, Sensor.ACCEL)
