"""PX4's correction at the borders of its rules, and where a parameter was not seen."""

from __future__ import annotations

import numpy as np
import pytest

from mavcal.calib.errors import FirmwareError
from mavcal.calib.firmware.compose.draft import Draft, Subject
from mavcal.calib.firmware.compose.px4_memory import (
    Vector,
    order_without_restart,
    representable,
    set_vector,
    survives_restart,
)
from mavcal.calib.firmware.names import CROSS, OFFSET, SCALE
from mavcal.calib.firmware.options import ComposeOptions
from mavcal.calib.firmware.plan import ParameterKind
from mavcal.calib.firmware.px4 import parameters as px4
from mavcal.calib.firmware.rotations import euler_matrix
from mavcal.calib.firmware.slots import (
    ardupilot_compass_slot,
    ardupilot_sensor_ids,
    px4_sensor_ids,
    px4_slot,
    px4_thermal_slot,
)
from mavcal.calib.recording import Sensor

ACCEL, GYRO, MAG = (Subject(s, 0) for s in (Sensor.ACCEL, Sensor.GYRO, Sensor.MAG))


GAINS = {"CAL_MAG0_XCOMP": 2.0, "CAL_MAG0_YCOMP": 0.0, "CAL_MAG0_ZCOMP": -4.0}


class TestMotors:
    @pytest.mark.parametrize("kind", [None, 0])
    def test_nothing_is_added_unless_a_kind_is_chosen(self, px4_parameters, kind):
        known = px4_parameters | GAINS | {"CAL_MAG_COMP_TYP": kind}
        if kind is None:  # an older firmware, which has no such parameter
            del known["CAL_MAG_COMP_TYP"]
        assert px4.motor_term(known, 0, np.ones(2), {}) is None

    def test_gains_of_zero_need_nothing(self, px4_parameters):
        assert px4.motor_term(px4_parameters | {"CAL_MAG_COMP_TYP": 1} | dict.fromkeys(GAINS, 0.0), 0, None, {}) is None

    def test_thrust_is_a_share_and_a_current_counts_in_kiloamperes(self, px4_parameters):
        known = px4_parameters | GAINS
        by_thrust = px4.motor_term(known | {"CAL_MAG_COMP_TYP": 1}, 0, np.array([0.5, 1.0]), {})
        np.testing.assert_allclose(by_thrust, [[100, 0, -200], [200, 0, -400]])
        currents = {0: np.array([10.0]), 1: np.array([20.0])}
        for kind, field in ((2, [2, 0, -4]), (3, [4, 0, -8])):
            found = px4.motor_term(known | {"CAL_MAG_COMP_TYP": kind}, 0, np.array([9.0]), currents)
            np.testing.assert_allclose(found, [field])

    @pytest.mark.parametrize(
        ("kind", "what"), [(1, "thrust"), (2, "current of battery 1"), (3, "current of battery 2")]
    )
    def test_what_was_not_recorded_is_named(self, px4_parameters, kind, what):
        known = px4_parameters | GAINS | {"CAL_MAG_COMP_TYP": kind}
        with pytest.raises(FirmwareError, match=f"follows the {what} \\(CAL_MAG_COMP_TYP {kind}\\)"):
            px4.motor_term(known, 0, None, {})


class TestMounting:
    @pytest.mark.parametrize(
        ("number", "angle", "yaw"), [(-1, 30, 90), (0, 0, 0), (4, 0, 180), (4, 1e-7, 180), (4, 30, 30), (100, 30, 30)]
    )
    def test_an_internal_sensor_follows_the_board_and_an_external_one_its_own(self, px4_parameters, number, angle, yaw):
        """Angles in the row of an external sensor hold whatever its number says (Magnetometer.cpp, ParametersLoad)."""
        known = px4_parameters | {"SENS_BOARD_ROT": 2, "CAL_MAG0_ROT": number, "CAL_MAG0_YAW": float(angle)}
        known |= {"CAL_MAG0_ROLL": 0.0, "CAL_MAG0_PITCH": 0.0, "SENS_BOARD_X_OFF": 2.0}
        turn = euler_matrix(2.0, 0, 0) @ euler_matrix(0, 0, yaw)
        np.testing.assert_allclose(px4.mounting(known, Sensor.MAG, 0), turn, atol=1e-12)

    def test_an_accelerometer_has_no_angles_of_its_own(self, px4_parameters):
        with pytest.raises(FirmwareError, match="rotation 100 is none of px4's"):
            px4.mounting(px4_parameters | {"CAL_ACC0_ROT": 100}, Sensor.ACCEL, 0)


@pytest.mark.parametrize(
    ("sensor", "name", "limit"),
    [
        (Sensor.ACCEL, "CAL_ACC0_XOFF", 0.01),
        (Sensor.MAG, "CAL_MAG0_XOFF", 0.005),
        (Sensor.ACCEL, "CAL_ACC0_ZSCALE", 0.01),
        (Sensor.MAG, "CAL_MAG0_YODIAG", 0.01),
    ],
)
def test_a_vector_must_differ_by_more_than_its_threshold(px4_parameters, sensor, name, limit):
    for factor, taken in ((0.98, False), (1.02, True)):
        memory = px4.Px4Calibration.load(px4_parameters, sensor, 0)
        assert not memory.loaded
        after = memory.update(px4_parameters | {name: px4_parameters[name] + factor * limit})
        assert after.loaded == taken
        changed = [
            float(np.abs(getattr(after, part) - getattr(memory, part)).max()) for part in ("offset", "scale", "cross")
        ]
        assert max(changed) == pytest.approx(factor * limit if taken else 0.0, rel=1e-5)


def test_a_scale_that_is_not_positive_is_not_taken(px4_parameters):
    for value in (0.0, -1.0):
        memory = px4.Px4Calibration.load(px4_parameters | {"CAL_ACC0_YSCALE": value}, Sensor.ACCEL, 0)
        assert memory.scale.tolist() == [1, 1, 1]


def test_the_first_load_of_a_gyro_takes_anything_and_the_second_does_not(px4_parameters):
    known = px4_parameters | {"CAL_GYRO0_XOFF": 0.001}
    memory = px4.Px4Calibration.load(known, Sensor.GYRO, 0)
    assert (memory.offset[0], memory.loaded) == (0.001, True)
    assert memory.update(known | {"CAL_GYRO0_XOFF": 0.0109}).offset[0] == 0.001
    assert memory.update(known | {"CAL_GYRO0_XOFF": 0.0111}).offset[0] == 0.0111


def vector(about, triple, values, sd=0.0):
    return Vector(about, triple, np.array(values, dtype=np.float64), np.full(3, sd), "u", "why")


class TestMemory:
    @pytest.mark.parametrize(
        ("about", "triple", "neutral", "limit"),
        [
            (ACCEL, OFFSET, 0.0, 0.01),
            (MAG, OFFSET, 0.0, 0.005),
            (ACCEL, SCALE, 1.0, 0.01),
            (MAG, SCALE, 1.0, 0.01),
            (MAG, CROSS, 0.0, 0.01),
        ],
    )
    def test_what_lies_near_neutral_is_neutral_after_a_restart(self, about, triple, neutral, limit):
        for factor, lasts in ((0.99, False), (1.01, True)):
            wanted = neutral + factor * limit * np.array([0.6, 0.0, -0.8])
            assert survives_restart(about, triple, wanted) is lasts
            kept = representable(vector(about, triple, wanted))
            np.testing.assert_allclose(kept, wanted if lasts else np.full(3, neutral), rtol=1e-6)

    def test_a_gyro_keeps_any_offset(self):
        assert survives_restart(GYRO, OFFSET, np.array([1e-6, 0, 0]))

    def test_an_order_is_found_in_which_a_change_acts_at_once(self, px4_parameters):
        known = px4_parameters | {"CAL_ACC0_XOFF": 0.5, "CAL_ACC0_YOFF": 0.5}
        draft = Draft(known, ComposeOptions(), ParameterKind.INT32)
        for values, order in (
            ([0.52, 0.5, 0.0], (0,)),
            ([0.505, 0.5, 0.0], None),
            ([0.5, 0.5, 0.0], ()),
            ([0.52, 0.505, 0.0], (1, 0)),  # the small step first: it counts together with the large one
            ([0.505, 0.5, 0.3], (0, 2)),
        ):
            assert order_without_restart(draft, vector(ACCEL, OFFSET, values), np.array(values)) == order

    def test_an_empty_row_is_loaded_whole(self, px4_parameters):
        draft = Draft(px4_parameters | {"CAL_ACC0_ID": 0}, ComposeOptions(), ParameterKind.INT32)
        assert order_without_restart(draft, vector(ACCEL, OFFSET, [0.001, 0, 0]), np.array([0.001, 0, 0])) == (0, 1, 2)

    @pytest.mark.parametrize(("deviation", "written"), [(1.61, False), (1.62, True)])
    def test_a_restart_is_not_asked_for_the_noise_of_a_vector(self, px4_parameters, deviation, written):
        """7.815 is the 95 % quantile of chi-squared with three degrees of freedom: 3 x 1.614^2."""
        known = px4_parameters | {f"CAL_ACC0_{a}OFF": 0.5 for a in "XYZ"}
        draft = Draft(known, ComposeOptions(), ParameterKind.INT32)
        wanted = vector(ACCEL, OFFSET, [0.5 + deviation * 1e-3] * 3, sd=1e-3)
        set_vector(draft, wanted, wanted.values.astype(np.float32).astype(np.float64))
        assert [c.needs_reboot for c in draft.changes] == ([True] * 3 if written else [])
        if written:
            first = draft.changes[0]
            assert (first.sd, first.unit) == (1e-3, "u")
            assert first.why == "why, x axis; too small a change for PX4's memory, it acts after a restart"
        certain = vector(ACCEL, OFFSET, [0.5 + 1e-3] * 3)
        set_vector(draft, certain, certain.values)
        assert len(draft.changes) == 3


class TestSlots:
    def test_filled_rows_come_first_and_then_the_free_ones(self):
        known = {"CAL_ACC1_ID": 5, "CAL_ACC3_ID": 6}
        assert [px4_slot(known, Sensor.ACCEL, k) for k in range(4)] == [1, 3, 0, 2]
        with pytest.raises(FirmwareError, match="PX4 has 4 rows for accel; instance 4 has none"):
            px4_slot(known, Sensor.ACCEL, 4)
        assert px4_slot(known, Sensor.ACCEL, 0, {(Sensor.ACCEL, 0): 6}) == 3
        assert px4_sensor_ids(known) == {(Sensor.ACCEL, 0): 5, (Sensor.ACCEL, 1): 6}

    def test_thermal_rows_are_shared_out_among_those_without_one(self):
        known = {"CAL_GYRO0_ID": 5, "CAL_GYRO1_ID": 6, "CAL_GYRO2_ID": 7, "TC_G1_ID": 6, "TC_G2_ID": 99}
        assert [px4_thermal_slot(known, Sensor.GYRO, d) for d in (5, 6, 7, 99, 0, 8)] == [0, 1, 3, 2, None, None]
        assert px4_thermal_slot({"CAL_GYRO0_ID": 1}, Sensor.GYRO, 1) == 0
        assert px4_thermal_slot({"CAL_MAG0_ID": 5}, Sensor.MAG, 5) is None

    def test_a_compass_without_a_rank_is_its_slot(self):
        assert [ardupilot_compass_slot({}, k) for k in range(3)] == [0, 1, 2]
        ranked = {"COMPASS_PRIO1_ID": 7, "COMPASS_DEV_ID3": 7, "COMPASS_PRIO2_ID": 9, "COMPASS_DEV_ID4": 9}
        assert ardupilot_compass_slot(ranked, 0) == 2
        assert ardupilot_compass_slot({"COMPASS_PRIO3_ID": 7, "COMPASS_DEV_ID": 7}, 2) == 0
        for known in (ranked, {"COMPASS_PRIO2_ID": 1}):
            with pytest.raises(FirmwareError, match=f"compass 2 has device id {known['COMPASS_PRIO2_ID']} "):
                ardupilot_compass_slot(known, 1)

    def test_only_sensors_with_an_id_are_known(self):
        known = {"INS_ACC_ID": 5, "INS5_GYR_ID": 6, "COMPASS_DEV_ID2": 8, "COMPASS_PRIO2_ID": 9, "COMPASS_DEV_ID3": 4}
        assert ardupilot_sensor_ids(known) == {
            (Sensor.ACCEL, 0): 5,
            (Sensor.GYRO, 4): 6,
            (Sensor.MAG, 1): 9,
            (Sensor.MAG, 2): 4,
        }
        assert ardupilot_sensor_ids({}) == px4_sensor_ids({}) == {}
