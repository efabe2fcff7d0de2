"""The domain contract of ``calib`` in literal numbers."""

from __future__ import annotations

import numpy as np
import pytest

from mavcal import calib
from mavcal.calib.accel.faces import down_of
from mavcal.calib.fit import parameter_names
from mavcal.calib.procedures.protocol import Pose
from mavcal.calib.recording import Channel, Sensor, Stage
from mavcal.calib.triad import ThermalPolynomial, TriadModel

G = 9.80665


def rotation(axis: int, degrees: float) -> np.ndarray:
    """``R_nb`` of a body turned by `degrees` about a body axis, right-handed."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    i, j = (axis + 1) % 3, (axis + 2) % 3
    R = np.eye(3)
    R[i, i] = R[j, j] = c
    R[i, j], R[j, i] = -s, s
    return R


def specific_force(R_nb: np.ndarray) -> np.ndarray:
    """What an accelerometer at rest reads: minus gravity (0, 0, g in NED), in the body."""
    return R_nb.T @ np.array([0.0, 0.0, -G])


def test_gravity_of_the_firmwares():
    assert calib.STANDARD_GRAVITY == 9.80665


def test_level_and_at_rest_reads_minus_g_down():
    assert specific_force(np.eye(3)) == pytest.approx([0.0, 0.0, -9.80665])


@pytest.mark.parametrize(
    ("pose", "axis", "degrees", "reading"),
    [
        (Pose.LEVEL, 0, 0.0, (0.0, 0.0, -9.80665)),
        (Pose.BACK, 0, 180.0, (0.0, 0.0, 9.80665)),
        (Pose.RIGHT, 0, 90.0, (0.0, -9.80665, 0.0)),  # rolled right: the right side is down
        (Pose.LEFT, 0, -90.0, (0.0, 9.80665, 0.0)),
        (Pose.NOSE_UP, 1, 90.0, (9.80665, 0.0, 0.0)),
        (Pose.NOSE_DOWN, 1, -90.0, (-9.80665, 0.0, 0.0)),
    ],
)
def test_the_six_poses(pose, axis, degrees, reading):
    assert specific_force(rotation(axis, degrees)) == pytest.approx(reading, abs=1e-12)
    assert down_of(pose.value) == pytest.approx(np.array(reading) / -G, abs=1e-12)


def test_a_right_turn_is_a_positive_rate_about_down():
    north, east = np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])
    assert rotation(2, 90.0) @ north == pytest.approx(east)


def test_the_sensor_equation_offset_is_subtracted_then_the_matrix_multiplies():
    model = TriadModel(offset=[1.0, -2.0, 0.5], matrix=np.diag([2.0, 0.5, 1.0]))
    assert model.apply([2.0, 0.0, 0.5]) == pytest.approx([2.0, 1.0, 0.0])
    assert model.invert([2.0, 1.0, 0.0]) == pytest.approx([2.0, 0.0, 0.5])


def test_the_polynomial_is_zero_at_its_reference_and_held_beyond_its_range():
    p = ThermalPolynomial(35.0, 10.0, 60.0, np.array([[1e-3, 2e-6], [0.0, 0.0], [0.0, 0.0]]))
    assert p(35.0) == pytest.approx([0.0, 0.0, 0.0])
    assert p(45.0)[0] == pytest.approx(1e-2 + 2e-4)
    assert p(80.0)[0] == p(60.0)[0] == pytest.approx(25e-3 + 2e-6 * 625)


def test_the_order_of_every_covariance():
    names = parameter_names(3)
    assert names[:5] == ("offset_x", "offset_y", "offset_z", "matrix_xx", "matrix_xy")
    assert names[12:16] == ("poly1_x", "poly2_x", "poly3_x", "poly1_y")
    assert len(names) == 21


def test_instances_count_from_zero_and_spans_are_half_open():
    channel = Channel(Sensor.GYRO, 0, np.arange(3.0), np.zeros((3, 3)), "rad/s", Stage.RAW, "SCALED_IMU")
    assert channel.between(0.0, 2.0).t.tolist() == [0.0, 1.0]
