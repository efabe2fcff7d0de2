"""Where the joint fit begins: the gyroscope by what the accelerometer sees turn, and turns too fast for the samples."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mavcal.calib.imu.integrate import Moves
from mavcal.calib.imu.problem import ImuProblem
from mavcal.calib.imu.start import closure, rough_gyro, with_turn_noise
from mavcal.calib.recording import Channel, Sensor, Stage

G = 9.80665
MATRIX = np.array([[0.9, 0.05, 0.0], [-0.1, 1.2, 0.02], [0.03, 0.0, 1.05]])
REST = np.array([0.02, -0.05, 0.1])
NEUTRAL = np.concatenate([np.zeros(3), np.ones(3), np.zeros(3), np.eye(3).ravel(), np.zeros(3)])


@functools.cache
def path(axes, seconds=12.0, rate=200.0):
    """Times, rates and specific force of a body that turns about all axes."""
    t = (np.arange(int(seconds * rate)) + 0.5) / rate
    omega = np.column_stack([np.sin(0.9 * t), np.cos(1.3 * t), np.sin(2.1 * t + 1.0)]) * axes
    body, force = Rotation.identity(), np.empty((len(t), 3))
    for k, w in enumerate(omega):
        half = Rotation.from_rotvec(0.5 * w / rate)
        body = body * half
        force[k] = body.inv().apply([0.0, 0.0, -G])
        body = body * half
    return t, omega, force


def turning(*, noise=0.0, axes=(1.0, 1.0, 1.0), unit=1.0):
    """What an accelerometer and a gyroscope of `MATRIX` and `REST` read of it."""
    rng = np.random.default_rng(1)
    t, omega, force = path(axes)
    readings = unit * (omega @ np.linalg.inv(MATRIX).T + REST)
    accel = Channel(Sensor.ACCEL, 0, t, force + noise * rng.normal(size=force.shape), "m/s2", Stage.RAW, "made")
    return accel, Channel(Sensor.GYRO, 0, t, readings, "rad/s", Stage.RAW, "made")


def rough(accel, gyro, spans, **options):
    return rough_gyro(accel, gyro, np.array(spans), options.pop("rest", REST), np.zeros(3), **options)


def test_the_accelerometer_tells_the_matrix_of_the_gyroscope():
    assert rough(*turning(), [(0.0, 6.0), (6.0, 12.0)]) == pytest.approx(MATRIX, abs=0.01)


def test_noise_of_a_hand_hardly_matters():
    assert rough(*turning(noise=0.3), [(0.0, 12.0)]) == pytest.approx(MATRIX, abs=0.12)


@pytest.mark.parametrize("unit", [1e-3, 900.0])
def test_a_gyroscope_in_counts_has_the_matrix_of_a_count(unit):
    found = rough(*turning(unit=unit), [(0.0, 12.0)], rest=REST * unit)
    assert found * unit == pytest.approx(MATRIX, abs=0.01)


def test_a_shift_of_the_accelerometer_is_taken_out():
    accel, gyro = turning()
    shift = np.array([3.0, -2.0, 1.0])
    moved = dataclasses.replace(accel, values=accel.values + shift)
    found = rough_gyro(moved, gyro, np.array([(0.0, 12.0)]), REST, shift)
    assert found == pytest.approx(MATRIX, abs=0.01)


def test_turns_about_one_axis_do_not_tell_the_others():
    assert rough(*turning(axes=(1.0, 0.0, 0.0)), [(0.0, 12.0)]) is None


@pytest.mark.parametrize(("seconds", "told"), [(1.5, False), (3.5, True)])
def test_sixty_equations_are_needed(seconds, told):
    """Three a block of a tenth of a second."""
    assert (rough(*turning(), [(0.0, seconds)]) is not None) is told


def test_no_movement_tells_nothing():
    assert rough(*turning(), np.zeros((0, 2))) is None


def test_a_hole_in_the_samples_is_left_out_of_the_equations():
    accel, gyro = turning()
    keep = (gyro.t < 5.0) | (gyro.t > 7.0)
    assert rough(accel, gyro.take(keep), [(0.0, 12.0)]) == pytest.approx(MATRIX, abs=0.01)


def two_poses(rates, t, after):
    """Gravity from below into `after`, while the gyroscope reads `rates`."""
    moves = Moves.of(t, rates, np.array([[0.0, 1.0]]), np.zeros(3))
    return ImuProblem(
        means=np.array([[0.0, 0.0, -1.0], after]),
        covariances=np.tile(1e-6 * np.eye(3), (2, 1, 1)),
        moves=moves,
        before=np.array([0]),
        wander=np.zeros(2),
        density=np.full(3, 1e-8),
        turn_covariances=np.zeros((1, 3, 3)),
        rest=np.zeros(3),
        rest_covariance=1e-8 * np.eye(3),
    )


@pytest.mark.parametrize("missed_deg", [0.0, 5.0, 90.0])
def test_the_closure_is_the_angle_by_which_a_movement_misses(missed_deg):
    t = (np.arange(100) + 0.5) / 100.0
    turn = np.radians(40.0)
    angle = turn + np.radians(missed_deg)
    # a turn about x by the angle leaves gravity at -angle in the body
    problem = two_poses(np.tile([turn, 0.0, 0.0], (100, 1)), t, [0.0, -np.sin(angle), -np.cos(angle)])
    assert np.degrees(closure(problem, NEUTRAL)) == pytest.approx(missed_deg, abs=1e-5)


def test_a_wrong_scale_misses_by_its_share_of_the_turn():
    t = (np.arange(100) + 0.5) / 100.0
    problem = two_poses(np.tile([1.0, 0.0, 0.0], (100, 1)), t, [0.0, -np.sin(1.0), -np.cos(1.0)])
    wrong = NEUTRAL.copy()
    wrong[9] = 1.1
    assert closure(problem, wrong) == pytest.approx(0.1, rel=1e-6)


def test_a_slow_turn_has_the_noise_of_its_samples():
    t = (np.arange(100) + 0.5) / 100.0
    problem = two_poses(np.tile([0.5, 0.0, 0.0], (100, 1)), t, [0.0, 0.0, -1.0])
    noisy = with_turn_noise(problem, NEUTRAL)
    # white noise of that density over one second; across the axis the turn mixes y and z, which are alike
    assert noisy.turn_covariances[0] == pytest.approx(1e-8 * np.eye(3), abs=1e-11)


def test_a_turn_that_every_second_sample_shows_otherwise_is_uncertain_by_a_third_of_it():
    t = (np.arange(100) + 0.5) / 100.0
    rates = np.zeros((100, 3))
    rates[:, 1] = np.where(np.arange(100) % 2, 0.0, 2.0)  # every second sample sees twice the turn
    problem = two_poses(rates, t, [0.0, 0.0, -1.0])
    noisy = with_turn_noise(problem, NEUTRAL)
    apart = 2.0 - 1.0
    assert noisy.turn_covariances[0] == pytest.approx((np.sin(apart) / 3.0) ** 2 * np.eye(3), rel=1e-3, abs=1e-6)
