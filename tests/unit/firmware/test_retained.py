"""What a firmware still holds after a restart."""

from __future__ import annotations

import numpy as np
import pytest

from mavcal.calib.firmware.names import PX4_SLOTS, px4_names, px4_thermal_names
from mavcal.calib.firmware.values import FLT_EPSILON, LEAST_KEPT, asks_for_save, px4_default, retained
from mavcal.calib.recording import Sensor

INTEGERS = {"id", "rotation", "priority", "thermal_id", "thermal_enable", "motor_type"}
ROWS = [px4_names(sensor, slot) for sensor in (Sensor.ACCEL, Sensor.GYRO, Sensor.MAG) for slot in range(PX4_SLOTS)]
ROWS += [px4_thermal_names(sensor, slot) for sensor in (Sensor.ACCEL, Sensor.GYRO) for slot in range(PX4_SLOTS)]
FLOATS = sorted({name for row in ROWS for role, name in row.items() if role not in INTEGERS})


@pytest.mark.sampled
@pytest.mark.parametrize("name", FLOATS)
def test_every_float_of_a_px4_calibration_is_kept_beyond_the_epsilon_and_only_there(name):
    default = px4_default(name)
    assert default is not None
    assert retained(name, default + 1e-3) == float(np.float32(default + 1e-3))
    assert retained(name, default + 5e-8) == default
    if default == 0.0:
        for sign in (1.0, -1.0):
            assert retained(name, sign * FLT_EPSILON) == 0.0
            assert retained(name, sign * LEAST_KEPT) == sign * LEAST_KEPT


@pytest.mark.parametrize(
    "name", ["INS_TCAL1_GYR3_X", "INS_TCAL1_TMAX", "INS_GYROFFS_X", "COMPASS_ODI_X", "AHRS_TRIM_X"]
)
def test_ardupilot_keeps_what_it_is_given(name):
    assert retained(name, 6e-9) == float(np.float32(6e-9))
    assert asks_for_save(name, 0.0, 6e-9)


def test_a_change_by_less_than_the_epsilon_asks_for_no_save():
    assert not asks_for_save("TC_G0_X3_0", 4e-7, 4.5e-7)
    assert asks_for_save("TC_G0_X3_0", 4e-7, 6e-7)
