"""What a PX4 log says of the flight itself: filtered streams, set-points, battery, height, trajectory."""

from __future__ import annotations

import numpy as np
import pytest

from mavcal.calib.firmware.px4.flight import dynamics_channels
from mavcal.calib.firmware.px4.topics import Topics
from mavcal.calib.recording import Channel, Sensor, Stage

N = 50
US = 1_000_000 + 4000 * np.arange(N, dtype=np.uint64)


def topic(**fields: object) -> dict[str, np.ndarray]:
    made = {name.replace("__", "[") + ("]" if "__" in name else ""): value for name, value in fields.items()}
    stamps = {"timestamp": US + 100, "timestamp_sample": US}
    return stamps | {name: np.broadcast_to(np.asarray(value, dtype=float), (N,)).copy() for name, value in made.items()}


def xyz(x: object, y: object, z: object) -> dict[str, np.ndarray]:
    return topic(xyz__0=x, xyz__1=y, xyz__2=z)


def read(topics: Topics) -> dict[Sensor, Channel]:
    found = list(dynamics_channels(topics))
    assert len({c.sensor for c in found}) == len(found)
    return {c.sensor: c for c in found}


def test_streams_after_the_filters_are_filtered() -> None:
    found = read(
        {("vehicle_acceleration", 0): xyz(1.0, 2.0, -9.8), ("vehicle_angular_velocity", 0): xyz(0.1, 0.2, 0.3)}
    )
    for sensor, values in ((Sensor.ACCEL, [1.0, 2.0, -9.8]), (Sensor.GYRO, [0.1, 0.2, 0.3])):
        assert found[sensor].stage is Stage.FILTERED
        np.testing.assert_allclose(found[sensor].values, np.tile(values, (N, 1)))
        np.testing.assert_allclose(found[sensor].t, US * 1e-6)


def bias(device: int, x: float) -> dict[str, np.ndarray]:
    """From the middle of the log on, an offset of both sensors that was subtracted."""
    later = np.where(np.arange(N) < N // 2, 0.0, x)
    fields = {f"{of}_bias__{k}": later * (k == 0) for of in ("accel", "gyro") for k in range(3)}
    return topic(**fields, accel_device_id=device, gyro_device_id=device)


def test_the_estimators_bias_is_put_back() -> None:
    """Both topics come without it: it wandered by 0.3 m/s2 in a simulated flight, and drag was 5 % off."""
    streams: Topics = {
        ("vehicle_acceleration", 0): xyz(1.0, 2.0, -9.8), ("vehicle_angular_velocity", 0): xyz(0.1, 0.2, 0.3),
        ("estimator_sensor_bias", 0): bias(7, 0.5),
    }  # fmt: skip
    found = read(streams)
    for sensor, before in ((Sensor.ACCEL, 1.0), (Sensor.GYRO, 0.1)):
        np.testing.assert_allclose(found[sensor].values[: N // 2, 0], before)
        np.testing.assert_allclose(found[sensor].values[N // 2 :, 0], before + 0.5)
        assert np.ptp(found[sensor].values[:, 1:], axis=0).max() == 0.0
    other = {**streams, ("estimator_sensor_bias", 1): bias(9, 2.0)}
    chosen = topic(accel_device_id=9.0, gyro_device_id=9.0)
    assert read({**other, ("sensor_selection", 0): chosen})[Sensor.ACCEL].values[-1, 0] == pytest.approx(3.0)
    assert read({**streams, ("sensor_selection", 0): chosen})[Sensor.ACCEL].values[-1, 0] == pytest.approx(1.0)


def test_the_mixers_inputs_are_the_torque_and_the_lift() -> None:
    """Thrust points down the body's -z; where it comes later the last one counts."""
    thrust = xyz(0.0, 0.0, -np.linspace(0.4, 0.6, N))
    found = read({("vehicle_torque_setpoint", 0): xyz(0.1, -0.2, 0.05), ("vehicle_thrust_setpoint", 0): thrust})
    np.testing.assert_allclose(found[Sensor.CONTROL].values[:, :3], np.tile([0.1, -0.2, 0.05], (N, 1)))
    np.testing.assert_allclose(found[Sensor.CONTROL].values[:, 3], np.linspace(0.4, 0.6, N))


def test_set_points_that_are_no_numbers_are_left_out() -> None:
    torque = xyz(np.where(np.arange(N) < 10, np.nan, 0.1), 0.0, 0.0)
    found = read({("vehicle_torque_setpoint", 0): torque, ("vehicle_thrust_setpoint", 0): xyz(0.0, 0.0, -0.5)})
    assert len(found[Sensor.CONTROL]) == N - 10
    assert read({("vehicle_torque_setpoint", 0): torque}) == {}


def test_battery_height_and_trajectory() -> None:
    orientation = np.where(np.arange(N) % 2, 25, 0)
    found = read({
        ("battery_status", 0): topic(voltage_v=15.2),
        ("distance_sensor", 0): topic(current_distance=3.0 + orientation, orientation=orientation),
        ("vehicle_attitude", 0): topic(q__0=0.6, q__1=0.0, q__2=0.0, q__3=0.8),
        ("vehicle_local_position", 0): topic(vx=1.0, vy=2.0, vz=-3.0, x=4.0, y=5.0, z=-6.0),
    })  # fmt: skip
    np.testing.assert_allclose(found[Sensor.VOLTAGE].values, 15.2)
    np.testing.assert_allclose(found[Sensor.HEIGHT].values, 28.0)  # those that look down only
    assert len(found[Sensor.HEIGHT]) == N // 2
    np.testing.assert_allclose(found[Sensor.ATTITUDE].values, np.tile([0.6, 0.0, 0.0, 0.8], (N, 1)))
    np.testing.assert_allclose(found[Sensor.VELOCITY].values, np.tile([1.0, 2.0, -3.0], (N, 1)))
    np.testing.assert_allclose(found[Sensor.PLACE].values, np.tile([4.0, 5.0, -6.0], (N, 1)))


@pytest.mark.parametrize("name", ["baro_temp_celcius", "ambient_temperature"])
def test_pressure_and_temperature_under_either_name(name: str) -> None:
    pressure = np.where(np.arange(N) < 5, np.nan, 95578.0)
    found = read({("vehicle_air_data", 0): topic(baro_pressure_pa=pressure, **{name: 15.0})})
    np.testing.assert_allclose(found[Sensor.AIR].values, np.tile([95578.0, 15.0], (N - 5, 1)))
    assert read({("vehicle_air_data", 0): topic(rho=1.2)}) == {}


def test_a_quaternion_is_of_unit_size_and_an_empty_one_is_none() -> None:
    w = np.where(np.arange(N) < 5, 0.0, 2.0)
    found = read({("vehicle_attitude", 0): topic(q__0=w, q__1=0.0, q__2=0.0, q__3=0.0)})
    assert len(found[Sensor.ATTITUDE]) == N - 5
    np.testing.assert_allclose(found[Sensor.ATTITUDE].values[:, 0], 1.0)


@pytest.mark.parametrize("name", ["vehicle_acceleration", "battery_status", "vehicle_attitude", "distance_sensor"])
def test_a_topic_without_its_fields_is_left_out(name: str) -> None:
    assert read({(name, 0): topic(other=1.0)}) == {}
    assert read({}) == {}
