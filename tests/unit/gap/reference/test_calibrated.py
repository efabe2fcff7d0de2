from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mavcal.calib.gap.reference import build
from mavcal.calib.gap.reference.channels import (
    corrected,
    filter_gain,
    filter_in_force,
    offset_changed,
    sensor_from_corrected,
)
from mavcal.calib.recording import Event, Identity, ParameterTimeline, Recording, Sensor, Stage

from .test_recorded import RATE, SECONDS, channel, truth

OFFSET, SCALE, BIAS = np.array([0.1, -0.2, 0.3]), np.array([1.03, 0.98, 1.01]), np.array([0.3, -0.2, 0.15])


def vehicle(stage=Stage.CORRECTED, **parameters):
    """Two accelerometers of an ArduPilot; the first reads `BIAS` more than what its calibration takes off."""
    names = {f"INS_ACC{n}OFFS_{a}": v for n in ("", "2") for a, v in zip("XYZ", OFFSET, strict=True)}
    names |= {f"INS_ACC{n}SCAL_{a}": v for n in ("", "2") for a, v in zip("XYZ", SCALE, strict=True)}
    names["AHRS_ORIENTATION"] = 0.0
    t = np.arange(int(RATE * SECONDS)) / RATE
    force = truth(t)[0][Sensor.ACCEL]
    rng = np.random.default_rng(4)
    channels = []
    for i in (0, 1):
        raw = force / SCALE + OFFSET + (BIAS if i == 0 else 0.0) + 0.001 * rng.standard_normal(force.shape)
        values = raw if stage == Stage.RAW else SCALE * (raw - OFFSET)
        channels.append(dataclasses.replace(channel(Sensor.ACCEL, t, values, i, "IMU"), stage=stage))
    return Recording(
        tuple(channels),
        parameters=ParameterTimeline.constant(names | parameters),
        identity=Identity(autopilot="ardupilot"),
        reference=(channel(Sensor.ACCEL, t, force),),
    )


@pytest.mark.parametrize("stage", [Stage.CORRECTED, Stage.FILTERED, Stage.RAW])
def test_a_bias_reads_as_it_acts_on_the_sensor(stage):
    for trace in build(vehicle(stage)).traces:
        expected = BIAS if trace.instances == (0,) else np.zeros(3)
        assert trace.residual.mean(axis=0) == pytest.approx(expected, abs=2e-4)


def test_a_table_stays_as_it_is():
    real = dataclasses.replace(vehicle(), identity=Identity())
    assert corrected(real) is real
    assert sensor_from_corrected(real.channels[0], real) == pytest.approx(np.eye(3))


def test_a_calibration_that_is_not_known_is_said():
    real = dataclasses.replace(vehicle(), parameters=ParameterTimeline())
    assert sensor_from_corrected(real.channels[0], real) == pytest.approx(np.eye(3))
    assert any("calibration in force" in text for text in build(real).warnings)
    assert not any("calibration in force" in text for text in build(vehicle()).warnings)


def test_the_filter_in_force_is_told():
    real = vehicle(Stage.FILTERED, INS_ACCEL_FILTER=20.0)
    assert filter_in_force(real.channels[0], real) == 20.0
    assert build(real).traces[0].low_pass_hz == 20.0
    assert filter_in_force(vehicle().channels[0], vehicle(INS_ACCEL_FILTER=20.0)) is None
    assert filter_gain(np.array([20.0, 200.0]), 20.0) == pytest.approx([np.sqrt(0.5), 0.01], rel=1e-3)
    assert filter_gain(np.array([50.0]), None) == pytest.approx([1.0])


def test_a_compass_is_looked_at_as_long_as_it_has_one_offset():
    """PX4 takes off what its estimator learned once it disarms: half of an offset is gone in the last second."""
    t = np.arange(0.0, 60.0, 0.1)
    values = np.tile([20.0, 0.0, 40.0], (len(t), 1)) + np.where(t > 57.0, 0.5, 1.0)[:, None] * np.array(
        [8.0, -5.0, 3.0]
    )
    said = "[vehicle_magnetometer] 0 (197388) EST:0 offset: [0.000, 0.000, 0.000]->[0.040, -0.025, 0.015]"
    mag = dataclasses.replace(channel(Sensor.MAG, t, values, 0, "vehicle_magnetometer"), stage=Stage.CORRECTED)
    recording = Recording(
        (mag,),
        parameters=ParameterTimeline.constant({"CAL_MAG0_ID": 197388, "CAL_MAG0_XOFF": 0.0}),
        identity=Identity(autopilot="px4"),
        events=(Event(57.0, "text", said),),
    )
    (kept,) = corrected(recording).channels
    assert np.ptp(kept.values, axis=0).max() < 1e-9
    assert kept.t[-1] > 56.0
    (warning,) = offset_changed([kept], recording)
    assert "compass 1 at 57.0 s" in warning
