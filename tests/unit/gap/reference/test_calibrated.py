from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mavcal.calib.gap.reference import build
from mavcal.calib.gap.reference.calibrated import corrected, filter_gain, filter_in_force, sensor_from_corrected
from mavcal.calib.recording import Identity, ParameterTimeline, Recording, Sensor, Stage

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
