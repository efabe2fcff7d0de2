"""The estimator that remembers, as captured from ArduCopter 4.7-dev: `accel`, then `level` without a restart."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

CLEAN = {"offset": [0, 0, 0], "matrix": np.eye(3).tolist(), "polynomial": np.zeros((3, 3)).tolist()}
QUIET = {"accel_noise": 0.0, "gyro_noise": 0.0, "mag_noise": 0.0, "thermal": False}
ATTITUDE = 30
OFFSET = (0.41, -0.38, 0.15)


@pytest.fixture
def vehicle(bench: Any) -> Any:
    truth = {"accels": {**CLEAN, "offset": list(OFFSET)}, "gyros": CLEAN}
    b = bench("ardupilot", boot_s=0.1, truth=truth, **QUIET)
    b.command(511, ATTITUDE, 100000)
    return b


def tilt(b: Any) -> tuple[float, float]:
    """Roll and pitch in the newest ATTITUDE, deg."""
    b.run(0.3)
    message = b.take("ATTITUDE")[-1]
    return math.degrees(message.roll), math.degrees(message.pitch)


def hold(b: Any, pose: str, seconds: float) -> None:
    b.vehicle.world.motion.hold(b.vehicle.time, pose, transition_s=0.0)
    b.run(seconds)


def calibrate(b: Any) -> None:
    for axis, value in zip("XYZ", OFFSET, strict=True):
        b.set(f"INS_ACCOFFS_{axis}", value)


@pytest.mark.long
def test_the_attitude_remembers_the_offsets_that_it_learned_upright(vehicle: Any) -> None:
    for pose in ("nose_up", "left", "level"):
        hold(vehicle, pose, 40.0)
    assert tilt(vehicle) == pytest.approx((0.0, 0.0), abs=0.2)  # the biases hide the error
    calibrate(vehicle)
    wrong = tilt(vehicle)
    assert max(map(abs, wrong)) > 2.0  # now they are the error
    vehicle.run(60.0)
    assert tilt(vehicle) == pytest.approx(wrong, abs=0.05)  # rest alone does not make it forget
    vehicle.command(246, 1)
    vehicle.run(1.0)
    vehicle.command(511, ATTITUDE, 100000)
    assert tilt(vehicle) == pytest.approx((0.0, 0.0), abs=0.05)


def test_an_axis_that_stands_upright_again_is_learned_again(vehicle: Any) -> None:
    for pose in ("nose_up", "left", "level"):
        hold(vehicle, pose, 40.0)
    calibrate(vehicle)
    roll, pitch = tilt(vehicle)
    hold(vehicle, "left", 8.0)
    hold(vehicle, "level", 0.5)
    again = tilt(vehicle)
    assert abs(again[0]) == pytest.approx(abs(roll) * math.exp(-1.0), abs=0.2)
    assert again[1] == pytest.approx(pitch, abs=0.1)


def test_a_vehicle_that_only_stood_level_learned_nothing_of_its_tilt(vehicle: Any) -> None:
    vehicle.run(60.0)
    assert max(map(abs, tilt(vehicle))) == pytest.approx(math.degrees(0.41 / 9.80665), abs=0.15)
    calibrate(vehicle)
    assert tilt(vehicle) == pytest.approx((0.0, 0.0), abs=0.05)
