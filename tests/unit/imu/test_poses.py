from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mavcal.calib.imu.poses import ACCEL_LADDER, GYRO_LADDER, ScatterWindows, candidates, find_poses, measure, steady

G = 9.80665


def test_the_poses_are_found_between_the_movements(recorded):
    accel, gyro = recorded(np.random.default_rng(1), poses=10)
    spans = find_poses(accel, gyro, G)
    assert len(spans) == 10
    starts = 3.0 * np.arange(10)
    assert (spans[:, 0] >= starts - 1e-9).all()
    assert (spans[:, 1] <= starts + 2.02).all()
    assert np.diff(spans, axis=1).min() > 1.2


def test_the_ladder_gives_every_set_of_spans_once(recorded):
    watch = ScatterWindows.of(*recorded(np.random.default_rng(2), poses=6), G)
    found = [spans.tobytes() for spans in candidates(watch)]
    assert 1 <= len(found) <= len(ACCEL_LADDER) * len(GYRO_LADDER)


def test_without_noise_there_is_still_a_floor(recorded):
    accel, gyro = recorded(np.random.default_rng(3), poses=6, accel_sd=0.0, gyro_sd=0.0)
    assert len(find_poses(accel, gyro, G)) == 6


def test_a_pose_whose_halves_differ_is_none(recorded):
    accel, _ = recorded(np.random.default_rng(4), poses=4)
    values = accel.values.copy()
    values[100:200] += [0.5, 0.0, 0.0]
    sunk = dataclasses.replace(accel, values=values)
    spans = np.array([[0.0, 2.0], [3.2, 4.8]])
    assert steady(accel, spans, G).tolist() == [True, True]
    assert steady(sunk, spans, G).tolist() == [False, True]


def test_a_slow_tilt_is_not_still(recorded):
    accel, gyro = recorded(np.random.default_rng(5), poses=4, accel_sd=0.003)
    tilting = accel.values + np.linspace(0.0, 6.0, len(accel))[:, None] * [1.0, 0.0, 0.0]
    watch = ScatterWindows.of(dataclasses.replace(accel, values=tilting), gyro, G)
    assert not watch.still(2.0, 2.0).any()


def test_the_noise_is_pooled_and_sway_is_not_noise_along_gravity(recorded):
    accel, gyro = recorded(np.random.default_rng(6), poses=6, hold=4.0)
    spans = np.column_stack([5.0 * np.arange(6) + 0.2, 5.0 * np.arange(6) + 3.8])
    quiet = measure(accel, gyro, spans)
    assert quiet.noise_sd == pytest.approx(0.03, rel=0.05)
    assert np.sqrt(quiet.gyro_noise) == pytest.approx(np.full(3, 0.003), rel=0.15)
    assert (quiet.wander == 0.0).all()
    sway = np.radians(1.0) * np.sin(2.0 * np.pi * 0.7 * accel.t)
    across = np.cross(accel.values, np.broadcast_to([0.3, 0.8, -0.5], accel.values.shape))
    across /= np.linalg.norm(across, axis=1)[:, None]
    swaying = dataclasses.replace(accel, values=accel.values + G * sway[:, None] * across * (accel.t < 4.5)[:, None])
    poses = measure(swaying, gyro, spans)
    assert np.degrees(np.sqrt(poses.wander[0])) == pytest.approx(0.5, abs=0.25)
    assert (poses.wander[1:] == 0.0).all()
    along = quiet.means[0] / np.linalg.norm(quiet.means[0])
    assert along @ poses.covariances[0] @ along < 4.0 * along @ poses.covariances[1] @ along
    assert np.trace(poses.covariances[0]) > 10.0 * np.trace(poses.covariances[1])
