from __future__ import annotations

import math

import numpy as np
import pytest

from bench.accuracy import bounds, rows_align, rows_imu, scenes
from mavcal.calib.mag.distance import score_rows
from mavcal.calib.mag.shape import Ellipsoid


def test_the_bound_of_the_ellipsoid_is_that_with_every_direction_eliminated() -> None:
    """The full Fisher matrix with two unknown angles a sample, by finite differences, and its Schur complement."""
    rng = np.random.default_rng(1)
    u = scenes.everywhere(rng, 15)
    truth = np.concatenate([scenes.OFFSET, scenes.SHAPE[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]])

    def sample(p, direction, angles):
        across = bounds._tangent(direction)
        shape = np.array([[p[3], p[6], p[7]], [p[6], p[4], p[8]], [p[7], p[8], p[5]]])
        return shape @ (direction + across @ angles) + p[:3]

    total = np.zeros((9, 9))
    for direction in u:
        rows = np.empty((3, 11))
        for k in range(11):
            p, angles = np.array(truth), np.zeros(2)
            target = p if k < 9 else angles
            target[k if k < 9 else k - 9] += 1e-4
            ahead = sample(p, direction, angles)
            target[k if k < 9 else k - 9] -= 2e-4
            rows[:, k] = (ahead - sample(p, direction, angles)) / 2e-4
        F = rows.T @ rows / 9.0
        total += F[:9, :9] - F[:9, 9:] @ np.linalg.solve(F[9:, 9:], F[9:, :9])
    np.testing.assert_allclose(bounds.ellipsoid(u, scenes.SHAPE, 9.0), total, rtol=1e-6, atol=1e-9)


def test_the_bound_and_the_estimator_agree_on_the_scores() -> None:
    u = scenes.everywhere(np.random.default_rng(2), 500)
    rows = score_rows(u @ scenes.SHAPE + scenes.OFFSET, Ellipsoid(scenes.OFFSET, scenes.SHAPE))
    np.testing.assert_allclose(bounds.ellipsoid(u, scenes.SHAPE, 1.0), rows @ rows.T, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("place", [0.0, 0.2, 0.5])
def test_a_rounded_number_says_what_its_variance_says_where_noise_is_wide(place: float) -> None:
    assert 1.0 / bounds.interval_mean(place, 2.0, 1.0) == pytest.approx(4.0 + 1.0 / 12.0, rel=1e-3)


def test_a_rounded_number_says_less_where_noise_is_narrow() -> None:
    """At the middle of a bin and a tenth of it in noise nearly all numbers are the same."""
    assert bounds.interval_mean(0.0, 0.15, 1.0) < 0.1 / 0.15**2


def test_linear_and_polynomial_bounds_are_those_of_least_squares() -> None:
    rng = np.random.default_rng(3)
    x = rng.normal(size=(40, 3))
    F = bounds.linear_triad(x, 4.0)
    assert np.linalg.matrix_rank(F) == 12
    design = np.hstack([np.ones((40, 1)), x])
    np.testing.assert_allclose(F[np.ix_([1, 6, 7, 8], [1, 6, 7, 8])], design.T @ design / 4.0)
    V = np.vander(x[:, 0], 4, increasing=True)
    np.testing.assert_allclose(bounds.polynomial(x[:, 0], 3, 0.25), V.T @ V / 0.25)


def test_the_bound_of_the_alignment_is_what_the_fit_states() -> None:
    """Two readings of one problem: the estimator's own covariance is its bound, within what its noise is known."""
    rng = np.random.default_rng(4)
    fields, downs = rows_align._attitudes(rng, 3000)
    data = rows_align._read(rng, fields, downs)
    variances = bounds.variance_of(rows_align.MAG_SD, 1.0), bounds.variance_of(rows_align.DOWN_SD, 1e-3)
    whole = np.linalg.inv(bounds.alignment(fields, downs, rows_align.MATRIX, scenes.DIP, *variances))
    answer = rows_align._ours("offset")(data)
    assert answer is not None
    assert answer.stored_sd is not None
    np.testing.assert_allclose(answer.stored_sd, np.sqrt(np.diag(whole)[:3]), rtol=0.06)


def test_a_movement_carries_errors_as_it_carries_the_vertical() -> None:
    data = rows_imu.held(np.random.default_rng(5), 2)
    first, last = 300, 480
    rows, covariance = bounds._move(rows_imu.UNIT, first, last, data.rates, data.downs, 0.01)

    def carried(down, gyro, offset):
        readings = data.rates[first:last] @ rows_imu.GYRO.T + rows_imu.GYRO_OFFSET
        for reading in readings:
            down = bounds._turned(np.linalg.solve(gyro, reading - offset), 0.01) @ down
        return down

    at = data.downs[first]
    for k in range(15):
        ends = []
        for step in (1e-6, -1e-6):
            down, gyro, offset = at.copy(), rows_imu.GYRO.copy(), rows_imu.GYRO_OFFSET.copy()
            if k < 3:
                down[k] += step
            elif k < 12:
                gyro[divmod(k - 3, 3)] += step
            else:
                offset[k - 12] += step
            ends.append(carried(down, gyro, offset))
        np.testing.assert_allclose(rows[:, k], (ends[0] - ends[1]) / 2e-6, atol=0.03)
    np.testing.assert_allclose(data.downs[last], carried(at, rows_imu.GYRO, rows_imu.GYRO_OFFSET), atol=1e-9)
    assert math.sqrt(np.trace(covariance)) == pytest.approx(3e-3 * 0.01 * math.sqrt(2 * 180), rel=0.3)


def test_a_number_that_moves_through_the_bins() -> None:
    assert bounds.moving_variance_of(3.0, 1.0) == pytest.approx(9.0 + 1.0 / 12.0, rel=1e-4)
    assert bounds.moving_variance_of(0.5, 1.0) == pytest.approx(0.25 + 1.0 / 12.0, rel=0.01)
    assert bounds.moving_variance_of(0.1, 1.0) < 0.8 / 12.0
    assert bounds.moving_variance_of(0.1, 0.0) == 0.1**2
