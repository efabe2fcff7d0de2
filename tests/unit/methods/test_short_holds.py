"""Poses that were held too shortly: how long they were, what is needed, and the option that takes them."""

from __future__ import annotations

import re

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.fit import FitStatus
from mavcal.calib.methods import METHODS
from mavcal.calib.recording import Channel, Recording, Sensor, Stage

RATE_HZ = 100.0
SIX = [(0, 0, 0), (0, 0, 180), (0, 0, 90), (0, 0, -90), (0, 90, 0), (0, -90, 0)]
OBLIQUE = [(0, 40, 50), (0, -35, 130), (0, 30, -60), (0, -40, -120), (0, 50, 20), (0, -20, 70)]


def held(seconds, *, seed=1, factor=1.0):
    """Twelve poses of so many seconds, with turns of a second between them; `factor` is what the gyroscope reads."""
    rng = np.random.default_rng(seed)
    angles = np.radians(np.array([(37.0 * k, p, r) for k, (_, p, r) in enumerate([*SIX, *OBLIQUE])]))
    poses = Rotation.from_euler("ZYX", angles)
    times = np.concatenate([[k * (seconds + 1.0), k * (seconds + 1.0) + seconds] for k in range(len(poses))])
    way = Slerp(times, Rotation.concatenate([poses[k // 2] for k in range(2 * len(poses))]))
    t = np.arange(0.0, times[-1], 1.0 / RATE_HZ)
    attitude = way(t)
    rate = RATE_HZ * (attitude[:-1].inv() * attitude[1:]).as_rotvec()
    rate = np.vstack([rate, rate[-1]])
    accel = attitude.inv().apply([0.0, 0.0, -9.80665]) + 0.02 * rng.normal(size=(len(t), 3))
    gyro = factor * rate + np.radians([0.3, -0.2, 0.1]) + 0.001 * rng.normal(size=(len(t), 3))
    return Recording(
        (
            Channel(Sensor.ACCEL, 0, t, accel, "m/s2", Stage.RAW, "test"),
            Channel(Sensor.GYRO, 0, t, gyro, "rad/s", Stage.RAW, "test"),
        )
    )


@pytest.mark.parametrize("method", ["accel-six-face", "accel-multi"])
def test_short_poses_are_said_and_taken_where_asked_for(method):
    found = METHODS[method].run(held(1.0))
    assert found[0].status == FitStatus.REFUSED
    assert "held for 1 s each, and 2 s are needed" in found[0].message
    assert found[0].message.endswith("--min-still 1")
    assert METHODS[method].run(held(1.0), {"min_still": 1.0})[0].status != FitStatus.REFUSED
    assert METHODS[method].run(held(3.0))[0].status != FitStatus.REFUSED


def test_movements_between_poses_of_half_a_second():
    found = METHODS["imu-multi"].run(held(0.6))
    assert found[0].status == FitStatus.REFUSED
    assert "and 2 s are needed" in found[0].message
    assert METHODS["imu-multi"].run(held(0.6), {"min_still": 0.5})[0].status != FitStatus.REFUSED


def test_the_time_of_a_pose_is_positive():
    with pytest.raises(InvalidInputError, match="positive number of seconds"):
        METHODS["accel-multi"].run(held(1.0), {"min_still": 0.0})


@pytest.mark.parametrize("factor", [0.25, 0.5, 2.0, 4.0, np.degrees(1.0)])
def test_a_gyroscope_of_another_unit_or_range_is_named_by_its_factor(factor):
    accel, gyro = METHODS["imu-multi"].run(held(3.0, factor=factor))
    assert gyro.status == FitStatus.REFUSED
    said = re.search(r"the gyroscope reads ([0-9.]+) times the rate", gyro.message)
    assert said is not None
    assert float(said.group(1)) == pytest.approx(factor, rel=0.04)
    assert accel.status == FitStatus.OK  # it knows gravity without the gyroscope


@pytest.mark.parametrize("factor", [0.93, 1.0, 1.08])
def test_a_gyroscope_whose_scale_is_off_is_fitted(factor):
    _, gyro = METHODS["imu-multi"].run(held(3.0, factor=factor))
    assert gyro.status != FitStatus.REFUSED
    assert np.diag(gyro.model.matrix) == pytest.approx(1.0 / factor, rel=0.01)


def test_axes_in_another_order_are_no_sway():
    recording = held(3.0)
    gyro = recording.channel(Sensor.GYRO, 0)
    swapped = Channel(Sensor.GYRO, 0, gyro.t, gyro.values[:, [1, 2, 0]], "rad/s", Stage.RAW, "test")
    for fit in METHODS["imu-multi"].run(Recording((recording.channel(Sensor.ACCEL, 0), swapped))):
        assert fit.status == FitStatus.REFUSED or not any("sway" in text for text in fit.warnings)
