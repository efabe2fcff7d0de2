"""Which outputs drive motors, and where they rest, for every kind of vehicle."""

from __future__ import annotations

import numpy as np
import pytest

from mavcal.calib.firmware.ardupilot.outputs import kind_of_vehicle, motor_outputs

COPTER, PLANE, ROVER, SUB = 2, 1, 10, 12
PULSES = np.array([1000.0, 1100.0, 1500.0, 1900.0, 2000.0, 0.0, 18648.0, 65535.0])


def drives(kind, parameters, outputs=(1, 2, 3, 4)):
    return {one.number: one.drive(PULSES).round(3).tolist() for one in motor_outputs(outputs, parameters, kind)}


@pytest.mark.parametrize(
    ("kind", "parameters", "expected"),
    [
        (COPTER, {"SERVO1_FUNCTION": 33}, {1: [0.0, 0.1, 0.5, 0.9, 1.0]}),
        (COPTER, {"SERVO1_FUNCTION": 33, "MOT_PWM_MIN": 1100, "MOT_PWM_MAX": 1900}, {1: [0.0, 0.0, 0.5, 1.0, 1.0]}),
        (COPTER, {"SERVO1_FUNCTION": 33, "SERVO_BLH_3DMASK": 1}, {1: [-1.0, -1.0, 0.0, 1.0, 1.0]}),
        (SUB, {"SERVO1_FUNCTION": 33}, {1: [-1.0, -1.0, 0.0, 1.0, 1.0]}),
        (SUB, {"SERVO1_FUNCTION": 33, "SERVO1_REVERSED": 1}, {1: [1.0, 1.0, 0.0, -1.0, -1.0]}),
        (ROVER, {"SERVO1_FUNCTION": 26, "SERVO3_FUNCTION": 70}, {3: [-1.0, -1.0, 0.0, 1.0, 1.0]}),
        (ROVER, {"SERVO3_FUNCTION": 73, "SERVO3_TRIM": 1100, "SERVO3_MIN": 1000, "SERVO3_MAX": 2000},
         {3: [-1.0, 0.0, 0.444, 0.889, 1.0]}),
        (ROVER, {}, {3: [-1.0, -1.0, 0.0, 1.0, 1.0]}),
        (ROVER, {"SKID_STEER_OUT": 1}, {1: [-1.0, -1.0, 0.0, 1.0, 1.0], 3: [-1.0, -1.0, 0.0, 1.0, 1.0]}),
        (PLANE, {"SERVO3_FUNCTION": 70, "SERVO3_MIN": 1100, "SERVO3_MAX": 1900}, {3: [0.0, 0.0, 0.5, 1.0, 1.0]}),
        (PLANE, {"SERVO3_FUNCTION": 70, "THR_MIN": -100}, {3: [-1.0, -1.0, 0.0, 1.0, 1.0]}),
        (PLANE, {"SERVO1_FUNCTION": 33, "SERVO3_FUNCTION": 70, "Q_M_PWM_MIN": 1000, "Q_M_PWM_MAX": 2000},
         {1: [0.0, 0.1, 0.5, 0.9, 1.0], 3: [0.0, 0.1, 0.5, 0.9, 1.0]}),
        (PLANE, {}, {3: [0.0, 0.1, 0.5, 0.9, 1.0]}),
    ],
)  # fmt: skip
def test_each_vehicle_rests_where_its_outputs_do_and_an_unset_output_is_nothing(kind, parameters, expected):
    assert drives(kind, parameters) == {number: [*values, 0.0, 0.0, 0.0] for number, values in expected.items()}


@pytest.mark.parametrize(
    ("name", "kind"),
    [("JS_GAIN_DEFAULT", SUB), ("CRUISE_SPEED", ROVER), ("ARSPD_FBW_MIN", PLANE), ("MOT_SPIN_ARM", None)],
)
def test_parameters_tell_the_vehicle_where_no_text_does(name, kind):
    assert kind_of_vehicle(None, {name: 1.0}) == kind
    assert kind_of_vehicle(COPTER, {name: 1.0}) == COPTER
