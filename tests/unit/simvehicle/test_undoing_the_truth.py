"""The parameters that undo a vehicle's truth make its streams ideal: the signs and frames of every formula at once."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
import pytest

from mavcal.service.simvehicle.rotation import body_from_ned

QUIET = {"accel_noise": 0.0, "gyro_noise": 0.0, "mag_noise": 0.0}
POSES = ([0, 0, 0], [-90, 0, 10], [30, 40, 200], [180, 0, 0], [10, -90, 0])


def diagonal_truth(b: Any) -> None:
    """Leave out what no firmware can hold: cross terms of the accelerometers, and the gyroscopes' matrices."""
    world = b.vehicle.world
    for sensors in (world.truth.accels, world.truth.gyros):
        for s in sensors:
            diagonal = np.diag(s.matrix).copy() if sensors is world.truth.accels else np.ones(3)
            s.matrix[:] = np.diag(diagonal)


def write(b: Any, values: dict[str, float]) -> None:
    for name, value in values.items():
        b.set(name, value)
    b.run(0.5)


def xyz(base: str, vector: np.ndarray) -> dict[str, float]:
    return {f"{base}_{axis}": float(v) for axis, v in zip("XYZ", vector, strict=True)}


def ardupilot_calibration(b: Any, k: int) -> dict[str, float]:
    digit = "" if k == 0 else str(k + 1)
    accel, gyro = b.vehicle.world.truth.accels[k], b.vehicle.world.truth.gyros[k]
    values = xyz(f"INS_ACC{digit}OFFS", accel.offset) | xyz(f"INS_ACC{digit}SCAL", 1 / np.diag(accel.matrix))
    values |= xyz(f"INS_GYR{digit}OFFS", gyro.offset)
    for sensor, truth in (("ACC", accel), ("GYR", gyro)):
        values[f"INS_{sensor}{k + 1}_CALTEMP"] = 35.0
        for order in (1, 2, 3):
            values |= xyz(f"INS_TCAL{k + 1}_{sensor}{order}", truth.polynomial[:, order - 1] * 1e6)
    return values


def test_ardupilot_imus_become_ideal_at_any_temperature(bench: Any) -> None:
    b = bench("ardupilot", **QUIET, temperature=52.0, temperature_period_s=0.0)
    diagonal_truth(b)
    for k in range(3):
        write(b, ardupilot_calibration(b, k))
        b.set(f"INS_TCAL{k + 1}_ENABLE", 1.0)
    b.run(0.5)
    for pose in POSES:
        b.vehicle.world.motion.hold(b.vehicle.time, pose, transition_s=0.0)
        state = b.vehicle.world.state(np.array([b.vehicle.time]))
        for k in range(3):
            reading = b.vehicle.sensors.imu(k, state)
            assert reading.accel == pytest.approx(state.force, abs=2e-5), (k, pose)
            assert reading.gyro == pytest.approx(state.rate, abs=2e-6), (k, pose)


def test_ardupilot_compasses_become_ideal_in_the_body_frame(bench: Any) -> None:
    b = bench("ardupilot", **QUIET)
    for k, suffix in enumerate(("", "2")):
        truth = b.vehicle.world.truth.mags[k]
        rotation = b.vehicle.world.mag_from_body[k].T
        matrix = rotation @ np.linalg.inv(truth.matrix) @ rotation.T
        write(b, xyz(f"COMPASS_OFS{suffix}", -rotation @ truth.offset * 10))
        write(b, xyz(f"COMPASS_DIA{suffix}", np.diag(matrix)))
        write(b, xyz(f"COMPASS_ODI{suffix}", np.array([matrix[0, 1], matrix[0, 2], matrix[1, 2]])))
        write(b, xyz(f"COMPASS_MOT{suffix}", -matrix @ rotation @ truth.motor * 10))
    b.set("COMPASS_MOTCT", 2.0)
    b.vehicle.world.current.go(b.vehicle.time, 15.0)
    for pose in POSES:
        b.vehicle.world.motion.hold(b.vehicle.time, pose, transition_s=0.0)
        b.run(0.31)
        now = np.array([b.vehicle.time])
        q, _ = b.vehicle.world.motion.evaluate(now)
        field = body_from_ned(q, b.vehicle.world.field) * 10
        for k in range(2):
            assert b.vehicle.sensors.compass(k, now) == pytest.approx(field, abs=1e-3), (k, pose)


def test_px4_imus_and_magnetometers_become_ideal(bench: Any) -> None:
    b = bench("px4", **QUIET, thermal=False)
    b.run(0.1)
    diagonal_truth(b)
    for k in range(3):
        accel, gyro = b.vehicle.world.truth.accels[k], b.vehicle.world.truth.gyros[k]
        write(b, {f"CAL_ACC{k}_{a}OFF": float(v) for a, v in zip("XYZ", accel.offset, strict=True)})
        write(b, {f"CAL_ACC{k}_{a}SCALE": float(1 / v) for a, v in zip("XYZ", np.diag(accel.matrix), strict=True)})
        write(b, {f"CAL_GYRO{k}_{a}OFF": float(v) for a, v in zip("XYZ", gyro.offset, strict=True)})
    for k in range(2):
        truth = b.vehicle.world.truth.mags[k]
        correction = np.linalg.inv(truth.matrix)
        off = (correction[0, 1], correction[0, 2], correction[1, 2])
        write(b, {f"CAL_MAG{k}_{a}OFF": float(v) for a, v in zip("XYZ", truth.offset / 100, strict=True)})
        write(b, {f"CAL_MAG{k}_{a}SCALE": float(v) for a, v in zip("XYZ", np.diag(correction), strict=True)})
        write(b, {f"CAL_MAG{k}_{a}ODIAG": float(v) for a, v in zip("XYZ", off, strict=True)})
    # What is smaller than a threshold of the last component written stays behind: restart, as the firmware wants.
    b.run(3.0)
    b.vehicle.reboot(flush=True, away_s=0.1)
    b.run(3.0)
    for pose in POSES:
        b.vehicle.world.motion.hold(b.vehicle.time, pose, transition_s=0.0)
        b.run(0.05)
        now = np.array([b.vehicle.time])
        state = b.vehicle.world.state(now)
        for k in range(3):
            reading = b.vehicle.sensors.imu(k, state)
            assert reading.accel == pytest.approx(state.force, abs=2e-5), (k, pose)
            assert reading.gyro == pytest.approx(state.rate, abs=2e-6), (k, pose)
        field = body_from_ned(state.q, b.vehicle.world.field) / 100
        for k in range(2):
            assert b.vehicle.sensors.mag(k, now, armed=False) == pytest.approx(field, abs=1e-5), (k, pose)


def test_a_board_that_is_mounted_turned_is_turned_back(bench: Any) -> None:
    for autopilot in ("ardupilot", "px4"):
        clean = {"offset": [0, 0, 0], "matrix": np.eye(3).tolist(), "polynomial": np.zeros((3, 3)).tolist()}
        b = bench(autopilot, board_orientation=2, truth={"accels": clean, "gyros": clean}, **QUIET)
        if autopilot == "px4":
            b.send_set("SENS_BOARD_ROT", struct.pack("<i", 2), 6)
            b.run(3.0)
            b.vehicle.reboot(away_s=0.1)
            b.run(1.0)
        b.vehicle.world.motion.hold(b.vehicle.time, [25, 10, 0], transition_s=0.0)
        state = b.vehicle.world.state(np.array([b.vehicle.time]))
        assert b.vehicle.sensors.imu(0, state).accel == pytest.approx(state.force, abs=1e-5)
