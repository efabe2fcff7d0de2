from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from mavcal.calib.geometry import frame_along, quaternion_product, sphere_of


@given(centre=st.tuples(*[st.floats(-1e4, 1e4)] * 3), radius=st.floats(0.1, 1e4), seed=st.integers(0, 100))
def test_the_sphere_of_exact_points(centre, radius, seed):
    d = np.random.default_rng(seed).normal(size=(20, 3))
    points = centre + radius * d / np.linalg.norm(d, axis=1)[:, None]
    found, size = sphere_of(points)
    assert found == pytest.approx(centre, abs=1e-6 * radius + 1e-8)
    assert size == pytest.approx(radius, rel=1e-6)


def test_points_that_determine_no_sphere_still_give_numbers():
    for points in (np.ones((5, 3)), np.column_stack([np.arange(5.0), np.zeros(5), np.zeros(5)])):
        centre, radius = sphere_of(points)
        assert np.isfinite(centre).all()
        assert radius > 0.0


@given(direction=st.tuples(*[st.floats(-10.0, 10.0)] * 3))
def test_a_frame_is_orthonormal_and_starts_along_its_direction(direction):
    d = np.array(direction)
    frame = frame_along(d)
    assert frame.T @ frame == pytest.approx(np.eye(3), abs=1e-9)
    if np.linalg.norm(d) > 1e-100:
        assert abs(frame[:, 0] @ d) == pytest.approx(np.linalg.norm(d), rel=1e-9)


def test_products_of_quaternions_are_those_of_rotations():
    one, other = (Rotation.random(20, random_state=seed) for seed in (1, 2))
    found = Rotation.from_quat(quaternion_product(one.as_quat().T, other.as_quat().T).T)
    assert (found.inv() * (one * other)).magnitude() == pytest.approx(np.zeros(20), abs=1e-9)
