from __future__ import annotations

import math

import numpy as np
import pytest

from mavcal.calib.firmware.compose.draft import Draft, Rank
from mavcal.calib.firmware.limits import (
    COMPASS_OFFS_MAX,
    COMPASS_SCALE_WINDOW,
    LIMITS,
    THERMAL_SPAN_MIN,
    TRIM_MAX_RAD,
    limit_of,
)
from mavcal.calib.firmware.names import (
    OFFSET,
    SCALE,
    Role,
    ardupilot_compass_names,
    ardupilot_imu_names,
    px4_names,
    px4_thermal_names,
)
from mavcal.calib.firmware.options import ComposeOptions
from mavcal.calib.firmware.plan import Fingerprint, ParameterKind
from mavcal.calib.recording import Sensor

# Where a firmware states a range, it is the one below; the others are ours, with the reason beside them in `limits`.
STATED = {
    "INS_ACCOFFS_X": (-3.5, 3.5),  # AP_InertialSensor.cpp, @Range
    "INS_ACCSCAL_X": (0.8, 1.2),  # AP_InertialSensor.cpp, @Range; AccelCalibrator accepts no other
    "INS_TCAL1_TMIN": (-70.0, 80.0),  # AP_InertialSensor_tempcal.cpp, @Range
    "COMPASS_DIA_X": (0.2, 5.0),  # CompassCalibrator::fit_acceptable
    "COMPASS_ODI_X": (-1.0, 1.0),  # CompassCalibrator::fit_acceptable
    "AHRS_TRIM_X": (-math.radians(10.0), math.radians(10.0)),  # AP_AHRS_TRIM_LIMIT
    "CAL_ACC0_XSCALE": (0.1, 3.0),  # PX4's parameter reference, as the next two
    "CAL_MAG0_XSCALE": (0.1, 3.0),
    "SENS_BOARD_X_OFF": (-45.0, 45.0),
}
OURS = {
    "INS_GYROFFS_X": (-0.35, 0.35),
    "INS_ACC1_CALTEMP": (-300.0, 150.0),
    "CAL_ACC0_XOFF": (-3.5, 3.5),
    "CAL_GYRO0_XOFF": (-0.35, 0.35),
    "CAL_MAG0_XOFF": (-1.8, 1.8),
    "CAL_MAG0_XODIAG": (-1.0, 1.0),
    "TC_A0_TREF": (-70.0, 150.0),
    "TC_A0_X0_0": (-3.5, 3.5),
    "TC_G0_X0_0": (-0.35, 0.35),
}


@pytest.mark.parametrize(("name", "bounds"), (STATED | OURS).items())
def test_both_bounds_of_every_limit(name, bounds):
    limit = limit_of(name)
    assert (limit.low, limit.high) == pytest.approx(bounds, rel=1e-6)


def test_no_limit_is_left_untested():
    assert {limit_of(name) for name in STATED | OURS} == set(LIMITS)


def test_what_the_plans_of_other_modules_are_held_to():
    assert pytest.approx(limit_of("AHRS_TRIM_Y").high, rel=1e-6) == TRIM_MAX_RAD == math.radians(10.0)
    assert pytest.approx((1 / 1.5, 1.5)) == COMPASS_SCALE_WINDOW  # COMPASS_MAX_SCALE_FACTOR of ArduPilot
    assert COMPASS_OFFS_MAX == 1800.0  # AP_COMPASS_OFFSETS_MAX_DEFAULT of ArduPilot
    assert THERMAL_SPAN_MIN == 10.0  # TEMP_RANGE_MIN of AP_InertialSensor_tempcal.cpp


@pytest.mark.parametrize("slot", range(5))
def test_every_instance_of_ardupilot_is_held_to_the_same_limits(slot):
    accel, gyro = (ardupilot_imu_names(s, slot) for s in (Sensor.ACCEL, Sensor.GYRO))
    for roles, triple, bounds in (
        (accel, OFFSET, (-3.5, 3.5)),
        (accel, SCALE, (0.8, 1.2)),
        (gyro, OFFSET, (-0.35, 0.35)),
        (accel, (Role.THERMAL_MIN, Role.THERMAL_MAX), (-70.0, 80.0)),
    ):
        for role in triple:
            limit = limit_of(roles[role])
            assert (limit.low, limit.high) == bounds
    assert limit_of(accel[Role.TEMPERATURE]).low == -300.0
    assert limit_of(accel[Role.ID]) is None


@pytest.mark.parametrize("slot", range(3))
def test_compasses_and_px4_rows(slot):
    compass = ardupilot_compass_names(slot, slot)
    assert limit_of(compass[Role.SCALE_X]).high == 5.0
    assert limit_of(compass[Role.CROSS_YZ]).low == -1.0
    assert limit_of(px4_names(Sensor.ACCEL, slot)[Role.SCALE_Z]).low == 0.1
    assert limit_of(px4_names(Sensor.GYRO, slot)[Role.OFFSET_X]).high == 0.35
    assert limit_of(px4_names(Sensor.MAG, slot)[Role.OFFSET_X]).high == 1.8
    assert limit_of(px4_thermal_names(Sensor.ACCEL, slot)[Role.THERMAL_0_X]).high == 3.5


def test_a_refusal_has_the_number_the_limit_and_the_remedy():
    text = limit_of("INS_ACC2SCAL_Y").refusal("INS_ACC2SCAL_Y", 1.31)
    assert all(token in text for token in ("INS_ACC2SCAL_Y", "1.31", "0.8 ...", "... 1.2", "six poses"))


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e39])
def test_what_is_not_a_finite_float32_is_never_planned(value):
    draft = Draft({"TC_G0_X1_0": 0.0}, ComposeOptions(), ParameterKind.INT32)
    draft.set_real("TC_G0_X1_0", value, Rank.OFFSET, "test", about=None)
    assert draft.planned(["TC_G0_X1_0"]) == ()
    plan = draft.plan(Fingerprint("px4", "", "", ()))
    assert plan.changes == ()
    assert "not a finite number" in plan.blockers[0]


def test_values_are_float32_and_equal_ones_are_left_alone():
    draft = Draft(
        {"INS_ACCOFFS_X": float(np.float32(0.1)), "INS_ACCOFFS_Y": 0.0}, ComposeOptions(), ParameterKind.INT32
    )
    draft.set_real("INS_ACCOFFS_X", 0.1, Rank.OFFSET, "test", about=None)
    draft.set_real("INS_ACCOFFS_Y", 0.1, Rank.OFFSET, "test", about=None)
    (change,) = draft.planned(["INS_ACCOFFS_X", "INS_ACCOFFS_Y"])
    assert (change.name, change.new) == ("INS_ACCOFFS_Y", float(np.float32(0.1)))
    draft.set_real("INS_ACCOFFS_Y", 0.0, Rank.OFFSET, "back", about=None)
    assert draft.planned(["INS_ACCOFFS_Y"]) == ()


def test_a_value_that_could_not_be_put_back_is_not_overwritten():
    draft = Draft({"CAL_ACC0_XOFF": math.nan}, ComposeOptions(), ParameterKind.INT32)
    draft.set_real("CAL_ACC0_XOFF", 0.1, Rank.OFFSET, "test", about=None)
    plan = draft.plan(Fingerprint("px4", "", "", ()))
    assert "CAL_ACC0_XOFF" in plan.blockers[0]
    assert "put back" in plan.blockers[0]
