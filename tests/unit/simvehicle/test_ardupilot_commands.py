from __future__ import annotations

from typing import Any

import numpy as np
import pytest

CLEAN = {"offset": [0, 0, 0], "matrix": np.eye(3).tolist(), "polynomial": np.zeros((3, 3)).tolist()}
CALIBRATE, ARM, REBOOT = 241, 400, 246


def results(b: Any) -> list[int]:
    return [m.result for m in b.take("COMMAND_ACK")]


def calibrated(bench: Any, **config: Any) -> Any:
    """Offsets in place on every IMU; ids not yet accepted."""
    b = bench("ardupilot", thermal=False, **config)
    for k, digit in enumerate(("", "2", "3")):
        offset = b.vehicle.world.truth.accels[k].offset
        for axis, value in zip("XYZ", offset, strict=True):
            b.set(f"INS_ACC{digit}OFFS_{axis}", float(value))
    b.run(0.1)
    b.heard[0].clear()
    return b


def test_gyro_calibration_answers_when_it_has_ended_and_stalls_the_streams(bench: Any) -> None:
    b = bench("ardupilot", thermal=False)
    b.command(511, 27, 20000)
    b.run(1.0)
    b.heard[0].clear()
    b.command(CALIBRATE, 1)
    b.run(0.5)
    assert {r.name for r in b.heard[0]} == {"HEARTBEAT", "STATUSTEXT"}
    b.run(0.1)
    assert results(b) == [0]
    truth = b.vehicle.world.truth.gyros
    for k, name in enumerate(("INS_GYROFFS_X", "INS_GYR2OFFS_X", "INS_GYR3OFFS_X")):
        assert b.vehicle.table[name].value == pytest.approx(truth[k].offset[0], abs=1e-3)
    assert b.vehicle.table["INS_GYR1_CALTEMP"].value == pytest.approx(35.0)


def test_gyro_calibration_takes_a_steady_turn_for_bias(bench: Any) -> None:
    b = bench("ardupilot", thermal=False, truth={"gyros": CLEAN})
    b.vehicle.world.motion.turn(b.vehicle.time, [0, 0, 1], 20.0)
    b.run(1.0)
    b.command(CALIBRATE, 1)
    b.run(0.6)
    assert results(b) == [0]
    assert b.vehicle.table["INS_GYROFFS_Z"].value == pytest.approx(np.radians(20.0), abs=1e-3)


@pytest.mark.parametrize(
    ("parameters", "result"), [((0, 1), 3), ((0, 0, 0, 1), 3), ((0, 0, 0, 0, 3), 3), ((3,), 3), ((0, 0, 1), 0)]
)
def test_what_the_calibration_command_does_not_know(bench: Any, parameters: tuple[float, ...], result: int) -> None:
    b = bench("ardupilot")
    b.command(CALIBRATE, *parameters)
    assert results(b) == [result]


def test_everything_is_refused_when_armed(bench: Any) -> None:
    b = bench("ardupilot")
    b.vehicle.armed = True
    for number, p in ((CALIBRATE, (1,)), (CALIBRATE, (0, 0, 0, 0, 76)), (REBOOT, (1,)), (42424, ())):
        b.command(number, *p)
    assert results(b) == [4, 4, 4, 4]
    assert b.vehicle.alive


def test_simple_accel_puts_the_whole_error_into_the_offset_and_again_too_soon_is_refused(bench: Any) -> None:
    b = bench("ardupilot", thermal=False)
    b.command(CALIBRATE, 0, 0, 0, 0, 4)
    b.run(1.5)
    assert results(b) == [0]
    truth = b.vehicle.world.truth.accels[0]
    expected = truth.matrix @ [0, 0, -9.80665] + truth.offset - [0, 0, -9.80665]
    assert b.vehicle.table.vector("INS_ACCOFFS") == pytest.approx(expected, abs=0.02)
    b.command(CALIBRATE, 0, 0, 0, 0, 2)
    assert results(b) == [1]


def test_level_writes_the_trim_and_the_attitude_follows(bench: Any) -> None:
    b = bench("ardupilot", thermal=False, truth={"accels": CLEAN})
    b.vehicle.world.motion.hold(b.vehicle.time, [3.0, -2.0, 0.0], transition_s=0.0)
    b.command(511, 30, 20000)
    b.command(CALIBRATE, 0, 0, 0, 0, 2)
    b.run(2.0)
    assert b.vehicle.table["AHRS_TRIM_X"].value == pytest.approx(np.radians(3.0), abs=1e-3)
    last = b.take("ATTITUDE")[-1]
    assert np.degrees([last.roll, last.pitch]) == pytest.approx([0.0, 0.0], abs=0.2)


def test_level_refuses_a_tilt_beyond_ten_degrees(bench: Any) -> None:
    b = bench("ardupilot", truth={"accels": CLEAN})
    b.vehicle.world.motion.hold(b.vehicle.time, [15.0, 0.0, 0.0], transition_s=0.0)
    b.command(CALIBRATE, 0, 0, 0, 0, 2)
    b.run(2.0)
    assert results(b) == [4]
    assert b.vehicle.table["AHRS_TRIM_X"].value == 0.0


def test_a_false_offset_tilts_the_attitude(bench: Any) -> None:
    b = bench("ardupilot", thermal=False, truth={"accels": CLEAN}, accel_noise=0.0)
    b.set("INS_ACCOFFS_Y", -0.05)
    b.command(511, 30, 20000)
    b.run(0.2)
    assert b.take("ATTITUDE")[-1].roll == pytest.approx(-0.05 / 9.80665, abs=1e-5)


def test_arming_needs_offsets_and_code_76(bench: Any) -> None:
    fresh = bench("ardupilot")
    fresh.command(CALIBRATE, 0, 0, 0, 0, 76)
    fresh.command(ARM, 1)
    fresh.run(0.05)
    assert any("3D Accel" in r.message.text for r in fresh.heard[0] if r.name == "STATUSTEXT")
    assert results(fresh) == [0, 4]
    b = calibrated(bench)
    b.command(ARM, 1)
    b.command(CALIBRATE, 0, 0, 0, 0, 76)
    b.command(CALIBRATE, 0, 76)
    b.command(ARM, 1)
    assert results(b) == [4, 0, 0, 0]
    assert b.vehicle.armed
    b.command(ARM, 0)
    assert not b.vehicle.armed


def test_arming_notices_imus_that_disagree(bench: Any) -> None:
    b = calibrated(bench)
    b.command(CALIBRATE, 0, 0, 0, 0, 76)
    b.set("INS_ACC2OFFS_X", 2.0)
    b.run(0.1)
    b.command(ARM, 1)
    b.run(0.05)
    assert any("Accels inconsistent" in r.message.text for r in b.heard[0] if r.name == "STATUSTEXT")


def test_compassmot_arms_and_deafens_until_a_reboot(bench: Any) -> None:
    b = bench("ardupilot")
    b.command(CALIBRATE, 0, 0, 0, 0, 0, 1)
    assert b.vehicle.armed
    b.command(512, 148)
    b.read("INS_ACC_ID")
    b.run(0.3)
    assert {r.name for r in b.heard[0]} <= {"HEARTBEAT", "STATUSTEXT"}


def test_compass_calibration_reports_only_where_asked_and_wants_a_reboot(bench: Any) -> None:
    b = bench("ardupilot", thermal=False, boot_s=0.1)
    b.vehicle.world.motion.tumble(b.vehicle.time)
    b.command(42424, 0, 0, 1)
    b.run(1.0)
    assert b.take("MAG_CAL_PROGRESS") == []
    b.command(511, 191, 200000)
    b.command(511, 192, 200000)
    b.run(5.0)
    progress = [m.completion_pct for m in b.take("MAG_CAL_PROGRESS")]
    assert progress == sorted(progress)
    b.run(20.0)
    assert b.take("MAG_CAL_REPORT")[-1].cal_status == 4
    truth = b.vehicle.world.truth.mags[0]
    assert b.vehicle.table["COMPASS_OFS_X"].value == pytest.approx(-10 * truth.offset[0], abs=1e-3)
    b.command(CALIBRATE, 0, 0, 0, 0, 76)
    b.command(ARM, 1)
    b.run(0.05)
    assert any("requires reboot" in r.message.text for r in b.heard[0] if r.name == "STATUSTEXT")


def test_a_masked_imu_lets_the_next_one_take_its_place_after_a_reboot(bench: Any) -> None:
    b = bench("ardupilot", boot_s=0.1, accel_noise=0.0, thermal=False)
    b.set("INS_ENABLE_MASK", 6.0)
    b.command(511, 105, 20000)
    b.run(0.6)
    first = b.vehicle.world.truth.accels[0]
    assert b.take("HIGHRES_IMU")[-1].xacc == pytest.approx(
        (first.matrix @ [0, 0, -9.80665] + first.offset)[0], abs=1e-5
    )
    b.command(REBOOT, 1)
    b.run(0.2)
    b.command(511, 105, 20000)
    b.run(0.5)
    second = b.vehicle.world.truth.accels[1]
    seen = b.take("HIGHRES_IMU")[-1].xacc
    assert seen == pytest.approx((second.matrix @ [0, 0, -9.80665] + second.offset)[0], abs=1e-5)


def test_compass_priority_is_settled_at_boot_by_device_id(bench: Any) -> None:
    b = bench("ardupilot", boot_s=0.1, mag_noise=0.0)
    b.set("COMPASS_PRIO1_ID", 131874.0)
    b.set("COMPASS_PRIO2_ID", 97539.0)
    b.run(0.6)
    assert b.vehicle.sensors.compasses == [0, 1]
    b.command(REBOOT, 1)
    b.run(0.2)
    assert b.vehicle.sensors.compasses == [1, 0]


def test_a_motor_current_is_compensated_by_its_parameter(bench: Any) -> None:
    b = bench("ardupilot", mag_noise=0.0)
    b.run(0.2)
    now = np.array([b.vehicle.time])
    before = b.vehicle.sensors.compass(0, now)
    b.vehicle.world.current.go(b.vehicle.time, 20.0)
    b.run(0.3)
    disturbed = b.vehicle.sensors.compass(0, np.array([b.vehicle.time]))
    assert np.linalg.norm(disturbed - before) > 10
    b.set("COMPASS_MOTCT", 2.0)
    for axis, value in zip("XYZ", (before - disturbed)[0] / 20.0, strict=True):
        b.set(f"COMPASS_MOT_{axis}", float(value))
    b.run(0.1)
    assert b.vehicle.sensors.compass(0, np.array([b.vehicle.time])) == pytest.approx(before, abs=1e-3)


def test_accelerometers_are_uncorrected_while_they_are_calibrated(bench: Any) -> None:
    b = bench("ardupilot", accel_noise=0.0, thermal=False, truth={"accels": CLEAN})
    b.set("INS_ACCOFFS_X", 0.5)
    b.run(0.1)
    state = b.vehicle.world.state(np.array([b.vehicle.time]))
    assert b.vehicle.sensors.imu(0, state).accel[0, 0] == pytest.approx(-0.5)
    b.vehicle.sensors.accel_calibrating = True
    assert b.vehicle.sensors.imu(0, state).accel[0, 0] == 0.0


def place_in_six_poses(b: Any, poses: tuple[Any, ...]) -> list[float]:
    """Answer every question; the values of 42429 that the vehicle sent."""
    asked = []
    for number, pose in enumerate(poses, start=1):
        b.vehicle.world.motion.hold(b.vehicle.time, pose, transition_s=0.0)
        b.run(1.1)
        asked += [m.param1 for m in b.take("COMMAND_LONG")]
        b.command(42429, number)
        b.run(0.6)
        asked += [m.param1 for m in b.take("COMMAND_LONG")]
    return asked


SIX = ("level", "left", "right", "nose_down", "nose_up", "back")


def test_six_positions_are_asked_for_in_order_and_fitted(bench: Any) -> None:
    b = bench("ardupilot", thermal=False, accel_noise=0.002)
    for s in b.vehicle.world.truth.accels:
        s.matrix[:] = np.diag(np.diag(s.matrix))
    b.command(CALIBRATE, 0, 0, 0, 0, 1)
    b.run(0.6)
    assert results(b) == [0]
    assert b.vehicle.sensors.accel_calibrating
    asked = place_in_six_poses(b, SIX)
    assert [v for i, v in enumerate(asked) if i == 0 or asked[i - 1] != v] == [1, 2, 3, 4, 5, 6, 16777215]
    for k, digit in enumerate(("", "2", "3")):
        truth = b.vehicle.world.truth.accels[k]
        assert b.vehicle.table.vector(f"INS_ACC{digit}OFFS") == pytest.approx(truth.offset, abs=5e-3)
        assert b.vehicle.table.vector(f"INS_ACC{digit}SCAL") == pytest.approx(1 / np.diag(truth.matrix), abs=1e-3)
    assert not b.vehicle.sensors.accel_calibrating
    b.command(ARM, 1)
    assert results(b)[-1] == 4


def test_a_pose_shown_twice_fails_and_resets_in_memory_only(bench: Any) -> None:
    b = bench("ardupilot", thermal=False, boot_s=0.1)
    b.set("INS_ACCOFFS_X", 0.25)
    b.run(6.0)
    b.command(CALIBRATE, 0, 0, 0, 0, 1)
    b.run(0.6)
    b.heard[0].clear()
    asked = place_in_six_poses(b, ("level", "level"))
    assert asked[-1] == 16777216
    assert b.vehicle.table["INS_ACCOFFS_X"].value == 0.0
    b.vehicle.reboot(flush=False)
    b.run(0.3)
    assert b.vehicle.table["INS_ACCOFFS_X"].value == 0.25
