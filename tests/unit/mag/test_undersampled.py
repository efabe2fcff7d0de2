"""Rows with a time stamp may be poses; a movement that was read too slowly widens by what blur and lag really did."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mavcal.calib.fit import FitStatus
from mavcal.calib.logs.tables import NO_TIME
from mavcal.calib.mag.ellipsoid_result import TurningField
from mavcal.calib.methods import METHODS
from mavcal.calib.recording import Channel, Event, Recording, Sensor, Stage

SHAPE = 49.0 * np.array([[1.06, 0.045, -0.03], [0.045, 0.94, 0.035], [-0.03, 0.035, 1.0]])
OFFSET = np.array([12.0, -8.5, 21.0])
DIP = np.radians(66.0)
NORTH_DOWN = np.array([np.cos(DIP), 0.0, np.sin(DIP)])
PIECES = 41  # of the time over which a reading is averaged


def recording(t, values, *, timed=True):
    said = () if timed else (Event(0.0, NO_TIME, ""),)
    return Recording((Channel(Sensor.MAG, 0, t, values, "uT", Stage.RAW, "test"),), events=said)


def poses(rng, n, tilt_deg):
    limit = 180.0 if tilt_deg is None else tilt_deg
    pitch_roll = np.radians(rng.uniform(-limit, limit, (n, 2)))
    angles = np.column_stack([rng.uniform(-np.pi, np.pi, n), pitch_roll])
    field = Rotation.random(n, random_state=rng) if tilt_deg is None else Rotation.from_euler("ZYX", angles)
    return field.inv().apply(NORTH_DOWN) @ SHAPE + OFFSET + 0.3 * rng.normal(size=(n, 3))


def attitude(t):
    """About a radian a second: by 50 degrees from one second to the next."""
    return Rotation.from_rotvec(np.outer(t, [0.0, 0.0, 0.75])) * Rotation.from_rotvec(np.outer(t, [0.35, 0.62, 0.0]))


def tumbled(t, *, window=0.0, lags=(0.0, 0.0, 0.0)):
    """Readings of a turning sensor, each a mean over `window` s, each axis `lags` s late."""
    found = np.zeros((len(t), 3))
    for axis, lag in enumerate(lags):
        for part in np.linspace(-0.5, 0.5, PIECES) * window - lag:
            found[:, axis] += (attitude(t + part).inv().apply(NORTH_DOWN) @ SHAPE)[:, axis] / PIECES
    return found + OFFSET


@pytest.mark.parametrize("tilt_deg", [None, 45.0])
@pytest.mark.parametrize("step", [0.1, 1.0, 20.0])
def test_poses_with_a_time_stamp_are_as_good_as_poses_without(tilt_deg, step):
    values = poses(np.random.default_rng(3), 1000, tilt_deg)
    (timed,) = METHODS["mag-ellipsoid"].run(recording(step * np.arange(1000.0), values))
    (counted,) = METHODS["mag-ellipsoid"].run(recording(np.arange(1000.0), values, timed=False))
    assert timed.status == counted.status == FitStatus.OK
    assert timed.sd == pytest.approx(counted.sd, rel=1e-9)
    assert np.abs((timed.model.offset - OFFSET) / timed.sd[:3]).max() < 3.5


@pytest.mark.parametrize("order", [1.0, -1.0])
def test_poses_gone_through_in_order_are_poses(order):
    """Headings 40 degrees apart, tilt after tilt, written down every tenth of a second: no vehicle turns so fast."""
    rng = np.random.default_rng(4)
    heading = order * np.radians(40.0) * np.arange(360)
    angles = np.column_stack([heading, np.radians(12.0) * (np.arange(360) // 9 % 15 - 7.0), 0.3 * np.arange(360)])
    values = Rotation.from_euler("ZYX", angles).inv().apply(NORTH_DOWN) @ SHAPE + OFFSET
    values += 0.3 * rng.normal(size=values.shape)
    (timed,) = METHODS["mag-ellipsoid"].run(recording(0.1 * np.arange(360.0), values))
    (counted,) = METHODS["mag-ellipsoid"].run(recording(np.arange(360.0), values, timed=False))
    assert timed.sd == pytest.approx(counted.sd, rel=1e-9)


@pytest.mark.parametrize("count", [200, 2000])
def test_a_movement_that_was_read_slowly_keeps_close_to_its_bound(count):
    rng = np.random.default_rng(5)
    t = np.arange(float(count))
    values = tumbled(t) + 0.3 * rng.normal(size=(count, 3))
    (fit,) = METHODS["mag-ellipsoid"].run(recording(t, values))
    (counted,) = METHODS["mag-ellipsoid"].run(recording(t, values, timed=False))
    assert fit.quality["blur_share"] == 0.0
    assert (fit.sd <= 1.2 * counted.sd).all()


def test_a_steady_blur_hides_in_the_ellipsoid_and_is_in_its_uncertainty():
    rng = np.random.default_rng(6)
    t = np.arange(0.0, 4000.0)
    values = tumbled(t, window=0.1) + 0.05 * rng.normal(size=(len(t), 3))
    (fit,) = METHODS["mag-ellipsoid"].run(recording(t, values))
    assert np.abs((fit.model.offset - OFFSET) / fit.sd[:3]).max() < 3.0
    assert any("read more slowly than it turned" in text for text in fit.warnings)


def test_the_lag_of_axes_is_seen_and_widens_the_intervals():
    rng = np.random.default_rng(6)
    t = np.arange(0.0, 2000.0)
    values = tumbled(t, lags=(0.0, 0.02, 0.04)) + 0.1 * rng.normal(size=(len(t), 3))
    (fit,) = METHODS["mag-ellipsoid"].run(recording(t, values))
    assert fit.quality["blur_share"] > 0.3
    assert np.abs((fit.model.offset - OFFSET) / fit.sd[:3]).max() < 3.0


def test_noise_is_rarely_taken_for_blur():
    rng = np.random.default_rng(7)
    t = np.arange(0.0, 300.0)
    field = attitude(t).inv().apply(NORTH_DOWN)
    turn = TurningField.of(t, field)
    assert sum(turn.seen_in(1.0 + 0.01 * rng.normal(size=300)) > 0.0 for _ in range(200)) <= 2  # one in a thousand


def test_times_that_do_not_go_on_tell_of_no_turn():
    field = attitude(np.arange(300.0)).inv().apply(NORTH_DOWN)
    assert TurningField.of(np.zeros(300), field) is None
    assert TurningField.of(np.arange(300.0), field) is not None
