from __future__ import annotations

import itertools
import math
import struct
from collections import Counter
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

CLEAN = {"offset": [0, 0, 0], "matrix": np.eye(3).tolist(), "polynomial": np.zeros((3, 3)).tolist()}
QUIET = {"accel_noise": 0.0, "gyro_noise": 0.0, "mag_noise": 0.0}
PERFECT = {"accels": CLEAN, "gyros": CLEAN, "mags": CLEAN}
SCALED, HIGHRES, INT32, REAL32 = 26, 105, 6, 9


def settled(bench: Any, *, writer: bool = False, **config: Any) -> Any:
    """A vehicle that is ready; its background writer off unless it is the subject."""
    b = bench("px4", parameters={"IMU_GYRO_CAL_EN": int(writer)}, **config)
    b.run(4.5)
    b.heard[0].clear()
    return b


@pytest.mark.parametrize("value", [-1, 1310988, 16777217, -8388000, 2147483647, -2147483648])
def test_integers_cross_the_wire_bit_by_bit(bench: Any, value: int) -> None:
    b = settled(bench)
    b.send_set("CAL_ACC3_ID", struct.pack("<i", value), INT32)
    echo = b.take_received("PARAM_VALUE")[0]
    assert struct.unpack("<i", echo.payload[:4]) == (value,)
    assert b.vehicle.table["CAL_ACC3_ID"].value == value


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("CAL_ACC0_XOFF", INT32),
        ("SENS_IMU_AUTOCAL", REAL32),
        ("SENS_IMU_AUTOCAL", 5),
        ("SENS_IMU_AUTOCAL", 2),
        ("NO", 9),
    ],
)
def test_a_wrong_type_or_name_is_met_with_silence(bench: Any, name: str, kind: int) -> None:
    b = settled(bench)
    b.send_set(name, struct.pack("<f", 1.0), kind)
    b.run(1.0)
    assert b.take("PARAM_VALUE") == []


def test_the_bytes_of_a_float_sent_as_an_integer_are_believed(bench: Any) -> None:
    b = settled(bench)
    b.send_set("SENS_IMU_AUTOCAL", struct.pack("<f", 1.0), INT32)
    assert b.vehicle.table["SENS_IMU_AUTOCAL"].value == 1065353216


def test_the_echo_comes_at_once_with_its_index_and_again_until_saved(bench: Any) -> None:
    b = settled(bench, links=2)
    b.set("CAL_ACC0_XOFF", 0.2)
    first = b.take("PARAM_VALUE")
    assert len(first) == 1
    assert b.vehicle.table.listing()[first[0].param_index].name == "CAL_ACC0_XOFF"
    b.run(0.45)
    assert [m.param_id for m in b.take("PARAM_VALUE", 0)] == ["CAL_ACC0_XOFF"]
    assert [m.param_id for m in b.take("PARAM_VALUE", 1)] == ["CAL_ACC0_XOFF"]


def test_an_equal_value_is_echoed_and_not_repeated(bench: Any) -> None:
    b = settled(bench)
    b.set("CAL_ACC0_XOFF", 0.0)
    b.run(1.0)
    assert len(b.take("PARAM_VALUE")) == 1


def test_values_are_saved_after_a_third_of_a_second_and_two_seconds_apart(bench: Any) -> None:
    b = settled(bench)
    b.set("CAL_ACC0_XOFF", 0.2)
    b.run(0.29)
    assert b.vehicle.table.saved["CAL_ACC0_XOFF"] == 0.0
    b.run(0.02)
    assert b.vehicle.table.saved["CAL_ACC0_XOFF"] == pytest.approx(0.2)
    b.set("CAL_ACC0_XOFF", 0.3)
    b.run(1.9)
    assert b.vehicle.table.saved["CAL_ACC0_XOFF"] == pytest.approx(0.2)
    b.run(0.2)
    assert b.vehicle.table.saved["CAL_ACC0_XOFF"] == pytest.approx(0.3)


def test_a_priority_that_does_not_exist_is_echoed_then_rewritten(bench: Any) -> None:
    b = settled(bench)
    b.send_set("CAL_ACC0_PRIO", struct.pack("<i", 500), INT32)
    assert struct.unpack("<i", b.take_received("PARAM_VALUE")[0].payload[:4]) == (500,)
    assert b.vehicle.table["CAL_ACC0_PRIO"].value == -1


def test_unlisted_parameters_answer_by_name(bench: Any) -> None:
    b = settled(bench)
    b.read("TC_A0_X0_0")
    assert b.take("PARAM_VALUE")[0].param_index == 65535
    b.set("TC_A0_X0_0", 0.1)
    assert b.take("PARAM_VALUE")[0].param_index == 65535


def test_a_slot_is_listed_from_the_moment_its_id_is_set(bench: Any) -> None:
    b = settled(bench)
    before = len(b.vehicle.table.listing())
    b.send_set("CAL_ACC3_ID", struct.pack("<i", 77), INT32)
    assert b.take("PARAM_VALUE")[0].param_count == before
    assert len(b.vehicle.table.listing()) == before + 8


def test_the_hash_does_not_notice_a_calibration(bench: Any) -> None:
    b = settled(bench)
    hashes = []
    for name, value in (("CAL_ACC0_XOFF", 0.1), ("CAL_MAG0_XODIAG", 0.2), ("MC_ROLL_P", 7.0)):
        b.read("_HASH_CHECK")
        hashes.append(b.take_received("PARAM_VALUE")[0].payload[:4])
        b.set(name, value)
        b.take("PARAM_VALUE")
    b.read("_HASH_CHECK")
    hashes.append(b.take_received("PARAM_VALUE")[0].payload[:4])
    assert hashes[0] == hashes[1] == hashes[2] != hashes[3]


def test_nan_freezes_the_vehicle_with_the_next_save_but_not_its_parameters(bench: Any) -> None:
    b = settled(bench)
    b.set("CAL_ACC1_XOFF", math.nan)
    b.run(3.0)
    assert b.take("HEARTBEAT")
    b.set("CAL_ACC2_XOFF", 0.1)
    b.run(0.5)
    b.heard[0].clear()
    b.run(5.0)
    assert b.heard[0] == []
    b.read("CAL_ACC2_XOFF")
    assert b.take("PARAM_VALUE")[0].param_value == pytest.approx(0.1)


def test_radio_streams_come_unasked_and_carry_no_imu(bench: Any) -> None:
    b = settled(bench)
    b.run(10.0)
    counts = Counter(r.name for r in b.heard[0])
    assert counts["EXTENDED_SYS_STATE"] == pytest.approx(10, abs=1)
    assert not {n for n in counts if "IMU" in n}


@pytest.mark.parametrize(
    ("asked_us", "steps_ms"),
    [
        (20000, {20}),
        (40000, {40}),
        (100000, {100}),
        (10000, {8, 12}),
        (8000, {8}),
        (5000, {8}),
        (4000, {4}),
        (1000, {4}),
    ],
)
def test_intervals_follow_the_four_millisecond_loop(bench: Any, asked_us: float, steps_ms: set[int]) -> None:
    b = settled(bench)
    b.command(511, SCALED, asked_us)
    b.run(2.0)
    stamps = [m.time_boot_ms for m in b.take("SCALED_IMU")]
    assert {y - x for x, y in itertools.pairwise(stamps)} == steps_ms


@pytest.mark.parametrize(
    ("number", "parameters", "result"),
    [
        (511, (27, 20000), 4),
        (511, (164, 20000), 4),
        (511, (26, 20000, 1), 4),
        (42424, (), 3),
        (241, (0, 76), 0),
        (241, (0, 0, 0, 0, 76), 0),
    ],
)
def test_what_is_refused_and_what_only_seems_accepted(
    bench: Any, number: int, parameters: tuple[float, ...], result: int
) -> None:
    b = settled(bench)
    b.command(number, *parameters)
    assert [m.result for m in b.take("COMMAND_ACK")] == [result]


def test_an_absent_instance_is_granted_and_never_sent(bench: Any) -> None:
    b = settled(bench, imu_count=1, mag_count=1)
    b.command(511, 116, 20000)
    b.command(510, 116)
    interval = [r.message.interval_us for r in b.heard[0] if r.name == "MESSAGE_INTERVAL"]
    assert [m.result for m in b.take("COMMAND_ACK")] == [0, 0]
    assert interval == [20000]
    b.run(1.0)
    assert b.take("SCALED_IMU2") == []


def test_request_data_stream_is_not_handled(bench: Any) -> None:
    b = settled(bench)
    b.send(dialect.MAVLink_request_data_stream_message(1, 1, 1, 10, 1))
    b.run(1.0)
    assert not {r.name for r in b.heard[0] if "IMU" in r.name}


FACTORY = {"CAL_GYRO0_ID": 0, "CAL_GYRO0_PRIO": -1}


@pytest.mark.parametrize("preset", [FACTORY, {"CAL_GYRO0_PRIO": -1}])
def test_a_gyro_of_the_factory_gets_its_row_and_priority_with_the_first_offset(
    bench: Any, preset: dict[str, int]
) -> None:
    """gyro_calibration stores id, priority, rotation and offset together, 5 s after the last change."""
    b = bench("px4", parameters=preset, boot_s=0.1)
    b.run(2.0)
    b.set("COM_DISARM_LAND", 3.0)
    b.run(4.5)
    assert b.vehicle.table.get("CAL_GYRO0_PRIO") == -1
    b.run(1.5)
    row = [b.vehicle.table.get(f"CAL_GYRO0_{name}") for name in ("ID", "PRIO", "ROT")]
    assert row == [1310988, 50, -1]
    assert any(b.vehicle.table.get(f"CAL_GYRO0_{axis}OFF") for axis in "XYZ")


def test_the_scaled_magnetometer_is_raw_whatever_is_calibrated(bench: Any) -> None:
    b = settled(bench, **QUIET)
    b.command(511, SCALED, 20000)
    b.set("CAL_MAG0_XOFF", 0.2)
    b.run(0.5)
    seen = b.take("SCALED_IMU")[-1]
    truth = b.vehicle.world.truth.mags[0]
    raw = (truth.matrix @ np.array(b.vehicle.config.field_ned_ut) + truth.offset) * 10
    assert [seen.xmag, seen.ymag, seen.zmag] == pytest.approx(np.trunc(raw), abs=1)


def test_accel_calibration_acts_while_armed_and_the_magnetometer_waits_for_the_next_change(bench: Any) -> None:
    b = settled(bench, **QUIET)
    b.vehicle.armed = True
    b.set("CAL_ACC0_XOFF", 0.2)
    b.set("CAL_MAG0_XOFF", 0.2)
    in_force = b.vehicle.in_force()
    assert in_force["CAL_ACC0_XOFF"] == pytest.approx(0.2)
    assert in_force["CAL_MAG0_XOFF"] == 0.0
    b.vehicle.armed = False
    b.run(1.0)
    assert b.vehicle.in_force()["CAL_MAG0_XOFF"] == 0.0
    b.set("MC_ROLL_P", 7.0)
    assert b.vehicle.in_force()["CAL_MAG0_XOFF"] == pytest.approx(0.2)


def test_highres_hides_an_offset_and_scaled_shows_it(bench: Any) -> None:
    b = settled(bench, truth=PERFECT, thermal=False, gyro_noise=0.0, accel_noise=0.0)
    b.command(511, SCALED, 20000)
    b.command(511, HIGHRES, 20000)
    b.set("CAL_ACC0_XOFF", 0.3)
    b.run(40.0)
    highres = np.mean([r.message.xacc for r in b.heard[0] if r.name == "HIGHRES_IMU"][-200:])
    scaled = np.mean([m.xacc for m in b.take("SCALED_IMU")][-200:])
    assert abs(highres) < 0.2
    assert scaled == pytest.approx(-30, abs=1)


def test_the_background_writer_takes_five_seconds(bench: Any) -> None:
    b = settled(bench, writer=True)
    b.run(10.0)
    b.heard[0].clear()
    b.set("CAL_GYRO0_XOFF", 0.3)
    start = b.vehicle.time
    while b.vehicle.table["CAL_GYRO0_XOFF"].value == pytest.approx(0.3) and b.vehicle.time < start + 10:
        b.run(0.02)
    assert 5.0 < b.vehicle.time - start < 5.2
    assert b.vehicle.table["CAL_GYRO0_XOFF"].value == pytest.approx(b.vehicle.world.truth.gyros[0].offset[0], abs=1e-3)


def test_the_background_writer_takes_a_steady_turn_for_bias_and_a_tilting_one_not(bench: Any) -> None:
    level = settled(bench, writer=True, truth=PERFECT)
    level.vehicle.world.motion.turn(level.vehicle.time, [0, 0, 1], 45.0)
    level.run(12.0)
    assert level.vehicle.table["CAL_GYRO0_ZOFF"].value == pytest.approx(math.radians(45.0), abs=0.02)
    rolling = settled(bench, writer=True, truth=PERFECT)
    rolling.vehicle.world.motion.turn(rolling.vehicle.time, [1, 0, 0], 45.0)
    rolling.run(12.0)
    assert rolling.vehicle.table["CAL_GYRO0_XOFF"].value == 0.0


def test_switching_the_writer_off_needs_a_restart(bench: Any) -> None:
    b = settled(bench, writer=True, boot_s=0.1)
    b.send_set("IMU_GYRO_CAL_EN", struct.pack("<i", 0), INT32)
    b.run(0.5)
    b.set("CAL_GYRO0_XOFF", 0.3)
    b.run(6.0)
    assert b.vehicle.table["CAL_GYRO0_XOFF"].value != pytest.approx(0.3)
    b.command(246, 1)
    b.run(1.0)
    assert b.vehicle.boots == 1
    b.set("CAL_GYRO0_XOFF", 0.3)
    b.run(8.0)
    assert b.vehicle.table["CAL_GYRO0_XOFF"].value == pytest.approx(0.3)


def test_thermal_sets_act_after_a_restart_exactly_and_without_threshold(bench: Any) -> None:
    b = settled(bench, truth=PERFECT, **QUIET, boot_s=0.1, temperature=45.0)
    b.send_set("TC_A0_ID", struct.pack("<i", 1310988), INT32)
    b.send_set("TC_A_ENABLE", struct.pack("<i", 1), INT32)
    b.set("TC_A0_X0_0", 0.004)
    b.set("TC_A0_X1_0", 0.001)
    b.run(3.0)
    assert b.vehicle.sensors.imu(0, b.vehicle.world.state(np.array([b.vehicle.time]))).accel[0, 0] == 0.0
    b.command(246, 1)
    b.run(1.0)
    now = b.vehicle.world.state(np.array([b.vehicle.time]))
    assert b.vehicle.sensors.imu(0, now).accel[0, 0] == pytest.approx(-0.004 - 0.001 * 20)


@pytest.mark.parametrize(
    ("name", "default"), [("TC_G0_X3_0", 0.0), ("TC_A0_X2_1", 0.0), ("CAL_MAG0_XODIAG", 0.0), ("CAL_ACC0_XSCALE", 1.0)]
)
@pytest.mark.parametrize("sign", [1, -1])
def test_a_float_within_the_epsilon_of_its_default_is_lost_with_the_restart(
    bench: Any, name: str, default: float, sign: int
) -> None:
    """parameters.cpp leaves it out of the file; until the restart it is echoed, read and in force."""
    b = settled(bench, boot_s=0.1)
    for value, kept in ((default + sign * 6e-8, default), (default + sign * 3e-7, default + sign * 3e-7)):
        b.set(name, value)
        b.run(0.1)
        b.set("COM_DISARM_LAND", 2.0 + 1e3 * abs(value))  # a change by so little asks for no save by itself
        b.run(3.0)
        assert b.vehicle.table.get(name) == pytest.approx(value, abs=1e-12, rel=1e-7)
        b.command(246, 1)
        b.run(1.0)
        assert b.vehicle.table.get(name) == float(np.float32(kept))


def test_the_simulator_build_does_not_know_thermal_sets(bench: Any) -> None:
    b = settled(bench, sitl=True, truth=PERFECT, **QUIET)
    assert b.vehicle.table.index_of("TC_A_ENABLE") is None
    assert settled(bench).vehicle.table.index_of("TC_A_ENABLE") is not None


def test_a_magnetometer_without_an_inertial_unit_of_its_number_is_sent(bench: Any) -> None:
    """SCALED_IMU2.hpp sends when either of the two is new."""
    b = settled(bench, imu_count=1, mag_count=2)
    b.command(511, 116, 20000)
    b.run(1.0)
    sent = b.take("SCALED_IMU2")
    assert len(sent) > 40
    assert all(m.zacc == 0 and (m.xmag, m.ymag, m.zmag) != (0, 0, 0) for m in sent)


def test_the_bit_of_the_arming_checks_is_among_what_is_healthy_alone(bench: Any) -> None:
    b = settled(bench)
    b.command(511, 1, 500000)
    b.run(2.0)
    status, bit = b.take("SYS_STATUS")[-1], dialect.MAV_SYS_STATUS_PREARM_CHECK
    assert not (status.onboard_control_sensors_present | status.onboard_control_sensors_enabled) & bit


def test_a_disabled_sensor_is_not_published(bench: Any) -> None:
    b = settled(bench, mag_count=1)
    b.command(511, 116, 20000)
    b.send_set("CAL_GYRO1_PRIO", struct.pack("<i", 0), INT32)
    b.run(0.1)
    b.heard[0].clear()
    b.run(1.0)
    assert b.take("SCALED_IMU2") == []


def test_quick_accel_writes_noise_and_six_sides_keep_the_vehicle_busy(bench: Any) -> None:
    b = settled(bench)
    b.command(241, 0, 0, 0, 0, 4)
    b.run(1.5)
    assert b.vehicle.table["CAL_ACC0_XOFF"].value != 0.0
    b.command(241, 0, 0, 0, 0, 1)
    b.run(0.5)
    b.heard[0].clear()
    b.command(241, 1)
    assert [m.result for m in b.take("COMMAND_ACK")] == [2, 2, 1]
    b.command(245, 1)
    assert [m.result for m in b.take("COMMAND_ACK")] == [1]
    b.command(241)
    b.run(0.1)
    assert any("cancelled" in m.text for m in b.take("STATUSTEXT"))


def test_storage_load_restores_in_silence(bench: Any) -> None:
    b = settled(bench)
    b.set("CAL_ACC0_XOFF", 0.3)
    b.command(245, 0)
    b.heard[0].clear()
    b.run(1.0)
    assert b.take("PARAM_VALUE") == []
    assert b.vehicle.table["CAL_ACC0_XOFF"].value == 0.0
    assert b.vehicle.in_force()["CAL_ACC0_XOFF"] == 0.0


def test_level_turns_the_board_so_that_the_present_pose_reads_level(bench: Any) -> None:
    b = settled(bench, truth=PERFECT, **QUIET)
    b.vehicle.world.motion.hold(b.vehicle.time, [4.0, -3.0, 0.0], transition_s=0.0)
    b.command(241, 0, 0, 0, 0, 2)
    b.run(2.0)
    now = b.vehicle.world.state(np.array([b.vehicle.time]))
    assert b.vehicle.sensors.imu(0, now).accel[0] == pytest.approx([0, 0, -9.80665], abs=0.05)


@pytest.mark.long
def test_a_barometer_calibration_never_ends_and_blocks_the_others(bench: Any) -> None:
    b = settled(bench)
    b.command(241, 0, 0, 1)
    b.run(200.0)
    b.heard[0].clear()
    b.command(241, 1)
    assert [m.result for m in b.take("COMMAND_ACK")] == [2, 2, 1]


def test_a_compass_whose_id_is_in_no_row_is_said_to_be_uncalibrated(bench: Any) -> None:
    """As a second compass on UAVCAN with the id of an earlier one in CAL_MAG1_ID: nothing reads that row."""
    b = bench("px4", parameters={"IMU_GYRO_CAL_EN": 0, "CAL_MAG1_ID": 8944899})
    b.run(4.5)
    (fault,) = b.vehicle.arming_faults()
    assert fault.startswith("Preflight Fail")
    assert "Compass 1" in fault
