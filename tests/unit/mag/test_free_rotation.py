from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mavcal.calib.mag.free_rotation import (
    Euler,
    angle_between,
    best_mirrors,
    best_rotations,
    euler_angles,
    mirror_words,
    turn,
)
from mavcal.calib.mag.orientation import RIGHT_ANGLES

STARTS = np.array([m.matrix for m in RIGHT_ANGLES])
SINE = 0.9


def seen(rng: np.random.Generator, matrix: Any, count: int = 200) -> tuple[Any, Any]:
    """Unit vectors down and along the field, in the body and as a sensor reads them that `matrix` takes to the body."""
    poses = Rotation.random(count, rng=rng)
    down = poses.inv().apply([0.0, 0.0, 1.0])
    return down, poses.inv().apply([math.sqrt(1.0 - SINE**2), 0.0, SINE]) @ matrix


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("sine", [SINE, None])
def test_any_rotation_is_found_from_the_right_angles(seed: int, sine: float | None) -> None:
    rng = np.random.default_rng(seed)
    truth = Rotation.random(rng=rng).as_matrix()
    found = best_rotations(*seen(rng, truth), sine, STARTS)
    assert angle_between(found[0], truth) < 1e-6
    assert all(angle_between(a, b) > math.radians(15.0) for i, a in enumerate(found) for b in found[:i])


def test_a_mirror_image_is_found_where_the_dip_is_known() -> None:
    rng = np.random.default_rng(20)
    truth = -Rotation.random(rng=rng).as_matrix()
    samples = seen(rng, truth)
    np.testing.assert_allclose(best_mirrors(*samples, SINE, STARTS)[0], truth, atol=1e-6)
    assert best_mirrors(*samples, None, STARTS) == []


@pytest.mark.parametrize("angles", [(0, 0, 29), (3, -8, 129), (-170, 60, -20), (90, 68.8, 293.3)])
def test_angles_come_with_the_standard_deviation_that_small_turns_mean(angles: Any) -> None:
    R = Rotation.from_euler("ZYX", angles[::-1], degrees=True).as_matrix()
    covariance = np.diag([1.0, 4.0, 2.0]) * 1e-6 + 5e-7
    euler = euler_angles(R, covariance)
    again = Rotation.from_euler("ZYX", euler.angles[::-1], degrees=True).as_matrix()
    assert angle_between(R, again) < 1e-7
    rng = np.random.default_rng(3)
    turned = [euler_angles(turn(v) @ R).angles for v in rng.multivariate_normal(np.zeros(3), covariance, 4000)]
    np.testing.assert_allclose(euler.sd, np.std(turned, axis=0), rtol=0.06)


@pytest.mark.parametrize("pitch", [90.0, -90.0])
def test_straight_up_or_down_roll_and_yaw_are_one_angle_without_a_deviation(pitch: float) -> None:
    R = Rotation.from_euler("ZYX", [40.0, pitch, 15.0], degrees=True).as_matrix()
    euler = euler_angles(R, 1e-6 * np.eye(3))
    assert (euler.roll, euler.sd) == (0.0, None)
    assert angle_between(R, Rotation.from_euler("ZYX", euler.angles[::-1], degrees=True).as_matrix()) < 1e-7


def test_turns_are_rotations_by_their_vectors() -> None:
    vectors = np.array([[0.0, 0.0, 0.0], [1e-9, 0.0, 0.0], [0.3, -0.2, 0.5], [0.0, 3.0, 0.0]])
    np.testing.assert_allclose(turn(vectors), Rotation.from_rotvec(vectors).as_matrix(), atol=1e-12)


def test_words() -> None:
    known = str(Euler(1.25, -2.0, 29.04, (0.1, 0.2, 0.32)))
    assert all(token in known for token in ("roll 1.2", "± 0.1", "pitch -2.0", "± 0.2", "yaw 29.0", "± 0.3", "deg"))
    bare = str(Euler(-0.04, 0.0, -29.3))
    assert all(token in bare for token in ("roll 0.0", "pitch 0.0", "yaw -29.3", "deg"))  # no minus nought
    assert "±" not in bare
    assert "y axis" in mirror_words(np.diag([1.0, -1.0, 1.0]))
    assert "y and z" in mirror_words(np.eye(3)[[0, 2, 1]])
    for neither in (-np.eye(3)[[1, 2, 0]], -turn(np.array([0.0, 0.0, 0.5]))):
        assert "mirrored" in mirror_words(neither)
