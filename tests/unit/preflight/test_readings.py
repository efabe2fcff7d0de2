from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mavcal.calib.preflight.check import Snapshot
from mavcal.calib.preflight.rest import rest_readings
from mavcal.calib.recording import Channel, Identity, Recording, Sensor, Stage

IDS = {"INS_GYR_ID": 2752772, "INS_ACC_ID": 2753028}
PARAMETERS = {
    **IDS,
    "AHRS_ORIENTATION": 0,
    "INS_GYROFFS_X": 0.01,
    "INS_GYROFFS_Y": -0.02,
    "INS_GYROFFS_Z": 0.0,
    "INS_GYR_CAL": 0,
}


def channel(sensor: Sensor, mean: tuple[float, ...], unit: str, noise: float = 1e-4) -> Channel:
    rng = np.random.default_rng(1)
    t = np.arange(200) / 50.0
    values = np.array(mean) + noise * rng.standard_normal((200, len(mean)))
    return Channel(sensor, 0, t, values, unit, Stage.CORRECTED, "test")


def snapshot(**changes: object) -> Snapshot:
    channels = (
        channel(Sensor.GYRO, (0.002, 0.0, 0.001), "rad/s"),
        channel(Sensor.ACCEL, (0.0, 0.0, -9.7), "m/s2"),
        channel(Sensor.TEMPERATURE, (31.0,), "degC", 0.0),
    )
    plain = Snapshot(Recording(channels), Identity("ardupilot"), PARAMETERS, 0.0)
    return dataclasses.replace(plain, **changes)  # type: ignore[arg-type]


def test_a_gyroscope_at_rest_shows_its_raw_bias_and_an_accelerometer_its_force() -> None:
    accel, gyro = rest_readings(snapshot())
    assert (gyro.sensor, gyro.device_id, gyro.temperature, gyro.by_itself) == (Sensor.GYRO, 2752772, 31.0, False)
    assert gyro.bias == pytest.approx((0.012, -0.02, 0.001), abs=1e-4)
    assert max(gyro.sd) < 1e-4
    assert (accel.sensor, accel.device_id, accel.bias) == (Sensor.ACCEL, 2753028, None)
    assert accel.norm == pytest.approx(9.7, abs=1e-3)


def test_one_that_was_calibrated_meanwhile_has_no_bias_but_another_parameter_spoils_none() -> None:
    assert rest_readings(snapshot(rewritten=("INS_GYROFFS_X",)))[1].bias is None
    assert rest_readings(snapshot(rewritten=("STAT_RUNTIME", "COMPASS_OFS_X")))[1].bias is not None


def test_a_vehicle_that_calibrates_by_itself_is_marked() -> None:
    assert rest_readings(snapshot(parameters={**PARAMETERS, "INS_GYR_CAL": 1}))[1].by_itself


def test_no_reading_without_an_id_or_of_an_unknown_autopilot() -> None:
    assert rest_readings(snapshot(parameters={**PARAMETERS, "INS_GYR_ID": 0, "INS_ACC_ID": 0})) == ()
    assert rest_readings(snapshot(identity=Identity("other"))) == ()


def test_no_reading_of_a_vehicle_that_was_moved() -> None:
    turning = channel(Sensor.GYRO, (0.0, 0.0, 0.0), "rad/s")
    turning = dataclasses.replace(turning, values=turning.values + np.linspace(0.0, 0.3, 200)[:, None])
    shaken = channel(Sensor.ACCEL, (0.0, 0.0, -9.7), "m/s2")
    assert rest_readings(snapshot(recording=Recording((turning, shaken)))) == ()
