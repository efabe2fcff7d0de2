from __future__ import annotations

import numpy as np
import pytest

from mavcal.calib.gap.reference.align import AXIS_EXCHANGES, best_axis_exchange, correlation_in_best_frame, matched_to


def movement(seed=1):
    return np.random.default_rng(seed).standard_normal((400, 3)) * [1.0, 2.0, 0.5]


@pytest.mark.parametrize("turn", [np.diag([1.0, -1.0, 1.0]), np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]])])
def test_a_movement_is_likened_to_its_reference_in_frame_and_unit(turn):
    ideal = movement()
    measured = 57.3 * ideal @ turn.T
    assert best_axis_exchange(measured, ideal) == pytest.approx(turn)
    assert matched_to(measured, ideal) == pytest.approx(ideal)
    assert correlation_in_best_frame(measured, ideal) == pytest.approx(1.0)


def test_a_calibration_error_is_neither():
    ideal = movement()
    measured = 1.3 * ideal @ (np.eye(3) + 0.1 * np.ones((3, 3)))
    assert best_axis_exchange(measured, ideal) == pytest.approx(np.eye(3))
    assert matched_to(measured, ideal) == pytest.approx(measured)


def test_other_movements_are_alike_in_no_frame():
    assert len(AXIS_EXCHANGES) == 48
    assert correlation_in_best_frame(movement(1), movement(2)) < 0.3
