from __future__ import annotations

import numpy as np
import pytest

from mavcal.calib.errors import FirmwareError
from mavcal.calib.firmware.ardupilot import parameters as ardupilot
from mavcal.calib.firmware.names import Role
from mavcal.calib.recording import Sensor

AXES = "XYZ"


def vector(stem: str, values: tuple[float, float, float]) -> dict[str, float]:
    return {stem.format(axis): value for axis, value in zip(AXES, values, strict=True)}


def imu(**more: float) -> dict[str, float]:
    return {
        **vector("INS_ACCOFFS_{}", (0.1, -0.2, 0.3)),
        **vector("INS_ACCSCAL_{}", (1.02, 0.98, 1.01)),
        **vector("INS_GYROFFS_{}", (0.01, -0.02, 0.03)),
        "AHRS_ORIENTATION": 0,
        **more,
    }


def tcal(caltemp: float, enable: int = 1) -> dict[str, float]:
    values: dict[str, float] = {
        "INS_TCAL1_ENABLE": enable,
        "INS_TCAL1_TMIN": 0,
        "INS_TCAL1_TMAX": 70,
        "INS_ACC1_CALTEMP": caltemp,
        "INS_GYR1_CALTEMP": caltemp,
    }
    for sensor in ("ACC", "GYR"):
        for order, value in ((1, 1000.0), (2, 20.0), (3, 3.0)):
            values |= vector(f"INS_TCAL1_{sensor}{order}_{{}}", (value, 0.0, -value))
    return values


def compass(**more: float) -> dict[str, float]:
    return {
        **vector("COMPASS_OFS_{}", (10.0, -20.0, 30.0)),
        **vector("COMPASS_DIA_{}", (1.1, 0.9, 1.0)),
        **vector("COMPASS_ODI_{}", (0.02, -0.03, 0.04)),
        **vector("COMPASS_MOT_{}", (2.0, -1.0, 0.5)),
        "COMPASS_SCALE": 1.2,
        "COMPASS_EXTERNAL": 1,
        "COMPASS_ORIENT": 0,
        "COMPASS_MOTCT": 0,
        "AHRS_ORIENTATION": 0,
        **more,
    }


def corrected_mgauss(parameters: dict[str, float], chip_mgauss: tuple[float, float, float]) -> np.ndarray:
    model = ardupilot.calibration_in_force(parameters, Sensor.MAG, 0)
    return model.apply(0.1 * np.array(chip_mgauss)) / 0.1


class TestNames:
    @pytest.mark.parametrize(
        ("sensor", "instance", "role", "name"),
        [
            (Sensor.ACCEL, 0, Role.OFFSET_X, "INS_ACCOFFS_X"),
            (Sensor.ACCEL, 1, Role.OFFSET_X, "INS_ACC2OFFS_X"),
            (Sensor.ACCEL, 2, Role.SCALE_Z, "INS_ACC3SCAL_Z"),
            (Sensor.ACCEL, 3, Role.OFFSET_Y, "INS4_ACCOFFS_Y"),
            (Sensor.GYRO, 0, Role.OFFSET_X, "INS_GYROFFS_X"),
            (Sensor.GYRO, 1, Role.OFFSET_Z, "INS_GYR2OFFS_Z"),
            (Sensor.ACCEL, 0, Role.TEMPERATURE, "INS_ACC1_CALTEMP"),
            (Sensor.ACCEL, 1, Role.TEMPERATURE, "INS_ACC2_CALTEMP"),
            (Sensor.GYRO, 4, Role.TEMPERATURE, "INS5_GYR_CALTEMP"),
            (Sensor.ACCEL, 0, Role.ID, "INS_ACC_ID"),
            (Sensor.GYRO, 2, Role.ID, "INS_GYR3_ID"),
            (Sensor.ACCEL, 0, Role.USE, "INS_USE"),
            (Sensor.ACCEL, 1, Role.USE, "INS_USE2"),
            (Sensor.ACCEL, 0, Role.THERMAL_3_Z, "INS_TCAL1_ACC3_Z"),
            (Sensor.GYRO, 1, Role.THERMAL_1_X, "INS_TCAL2_GYR1_X"),
            (Sensor.ACCEL, 3, Role.THERMAL_ENABLE, "INS4_TCAL_ENABLE"),
            (Sensor.MAG, 0, Role.OFFSET_X, "COMPASS_OFS_X"),
            (Sensor.MAG, 1, Role.OFFSET_X, "COMPASS_OFS2_X"),
            (Sensor.MAG, 2, Role.CROSS_YZ, "COMPASS_ODI3_Z"),
            (Sensor.MAG, 1, Role.FIELD_SCALE, "COMPASS_SCALE2"),
            (Sensor.MAG, 0, Role.EXTERNAL, "COMPASS_EXTERNAL"),
            (Sensor.MAG, 1, Role.EXTERNAL, "COMPASS_EXTERN2"),
            (Sensor.MAG, 1, Role.ID, "COMPASS_DEV_ID2"),
            (Sensor.MAG, 1, Role.PRIORITY, "COMPASS_PRIO2_ID"),
        ],
    )
    def test_of_every_trap(self, sensor: Sensor, instance: int, role: Role, name: str) -> None:
        assert ardupilot.calibration_names({}, sensor, instance)[role] == name

    def test_a_gyroscope_has_no_scale(self) -> None:
        assert Role.SCALE_X not in ardupilot.calibration_names({}, Sensor.GYRO, 0)

    def test_a_compass_is_found_by_its_rank_not_its_slot(self) -> None:
        parameters = {
            "COMPASS_PRIO1_ID": 222,
            "COMPASS_PRIO2_ID": 111,
            "COMPASS_DEV_ID": 111,
            "COMPASS_DEV_ID2": 222,
        }
        first = ardupilot.calibration_names(parameters, Sensor.MAG, 0)
        assert first[Role.OFFSET_X] == "COMPASS_OFS2_X"
        assert first[Role.ID] == "COMPASS_DEV_ID2"
        assert first[Role.USE] == "COMPASS_USE"  # counts by rank
        assert ardupilot.sensor_ids(parameters) == {(Sensor.MAG, 0): 222, (Sensor.MAG, 1): 111}

    def test_a_ranked_compass_without_a_slot_is_refused(self) -> None:
        with pytest.raises(FirmwareError, match="COMPASS_PRIO1_ID"):
            ardupilot.calibration_names({"COMPASS_PRIO1_ID": 5, "COMPASS_DEV_ID": 6}, Sensor.MAG, 0)

    @pytest.mark.parametrize(("sensor", "instance"), [(Sensor.ACCEL, 5), (Sensor.MAG, 3), (Sensor.CURRENT, 0)])
    def test_what_has_no_parameters_is_refused(self, sensor: Sensor, instance: int) -> None:
        with pytest.raises(FirmwareError):
            ardupilot.calibration_names({}, sensor, instance)


class TestInertial:
    def test_offset_then_scale(self) -> None:
        model = ardupilot.calibration_in_force(imu(), Sensor.ACCEL, 0)
        assert model.apply([1.1, 0.8, -9.7]) == pytest.approx([1.02, 0.98, -10.1])

    def test_the_board_is_turned_after_the_correction(self) -> None:
        model = ardupilot.calibration_in_force(imu(AHRS_ORIENTATION=2), Sensor.ACCEL, 0)  # yaw 90
        assert model.apply([1.1, 0.8, -9.7]) == pytest.approx([-0.98, 1.02, -10.1])

    def test_a_gyroscope_only_loses_its_offset(self) -> None:
        model = ardupilot.calibration_in_force(imu(AHRS_ORIENTATION=8), Sensor.GYRO, 0)  # roll 180
        assert model.apply([0.11, 0.08, 0.03]) == pytest.approx([0.1, -0.1, 0.0])

    def test_temperature_about_35_degrees_and_caltemp(self) -> None:
        model = ardupilot.calibration_in_force(imu(**tcal(25.0)), Sensor.ACCEL, 0)
        # P(10) = 0.015, P(-10) = -0.011: u = 1 - 0.015 - 0.011 = 0.974; 1.02 (0.974 - 0.1)
        assert model.apply([1.0, 0.0, 0.0], 45.0)[0] == pytest.approx(0.89148)

    def test_temperature_of_a_gyroscope(self) -> None:
        model = ardupilot.calibration_in_force(imu(**tcal(25.0)), Sensor.GYRO, 0)
        assert model.apply([0.1, 0.0, 0.0], 45.0)[0] == pytest.approx(0.1 - 0.015 - 0.011 - 0.01)

    def test_temperature_is_clamped_to_the_range(self) -> None:
        model = ardupilot.calibration_in_force(imu(**tcal(25.0)), Sensor.ACCEL, 0)
        assert model.apply([1.0, 0.0, 0.0], 95.0) == pytest.approx(model.apply([1.0, 0.0, 0.0], 70.0))

    def test_an_unset_caltemp_means_tmin(self) -> None:
        model = ardupilot.calibration_in_force(imu(**tcal(-300.0)), Sensor.ACCEL, 0)
        # P(-35) = -0.139125: u = 1 - 0.015 - 0.139125
        assert model.apply([1.0, 0.0, 0.0], 45.0)[0] == pytest.approx(0.7607925)

    @pytest.mark.parametrize("enable", [0, 2])
    def test_nothing_thermal_unless_enabled(self, enable: int) -> None:
        assert ardupilot.calibration_in_force(imu(**tcal(25.0, enable)), Sensor.ACCEL, 0).polynomial is None

    def test_a_scale_of_zero_is_refused(self) -> None:
        with pytest.raises(FirmwareError, match="INS_ACCSCAL_"):
            ardupilot.calibration_in_force(imu(INS_ACCSCAL_Y=0.0), Sensor.ACCEL, 0)

    @pytest.mark.parametrize("name", ["INS_ACCOFFS_Z", "INS_ACCSCAL_X", "AHRS_ORIENTATION"])
    def test_what_was_not_seen_is_no_default(self, name: str) -> None:
        parameters = imu()
        del parameters[name]
        with pytest.raises(FirmwareError, match=name):
            ardupilot.calibration_in_force(parameters, Sensor.ACCEL, 0)

    def test_hidden_coefficients_must_be_read_once_enabled(self) -> None:
        with pytest.raises(FirmwareError, match="INS_TCAL1_TMIN"):
            ardupilot.calibration_in_force(imu(INS_TCAL1_ENABLE=1), Sensor.ACCEL, 0)

    def test_a_value_that_is_no_number_is_refused(self) -> None:
        with pytest.raises(FirmwareError, match="nan"):
            ardupilot.calibration_in_force(imu(INS_ACCOFFS_X=float("nan")), Sensor.ACCEL, 0)

    def test_custom_rotation(self) -> None:
        turned = imu(AHRS_ORIENTATION=101, CUST_ROT1_ROLL=0, CUST_ROT1_PITCH=0, CUST_ROT1_YAW=90)
        model = ardupilot.calibration_in_force(turned, Sensor.ACCEL, 0)
        assert model.apply([1.1, 0.8, -9.7]) == pytest.approx([-0.98, 1.02, -10.1])

    def test_an_unknown_rotation_is_refused(self) -> None:
        with pytest.raises(FirmwareError, match="44"):
            ardupilot.calibration_in_force(imu(AHRS_ORIENTATION=44), Sensor.ACCEL, 0)


class TestCompass:
    def test_the_offset_is_added_then_scale_then_matrix(self) -> None:
        # (210, -120, 430) times 1.2 is (252, -144, 516)
        assert corrected_mgauss(compass(), (200.0, -100.0, 400.0)) == pytest.approx([258.84, -103.92, 502.68])

    @pytest.mark.parametrize(("stored", "acts"), [(0.0, 1.0), (1.6, 1.0), (0.66, 1.0), (1.5, 1.5), (0.67, 0.67)])
    def test_the_scale_acts_inside_its_window_only(self, stored: float, acts: float) -> None:
        field = (200.0, -100.0, 400.0)
        unscaled = corrected_mgauss(compass(COMPASS_SCALE=1.0), field)
        assert corrected_mgauss(compass(COMPASS_SCALE=stored), field) == pytest.approx(acts * unscaled)

    def test_an_all_zero_diagonal_switches_the_matrix_off(self) -> None:
        parameters = compass(**vector("COMPASS_DIA_{}", (0.0, 0.0, 0.0)))
        assert corrected_mgauss(parameters, (200.0, -100.0, 400.0)) == pytest.approx([252.0, -144.0, 516.0])

    def test_offsets_lie_in_the_body_frame(self) -> None:
        parameters = compass(COMPASS_ORIENT=4, AHRS_ORIENTATION=2)  # yaw 180; the board's rotation does not matter
        assert corrected_mgauss(parameters, (-200.0, 100.0, 400.0)) == pytest.approx([258.84, -103.92, 502.68])

    def test_an_internal_compass_turns_with_the_board(self) -> None:
        parameters = compass(COMPASS_EXTERNAL=0, COMPASS_ORIENT=2, AHRS_ORIENTATION=4)
        assert corrected_mgauss(parameters, (-200.0, 100.0, 400.0)) == pytest.approx([258.84, -103.92, 502.68])

    def test_mounting(self) -> None:
        turn = ardupilot.mounting(compass(COMPASS_ORIENT=2), Sensor.MAG, 0)
        assert turn @ [1.0, 0.0, 0.0] == pytest.approx([0.0, 1.0, 0.0])
        assert ardupilot.mounting(compass(AHRS_ORIENTATION=8), Sensor.ACCEL, 0) @ [0, 0, 1] == pytest.approx([0, 0, -1])


class TestMotors:
    def test_none(self) -> None:
        assert ardupilot.motor_term(compass(), 0, None, None) is None

    def test_by_throttle_in_ut(self) -> None:
        term = ardupilot.motor_term(compass(COMPASS_MOTCT=1), 0, np.array([0.0, 0.5]), None)
        assert term == pytest.approx(np.array([[0.0, 0.0, 0.0], [0.1, -0.05, 0.025]]))

    def test_by_current_in_ut(self) -> None:
        term = ardupilot.motor_term(compass(COMPASS_MOTCT=2), 0, None, np.array([10.0]))
        assert term == pytest.approx(np.array([[2.0, -1.0, 0.5]]))

    def test_without_the_current_it_cannot_be_undone(self) -> None:
        with pytest.raises(FirmwareError, match="BATTERY_STATUS"):
            ardupilot.motor_term(compass(COMPASS_MOTCT=2), 0, np.array([0.5]), None)

    def test_zero_gains_need_nothing(self) -> None:
        parameters = compass(COMPASS_MOTCT=2, **vector("COMPASS_MOT_{}", (0.0, 0.0, 0.0)))
        assert ardupilot.motor_term(parameters, 0, None, None) is None

    def test_motor_by_motor_is_refused(self) -> None:
        parameters = compass(COMPASS_MOTCT=3, COMPASS_PMOT_EN=1, COMPASS_PMOT2_Y=4.0)
        with pytest.raises(FirmwareError, match="motor by motor"):
            ardupilot.motor_term(parameters, 0, None, None)
        assert ardupilot.motor_term(parameters, 1, None, None) is None  # the first compass only
