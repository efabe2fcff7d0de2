from __future__ import annotations

import numpy as np
import pytest

from mavcal.calib.errors import FirmwareError
from mavcal.calib.firmware.names import Role
from mavcal.calib.firmware.px4 import parameters as px4
from mavcal.calib.firmware.px4.parameters import Px4Calibration
from mavcal.calib.recording import Sensor

AXES = "XYZ"
BOARD = {"SENS_BOARD_ROT": 0, "SENS_BOARD_X_OFF": 0.0, "SENS_BOARD_Y_OFF": 0.0, "SENS_BOARD_Z_OFF": 0.0}


def row(stem: str, device: int, *, offset: tuple[float, ...] = (0, 0, 0), scale: tuple[float, ...] = (1, 1, 1),
        cross: tuple[float, ...] = (0, 0, 0), rotation: int = -1) -> dict[str, float]:  # fmt: skip
    values: dict[str, float] = {f"{stem}_ID": device, f"{stem}_ROT": rotation}
    for axis, o, s, c in zip(AXES, offset, scale, cross, strict=True):
        values |= {f"{stem}_{axis}OFF": o, f"{stem}_{axis}SCALE": s, f"{stem}_{axis}ODIAG": c}
    return values


def thermal(letter: str, slot: int, device: int) -> dict[str, float]:
    values: dict[str, float] = {
        f"TC_{letter}_ENABLE": 1,
        f"TC_{letter}{slot}_ID": device,
        f"TC_{letter}{slot}_TREF": 25.0,
        f"TC_{letter}{slot}_TMIN": 0.0,
        f"TC_{letter}{slot}_TMAX": 40.0,
    }
    for axis in range(3):
        for order, value in enumerate((0.02, 0.001, 0.0001, 0.0)):
            values[f"TC_{letter}{slot}_X{order}_{axis}"] = value
    return values


def written(parameters: dict[str, float], sensor: Sensor, *writes: tuple[str, float]) -> Px4Calibration:
    """What is in memory after a boot with `parameters` and then these writes, one by one."""
    memory = Px4Calibration.load(parameters, sensor, 0)
    for name, value in writes:
        parameters = parameters | {name: value}
        memory = memory.update(parameters)
    return memory


class TestNames:
    @pytest.mark.parametrize(
        ("sensor", "role", "name"),
        [
            (Sensor.ACCEL, Role.OFFSET_X, "CAL_ACC0_XOFF"),
            (Sensor.ACCEL, Role.SCALE_Z, "CAL_ACC0_ZSCALE"),
            (Sensor.GYRO, Role.OFFSET_Y, "CAL_GYRO0_YOFF"),
            (Sensor.MAG, Role.CROSS_XY, "CAL_MAG0_XODIAG"),
            (Sensor.MAG, Role.CROSS_XZ, "CAL_MAG0_YODIAG"),
            (Sensor.MAG, Role.CROSS_YZ, "CAL_MAG0_ZODIAG"),
            (Sensor.MAG, Role.MOTOR_X, "CAL_MAG0_XCOMP"),
            (Sensor.MAG, Role.PRIORITY, "CAL_MAG0_PRIO"),
        ],
    )
    def test_of_the_first_row(self, sensor: Sensor, role: Role, name: str) -> None:
        assert px4.calibration_names({}, sensor, 0)[role] == name

    def test_rows_belong_to_device_ids(self) -> None:
        parameters = {"CAL_ACC0_ID": 0, "CAL_ACC1_ID": 77, "CAL_ACC3_ID": 99}
        assert px4.calibration_names(parameters, Sensor.ACCEL, 0)[Role.ID] == "CAL_ACC1_ID"
        assert px4.calibration_names(parameters, Sensor.ACCEL, 1)[Role.ID] == "CAL_ACC3_ID"
        assert px4.sensor_ids(parameters) == {(Sensor.ACCEL, 0): 77, (Sensor.ACCEL, 1): 99}

    def test_a_new_sensor_takes_a_free_row(self) -> None:
        assert px4.calibration_names({"CAL_ACC0_ID": 0, "CAL_ACC1_ID": 77}, Sensor.ACCEL, 1)[Role.ID] == "CAL_ACC0_ID"

    def test_thermal_rows_have_their_own_ids(self) -> None:
        parameters = {"CAL_ACC0_ID": 77, "CAL_ACC1_ID": 88, "TC_A1_ID": 77}
        names = px4.calibration_names(parameters, Sensor.ACCEL, 0)
        assert names[Role.OFFSET_X] == "CAL_ACC0_XOFF"
        assert names[Role.THERMAL_0_Y] == "TC_A1_X0_1"
        assert px4.calibration_names(parameters, Sensor.ACCEL, 1)[Role.THERMAL_3_X] == "TC_A0_X3_0"

    def test_new_sensors_never_share_a_thermal_row(self) -> None:
        parameters = {"CAL_GYRO0_ID": 1, "CAL_GYRO1_ID": 2, "CAL_GYRO2_ID": 3, "TC_G1_ID": 2}
        rows = [px4.calibration_names(parameters, Sensor.GYRO, i)[Role.THERMAL_ID] for i in range(3)]
        assert rows == ["TC_G0_ID", "TC_G1_ID", "TC_G2_ID"]

    def test_a_magnetometer_has_no_thermal_row(self) -> None:
        assert Role.THERMAL_0_X not in px4.calibration_names({"CAL_MAG0_ID": 5}, Sensor.MAG, 0)


class TestThresholds:
    """The sequences measured on a running PX4 (FLIGHT_CONTROLLERS 10)."""

    ACCEL = row("CAL_ACC0", 7)
    GYRO = row("CAL_GYRO0", 7)
    MAG = row("CAL_MAG0", 7)

    def test_accelerometer_offset(self) -> None:
        assert written(self.ACCEL, Sensor.ACCEL, ("CAL_ACC0_XOFF", 0.005)).offset[0] == 0.0
        assert written(self.ACCEL, Sensor.ACCEL, ("CAL_ACC0_XOFF", 0.02)).offset[0] == 0.02
        twice = written(self.ACCEL, Sensor.ACCEL, ("CAL_ACC0_XOFF", 0.02), ("CAL_ACC0_XOFF", 0.025))
        assert twice.offset[0] == 0.02

    def test_the_norm_of_the_vector_counts(self) -> None:
        writes = [(f"CAL_ACC0_{axis}OFF", 0.006) for axis in AXES]
        assert not written(self.ACCEL, Sensor.ACCEL, *writes[:2]).offset.any()
        assert written(self.ACCEL, Sensor.ACCEL, *writes).offset == pytest.approx([0.006] * 3)

    def test_a_decoy_brings_a_small_value_in_until_the_restart(self) -> None:
        writes = ("CAL_ACC0_XOFF", 0.05), ("CAL_ACC0_XOFF", 0.005)
        assert written(self.ACCEL, Sensor.ACCEL, *writes).offset[0] == 0.005
        assert Px4Calibration.load(self.ACCEL | {"CAL_ACC0_XOFF": 0.005}, Sensor.ACCEL, 0).offset[0] == 0.0

    @pytest.mark.parametrize(("value", "acts"), [(1.004, 1.0), (1.02, 1.02), (0.0, 1.0), (-1.0, 1.0)])
    def test_scale(self, value: float, acts: float) -> None:
        assert written(self.ACCEL, Sensor.ACCEL, ("CAL_ACC0_XSCALE", value)).scale[0] == acts

    def test_gyroscope_offset_is_free_at_boot_only(self) -> None:
        assert written(self.GYRO, Sensor.GYRO, ("CAL_GYRO0_XOFF", 0.005)).offset[0] == 0.0
        assert Px4Calibration.load(self.GYRO | {"CAL_GYRO0_XOFF": 0.005}, Sensor.GYRO, 0).offset[0] == 0.005

    def test_magnetometer(self) -> None:
        assert written(self.MAG, Sensor.MAG, ("CAL_MAG0_XOFF", 0.003)).offset[0] == 0.0
        twice = written(self.MAG, Sensor.MAG, ("CAL_MAG0_XOFF", 0.01), ("CAL_MAG0_XOFF", 0.013))
        assert twice.offset[0] == 0.01
        assert written(self.MAG, Sensor.MAG, ("CAL_MAG0_ZSCALE", 1.005)).scale[2] == 1.0
        assert written(self.MAG, Sensor.MAG, ("CAL_MAG0_YODIAG", 0.005)).cross[1] == 0.0
        assert written(self.MAG, Sensor.MAG, ("CAL_MAG0_YODIAG", 0.02)).cross[1] == 0.02

    def test_no_number_never_reaches_memory(self) -> None:
        assert not written(self.ACCEL, Sensor.ACCEL, ("CAL_ACC0_XOFF", float("nan"))).offset.any()

    def test_a_sensor_that_lost_its_row_is_reset(self) -> None:
        stored = row("CAL_ACC0", 7, offset=(0.5, 0, 0))
        assert written(stored, Sensor.ACCEL, ("CAL_ACC0_ID", 0)).offset[0] == 0.0


class TestInForce:
    def test_thermal_offset_scale(self) -> None:
        parameters = BOARD | row("CAL_ACC0", 7, offset=(0.1, 0, 0), scale=(1.02, 1, 1)) | thermal("A", 2, 7)
        model = px4.calibration_in_force(parameters, Sensor.ACCEL, 0)
        # at 45 degC clamped to 40: TC = 0.02 + 0.001 * 15 + 0.0001 * 225 = 0.0575; 1.02 (1 - 0.0575 - 0.1)
        assert model.apply([1.0, 0, 0], 45.0)[0] == pytest.approx(0.85935)

    def test_another_devices_thermal_row_does_not_count(self) -> None:
        parameters = BOARD | row("CAL_ACC0", 7) | thermal("A", 0, 8)
        assert px4.calibration_in_force(parameters, Sensor.ACCEL, 0).polynomial is None

    @pytest.mark.parametrize(("owner", "device"), [(0, 7), (0, 0), (8, 7), (8, 0)])
    @pytest.mark.parametrize(("letter", "sensor", "stem"), [("A", Sensor.ACCEL, "ACC"), ("G", Sensor.GYRO, "GYRO")])
    def test_a_thermal_row_of_nobody_does_not_count(
        self, owner: int, device: int, letter: str, sensor: Sensor, stem: str
    ) -> None:
        """A free row may hold what an earlier sensor left there; two ids of zero are no match."""
        names = px4.calibration_names({f"CAL_{stem}0_ID": 7}, sensor, 0)
        assert names[Role.THERMAL_ID] == f"TC_{letter}0_ID"
        parameters = BOARD | row(f"CAL_{stem}0", device) | thermal(letter, 0, owner)
        model = px4.calibration_in_force(parameters, sensor, 0)
        assert model.polynomial is None
        assert not model.offset.any()

    def test_thermal_rows_act_only_when_enabled(self) -> None:
        for enable, acts in ((0, False), (1, True), (2, False)):
            parameters = BOARD | row("CAL_GYRO0", 7) | thermal("G", 0, 7) | {"TC_G_ENABLE": enable}
            assert (px4.calibration_in_force(parameters, Sensor.GYRO, 0).polynomial is not None) == acts
        del parameters["TC_G_ENABLE"]  # never announced: nothing acts
        assert px4.calibration_in_force(parameters, Sensor.GYRO, 0).polynomial is None

    def test_board_rotation_then_level(self) -> None:
        turned = BOARD | {"SENS_BOARD_ROT": 2, "SENS_BOARD_X_OFF": 90.0} | row("CAL_ACC0", 7)
        model = px4.calibration_in_force(turned, Sensor.ACCEL, 0)
        # yaw 90 takes x to y, then roll 90 takes y to z
        assert model.apply([1.0, 0, 0]) == pytest.approx([0, 0, 1.0])

    def test_an_external_sensor_has_its_own_rotation(self) -> None:
        parameters = BOARD | {"SENS_BOARD_ROT": 2} | row("CAL_MAG0", 7, rotation=4)
        assert px4.mounting(parameters, Sensor.MAG, 0) @ [1, 0, 0] == pytest.approx([-1, 0, 0])

    def test_a_magnetometer_subtracts_gauss_in_its_own_frame(self) -> None:
        parameters = BOARD | row(
            "CAL_MAG0", 7, offset=(0.1, -0.2, 0.3), scale=(1.1, 0.9, 1.0), cross=(0.02, -0.03, 0.04), rotation=4
        )
        model = px4.calibration_in_force(parameters, Sensor.MAG, 0)
        # (0.3, 0.1, 0.7) G less the offset is (0.2, 0.3, 0.4); S of it is (0.214, 0.290, 0.406); yaw 180
        assert model.apply([30.0, 10.0, 70.0]) == pytest.approx([-21.4, -29.0, 40.6])

    def test_memory_decides_and_not_what_is_stored(self) -> None:
        stored = BOARD | row("CAL_ACC0", 7, offset=(0.05, 0, 0))
        memory = Px4Calibration.load(stored, Sensor.ACCEL, 0)
        stored = stored | {"CAL_ACC0_XOFF": 0.057}
        assert px4.calibration_in_force(stored, Sensor.ACCEL, 0, memory).offset[0] == 0.05
        assert px4.calibration_in_force(stored, Sensor.ACCEL, 0).offset[0] == 0.057  # after a restart

    def test_an_uncalibrated_sensor_streams_as_it_is(self) -> None:
        model = px4.calibration_in_force(BOARD | row("CAL_ACC0", 0, offset=(1, 1, 1)), Sensor.ACCEL, 0)
        assert np.array_equal(model.offset, np.zeros(3))
        assert np.array_equal(model.matrix, np.eye(3))

    @pytest.mark.parametrize("name", ["CAL_ACC0_ID", "CAL_ACC0_YOFF", "CAL_ACC0_ZSCALE", "SENS_BOARD_ROT"])
    def test_what_was_not_seen_is_no_default(self, name: str) -> None:
        parameters = BOARD | row("CAL_ACC0", 7)
        del parameters[name]
        with pytest.raises(FirmwareError, match=name):
            px4.calibration_in_force(parameters, Sensor.ACCEL, 0)
