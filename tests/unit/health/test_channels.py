"""Which samples a sensor is judged by, and with which calibration."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mavcal.calib.health.channels import judged_channel
from mavcal.calib.recording import Channel, Identity, ParameterTimeline, Recording, Sensor, Stage

T = np.arange(100) * 0.01
RNG = np.random.default_rng(1)
VALUES = RNG.normal(size=(100, 3)) + np.array([0.0, 0.0, -9.8])


def samples(stage=Stage.CORRECTED, *, unit="m/s2", quantum=0.0, rows=100, source="IMU", window=0.0):
    return Channel(*(Sensor.ACCEL, 0, T[:rows], VALUES[:rows], unit, stage, source), quantum=quantum, window=window)


def recording(*channels, autopilot="ardupilot", parameters=None):
    timeline = ParameterTimeline.constant({} if parameters is None else parameters)
    return Recording(channels, identity=Identity(autopilot), parameters=timeline)


def chosen(*channels, **vehicle):
    return judged_channel(recording(*channels, **vehicle), Sensor.ACCEL, 0)


def test_corrected_samples_go_before_raw_ones_and_finer_before_coarser():
    raw, coarse, fine = samples(Stage.RAW, source="RAW"), samples(quantum=0.1, source="A"), samples(quantum=0.01)
    assert chosen(raw, coarse, fine) is fine
    assert chosen(raw, coarse) is coarse
    assert chosen(samples(rows=50, source="A"), samples(rows=80, source="B")).source == "B"


def test_of_equal_resolution_the_samples_that_average_longer_are_taken():
    single, averaged = samples(source="A"), samples(rows=50, window=0.02, source="B")
    assert chosen(single, averaged) is averaged


def test_samples_that_the_estimator_debiased_or_that_have_no_unit_are_not_judged():
    assert chosen(samples(Stage.DEBIASED)) is None
    assert chosen(samples(unit="counts")) is None
    assert chosen(samples(Stage.DEBIASED), samples(Stage.FILTERED, source="B")).source == "B"


def test_raw_samples_are_taken_of_a_table_and_not_of_an_ardupilot():
    raw = samples(Stage.RAW)
    assert chosen(raw, autopilot=None) is raw
    assert chosen(raw) is None
    assert chosen(raw, autopilot="other") is None
    assert chosen() is None


ROWS = {
    **{f"CAL_ACC0_{a}OFF": v for a, v in zip("XYZ", (0.5, -0.25, 1.0), strict=True)},
    **{f"CAL_ACC0_{a}SCALE": v for a, v in zip("XYZ", (1.1, 0.9, 1.0), strict=True)},
    "CAL_ACC0_ID": 4711,
    "CAL_ACC0_PRIO": 50,
    "CAL_ACC0_ROT": -1,
    "SENS_BOARD_ROT": 0,
    **{f"SENS_BOARD_{a}_OFF": 0.0 for a in "XYZ"},
    "TC_A_ENABLE": 0,
}


def test_raw_samples_of_px4_get_the_calibration_of_its_row():
    raw = samples(Stage.RAW)
    made = chosen(raw, autopilot="px4", parameters=ROWS)
    np.testing.assert_allclose(made.values, (VALUES - [0.5, -0.25, 1.0]) * [1.1, 0.9, 1.0], atol=1e-6)
    assert made.stage == Stage.CORRECTED
    assert made.t is raw.t


@pytest.mark.parametrize("lacking", [{"CAL_ACC0_ID": 0}, None])
def test_without_a_row_of_its_own_a_sensor_of_px4_is_not_judged(lacking):
    parameters = {} if lacking is None else {**ROWS, **lacking}
    assert chosen(samples(Stage.RAW), autopilot="px4", parameters=parameters) is None


def test_the_longest_raw_channel_of_px4_is_the_one_that_is_corrected():
    made = chosen(
        samples(Stage.RAW, rows=40, source="A"), samples(Stage.RAW, source="B"), autopilot="px4", parameters=ROWS
    )
    assert (made.source, len(made)) == ("B", 100)


THERMAL = {
    "TC_A_ENABLE": 1,
    "TC_A0_ID": 4711,
    "TC_A0_TREF": 25.0,
    "TC_A0_TMIN": 0.0,
    "TC_A0_TMAX": 60.0,
    **{f"TC_A0_X{k}_{i}": 0.0 for k in range(4) for i in range(3)},
    "TC_A0_X1_0": 0.1,
}


def test_a_drift_with_temperature_needs_a_thermometer():
    raw, with_drift = samples(Stage.RAW), {**ROWS, **THERMAL}
    assert chosen(raw, autopilot="px4", parameters=with_drift) is None
    warm = Channel(Sensor.TEMPERATURE, 0, np.array([0.0, 1.0]), np.array([25.0, 35.0]), "degC", Stage.RAW, "IMU")
    made = chosen(raw, warm, autopilot="px4", parameters=with_drift)
    cold = chosen(raw, dataclasses.replace(warm, values=np.full((2, 1), 25.0)), autopilot="px4", parameters=with_drift)
    drift = cold.values - made.values
    np.testing.assert_allclose(drift[:, 0], 1.1 * 0.1 * 10.0 * T, atol=1e-4)
    np.testing.assert_allclose(drift[:, 1:], 0.0, atol=1e-9)
