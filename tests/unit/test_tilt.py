"""A picture's attitude follows gravity and rates."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from mavcal.calib import STANDARD_GRAVITY
from mavcal.calib.tilt import TiltFilter

ANGLES = st.tuples(st.floats(-180.0, 180.0), st.floats(-89.0, 89.0))


def force_of(body: Rotation) -> np.ndarray:
    return body.inv().apply([0.0, 0.0, -STANDARD_GRAVITY])


def down_of(quaternion: tuple[float, float, float, float]) -> np.ndarray:
    w, x, y, z = quaternion
    return Rotation.from_quat([x, y, z, w]).inv().apply([0.0, 0.0, 1.0])


@given(ANGLES)
def test_a_first_look_shows_the_vertical(angles):
    body = Rotation.from_euler("xy", angles, degrees=True)
    tilt = TiltFilter()
    tilt.feed(0.0, force_of(body), np.zeros(3))
    assert tilt.attitude is not None
    np.testing.assert_allclose(down_of(tilt.attitude), body.inv().apply([0.0, 0.0, 1.0]), atol=1e-9)


def test_rates_are_followed_at_once_and_gravity_corrects_what_they_miss():
    tilt = TiltFilter()
    tilt.feed(0.0, force_of(Rotation.identity()), np.zeros(3))
    half = Rotation.from_euler("x", 45.0, degrees=True)
    tilt.feed(0.1, np.zeros(3), np.array([np.pi / 4 / 0.1, 0.0, 0.0]))  # falling: gravity says nothing
    assert tilt.attitude is not None
    np.testing.assert_allclose(down_of(tilt.attitude), half.inv().apply([0.0, 0.0, 1.0]), atol=1e-9)
    turned = Rotation.from_euler("y", 30.0, degrees=True)
    for i in range(60):
        tilt.feed(0.2 + 0.1 * i, force_of(turned), np.zeros(3))
    np.testing.assert_allclose(down_of(tilt.attitude), turned.inv().apply([0.0, 0.0, 1.0]), atol=1e-3)


def test_a_pause_begins_again_from_gravity():
    tilt = TiltFilter()
    tilt.feed(0.0, force_of(Rotation.identity()), np.zeros(3))
    tilt.feed(10.0, force_of(Rotation.from_euler("x", 90.0, degrees=True)), np.full(3, 9.0))
    assert tilt.attitude is not None
    np.testing.assert_allclose(down_of(tilt.attitude), [0.0, 1.0, 0.0], atol=1e-9)


def test_nothing_is_shown_before_a_rest():
    tilt = TiltFilter()
    tilt.feed(0.0, np.array([0.0, 0.0, -30.0]), np.zeros(3))
    assert tilt.attitude is None
