"""By how much a vehicle's estimator was off, where the smoothed trajectory knows better."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mavcal.calib.airframe.flown import EstimatorError
from mavcal.calib.gap.reference.estimator import estimator_error
from mavcal.calib.recording import Recording, Sensor
from tests.unit.airframe.made import flight as flown
from tests.unit.airframe.made import hover

from .test_re_estimated import channel, flight, path


def estimated(off: float, turned_deg: float, stage_of: Recording | None = None) -> Recording:
    """The flight of `flight` with an estimator whose velocity north and heading are off by so much, now and then."""
    recording = stage_of or flight()
    t = np.arange(0.0, 59.0, 0.08)
    turn, velocity = path(t)
    velocity[:, 0] += off * np.sin(0.7 * t)
    wrong = Rotation.from_rotvec(np.column_stack([0.0 * t, 0.0 * t, np.radians(turned_deg) * np.cos(0.1 * t)])) * turn
    q = wrong.as_quat()[:, [3, 0, 1, 2]]
    made = (channel(Sensor.VELOCITY, t, velocity), channel(Sensor.ATTITUDE, t, q))
    return dataclasses.replace(recording, dynamics=(*recording.dynamics, *made))


def test_what_an_estimator_is_off_is_found_and_taken_off() -> None:
    error = estimator_error(estimated(0.4, 6.0))
    assert error is not None
    inside = (error.t > 2.0) & (error.t < 57.0)
    t = error.t[inside]
    np.testing.assert_allclose(error.velocity[inside, 0], 0.4 * np.sin(0.7 * t), atol=0.06)
    assert np.abs(error.velocity[inside, 1:]).max() < 0.06
    np.testing.assert_allclose(np.degrees(error.turn[inside, 2]), 6.0 * np.cos(0.1 * t), atol=1.0)
    assert np.degrees(np.abs(error.turn[inside, :2])).max() < 1.0


def test_filtered_streams_serve_where_nothing_faster_was_logged() -> None:
    """PX4's usual logs have slow raw sensors, and the filtered ones at the rate of its loop."""
    fast = flight()
    inertial = [c for c in fast.channels if c.sensor in (Sensor.ACCEL, Sensor.GYRO)]
    slow = [dataclasses.replace(c, t=c.t[::100], values=c.values[::100]) for c in inertial]
    rest = [c for c in fast.channels if c not in inertial]
    logged = dataclasses.replace(fast.with_channels((*slow, *rest)), dynamics=tuple(inertial))
    error = estimator_error(estimated(0.4, 6.0, logged))
    assert error is not None
    assert np.sqrt(np.mean(error.velocity[:, 0] ** 2)) == pytest.approx(0.4 / np.sqrt(2.0), rel=0.15)


@pytest.mark.parametrize("off", [0.0, 0.05])
def test_an_estimator_that_follows_the_gps_is_believed(off: float) -> None:
    assert estimator_error(estimated(off, 3.0)) is None


def test_without_a_gps_or_an_inertial_unit_nothing_better_is_known() -> None:
    whole = estimated(0.4, 6.0)
    for gone in ({Sensor.VELOCITY}, {Sensor.ACCEL}, {Sensor.GYRO}):
        assert estimator_error(whole.with_channels(c for c in whole.channels if c.sensor not in gone)) is None


def test_a_flight_without_the_error_has_the_true_velocity_and_attitude() -> None:
    one = flown(hover(3.0))
    off, turn = np.array([0.3, -0.2, 0.1]), np.array([0.02, 0.0, 0.1])
    wrong = dataclasses.replace(
        one,
        velocity=one.velocity + off,
        q=np.tile(Rotation.from_rotvec(turn).as_quat()[[3, 0, 1, 2]], (len(one.t), 1)),
    )
    error = EstimatorError(np.array([0.0, 3.0]), np.tile(off, (2, 1)), np.tile(turn, (2, 1)))
    right = error.taken_off(wrong)
    np.testing.assert_allclose(right.velocity, one.velocity, atol=1e-12)
    np.testing.assert_allclose(np.abs(right.q), one.q, atol=1e-12)
