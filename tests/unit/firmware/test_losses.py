from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavcal.calib.firmware.losses import largest_error, largest_sd, split
from mavcal.calib.firmware.rotations import euler_matrix, rotation_angle
from mavcal.calib.recording import Sensor
from mavcal.calib.triad import TriadModel

small = st.floats(-0.05, 0.05)


@given(st.lists(small, min_size=6, max_size=6), st.floats(-180, 180), st.floats(-80, 80))
def test_the_parts_multiply_to_the_matrix(entries, yaw, pitch):
    symmetric = np.eye(3) + np.array([entries[:3], [entries[1], *entries[3:5]], [entries[2], entries[4], entries[5]]])
    turn = euler_matrix(0, pitch, yaw)
    model = TriadModel(matrix=turn @ symmetric)
    np.testing.assert_allclose(model.rotation @ model.symmetric().matrix, model.matrix, atol=1e-12)
    np.testing.assert_allclose(model.rotation, turn, atol=1e-9)


def test_the_covariance_of_the_symmetric_part_agrees_with_scattered_matrices(make_fit):
    rng = np.random.default_rng(4)
    matrix = euler_matrix(4, -7, 20) @ np.array([[1.1, 0.02, 0], [0.02, 0.93, 0.03], [0, 0.03, 1.02]])
    root = 1e-4 * rng.normal(size=(9, 9))
    fit = make_fit(Sensor.MAG, matrix=matrix, offset_sd=0.0)
    covariance = np.zeros((12, 12))
    covariance[3:, 3:] = root @ root.T
    object.__setattr__(fit, "covariance", covariance)
    parts = split(fit)
    scattered = []
    for _ in range(4000):
        moved = matrix + (root @ rng.normal(size=9)).reshape(3, 3)
        values, vectors = np.linalg.eigh(moved.T @ moved)
        s = (vectors * np.sqrt(values)) @ vectors.T
        scattered.append([s[0, 0], s[1, 1], s[2, 2], s[0, 1], s[0, 2], s[1, 2]])
    np.testing.assert_allclose(np.std(scattered, axis=0), parts.sd[3:], rtol=0.05)


def test_turned_parts_describe_the_same_sensor_in_other_axes(make_fit):
    fit = make_fit(
        Sensor.MAG, offset=[1.0, 2.0, 3.0], matrix=[[1.1, 0.02, 0], [0.02, 0.93, 0.03], [0, 0.03, 1.02]], matrix_sd=1e-3
    )
    turn = euler_matrix(0, 0, 90)
    turned = split(fit).rotated(turn)
    raw = np.random.default_rng(1).normal(size=(20, 3))
    np.testing.assert_allclose(
        (raw @ turn.T - turned.offset) @ turned.symmetric.T, fit.model.apply(raw) @ turn.T, atol=1e-12
    )
    np.testing.assert_allclose(turned.sd[3:], np.full(6, 1e-3), rtol=1e-12)


def test_the_sd_of_the_largest_error_is_that_of_scattered_fits(make_fit):
    rng = np.random.default_rng(8)
    matrix = np.array([[1.01, 0.02, -0.004], [0.02, 0.98, 0.003], [-0.004, 0.003, 1.02]])
    parts = split(make_fit(Sensor.ACCEL, matrix=matrix, matrix_sd=2e-4))
    root = np.linalg.cholesky(parts.covariance[3:, 3:] + 1e-18 * np.eye(6))
    found = []
    for _ in range(2000):
        d = root @ rng.normal(size=6)
        moved = matrix + np.array([[d[0], d[3], d[4]], [d[3], d[1], d[5]], [d[4], d[5], d[2]]])
        found.append(largest_error(np.diag(np.diag(moved)), moved, 1.0))
    assert largest_sd(parts, parts.diagonal) == pytest.approx(np.std(found), rel=0.1)


def test_the_largest_error_is_reached_and_never_exceeded():
    rng = np.random.default_rng(2)
    fitted = np.eye(3) + 0.01 * rng.normal(size=(3, 3))
    fitted = 0.5 * (fitted + fitted.T)
    stored = np.diag(np.diag(fitted))
    directions = rng.normal(size=(100_000, 3))
    truth = 9.8 * directions / np.linalg.norm(directions, axis=1, keepdims=True)
    left = np.linalg.norm(truth @ np.linalg.inv(fitted).T @ stored.T - truth, axis=1).max()
    assert left == pytest.approx(largest_error(stored, fitted, 9.8), rel=1e-3)
    assert left <= largest_error(stored, fitted, 9.8)


@given(st.floats(1e-9, 3.1))
def test_angles_are_exact_from_tiny_to_large(angle):
    assert rotation_angle(euler_matrix(0, 0, float(np.degrees(angle)))) == pytest.approx(angle, rel=1e-6)
