from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mavcal.calib import posture
from mavcal.calib.procedures import poses
from mavcal.calib.procedures.protocol import Pose


@pytest.mark.parametrize(
    ("roll", "pitch", "pose"),
    [
        (0, 0, Pose.LEVEL),
        (-90, 0, Pose.LEFT),
        (90, 0, Pose.RIGHT),
        (0, -90, Pose.NOSE_DOWN),
        (0, 90, Pose.NOSE_UP),
        (180, 0, Pose.BACK),
        (12, -9, Pose.LEVEL),
        (35, 20, Pose.OBLIQUE),
        (20, -60, Pose.OBLIQUE),
    ],
)
def test_a_pose_is_recognised_from_the_specific_force(roll, pitch, pose):
    body_from_ned = Rotation.from_euler("ZYX", [70.0, pitch, roll], degrees=True).inv()
    force = body_from_ned.apply([0.0, 0.0, -9.80665])
    assert poses.recognise(poses.down(force)) is pose


def test_level_at_rest_points_the_belly_down():
    assert posture.tilted(poses.down(np.array([0.0, 0.0, -9.8])).tolist()) == "level"


def test_remaining_counts_faces_once_and_oblique_poses_only_where_they_differ():
    taken = [np.array(poses.DOWN[f]) for f in (Pose.LEVEL, Pose.LEFT, Pose.LEVEL)]
    tilted = np.array([1.0, 1.0, 0.0]) / np.sqrt(2)
    left = poses.remaining([*taken, tilted, tilted], 3)
    assert left == (Pose.RIGHT, Pose.NOSE_DOWN, Pose.NOSE_UP, Pose.BACK, Pose.OBLIQUE, Pose.OBLIQUE)


def test_poses_taken_where_suggested_tell_all_cross_terms():
    taken = [np.array(poses.DOWN[f]) for f in poses.FACES]
    for _ in range(3):
        taken.append(np.array(poses.suggest(taken)))
        assert poses.recognise(taken[-1]) is Pose.OBLIQUE
    cross = np.array([[x * y, x * z, y * z] for x, y, z in taken])
    assert np.linalg.cond(cross.T @ cross) < 20.0


def test_the_opposite_of_a_taken_pose_is_not_suggested():
    tilted = np.array([1.0, 1.0, 1.0]) / np.sqrt(3)
    assert abs(np.dot(poses.suggest([tilted]), tilted)) < 0.5


def test_an_order_is_only_spoken_of_while_there_is_a_choice():
    both, alone = poses.any_of([Pose.NOSE_UP, Pose.BACK]), poses.any_of([Pose.BACK])
    assert "nose up" in both
    assert "any order" in both
    assert alone in both
    assert "order" not in alone


def test_every_tilt_is_drawn_before_it_is_asked_for_and_kept_as_it_was_taken():
    faces = [np.array(poses.DOWN[f]) for f in poses.FACES]
    asked = poses.tilts([], 4)
    assert [tilt.taken for tilt in asked] == [False] * 4
    assert poses.tilts(faces, 4) == asked, "faces, however held, change no picture"
    after = poses.tilts([*faces, np.array(asked[0].direction)], 4)
    assert [tilt.taken for tilt in after] == [True, False, False, False]
    np.testing.assert_allclose([tilt.direction for tilt in after], [tilt.direction for tilt in asked], atol=1e-12)
