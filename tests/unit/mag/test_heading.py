from __future__ import annotations

import math

import numpy as np
import pytest

from mavcal.calib.mag.heading import heading_sd_deg
from mavcal.calib.triad import TriadModel


def offset_covariance(sd: float, axis: int = 0) -> np.ndarray:
    covariance = np.zeros((12, 12))
    covariance[axis, axis] = sd**2
    return covariance


def test_a_milligauss_of_offset() -> None:
    """METHODS 0: 1 mG of horizontal offset at F = 490 mG and a dip of 66 deg is 0.287 deg."""
    found = heading_sd_deg(TriadModel(), offset_covariance(1.0), 490.0, math.radians(66.0))
    assert found == pytest.approx(0.287, abs=0.001)


def test_a_vertical_offset_matters_by_the_sine_of_the_tilt() -> None:
    covariance = offset_covariance(1.0, axis=2)
    dip = math.radians(66.0)
    assert heading_sd_deg(TriadModel(), covariance, 490.0, dip, tilt=0.0) == pytest.approx(0.0, abs=1e-9)
    assert heading_sd_deg(TriadModel(), covariance, 490.0, dip) == pytest.approx(0.287 * 0.5, abs=0.001)
    on_its_side = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
    found = heading_sd_deg(TriadModel(), covariance, 490.0, dip, on_its_side, tilt=0.0)
    assert found == pytest.approx(0.287, abs=0.001)


def test_a_common_scale_does_not_turn_the_heading() -> None:
    scale = np.concatenate([np.zeros(3), np.eye(3).ravel()])
    covariance = np.outer(scale, scale) * 0.1**2
    assert heading_sd_deg(TriadModel(), covariance, 490.0, 1.0) == pytest.approx(0.0, abs=1e-6)


def test_a_cross_term_turns_the_heading_by_its_share() -> None:
    """C_xy = C_yx = e turns a level heading by up to e radians."""
    cross = np.zeros(12)
    cross[[4, 6]] = 0.01
    found = heading_sd_deg(TriadModel(), np.outer(cross, cross), 490.0, 1.0, tilt=0.0)
    assert found == pytest.approx(math.degrees(0.01), rel=1e-6)


def test_agrees_with_draws() -> None:
    rng = np.random.default_rng(1)
    root = 0.003 * rng.normal(size=(12, 12))
    covariance, matrix, dip = root @ root.T, np.eye(3) + 0.05 * rng.normal(size=(3, 3)), math.radians(50.0)
    truth = TriadModel(np.array([0.1, -0.2, 0.3]), matrix)
    errors = []
    for draw in rng.multivariate_normal(np.zeros(12), covariance, size=2000):
        model = TriadModel(truth.offset + draw[:3], truth.matrix + draw[3:].reshape(3, 3))
        heading = np.arange(0.0, 2 * math.pi, math.pi / 18)
        c = np.stack([math.cos(dip) * np.cos(heading), -math.cos(dip) * np.sin(heading), np.full(36, math.sin(dip))], 1)
        found = model.apply(truth.invert(c))
        error = np.arctan2(-found[:, 1], found[:, 0]) - heading
        errors.append((error + math.pi) % (2 * math.pi) - math.pi)
    worst = math.degrees(np.array(errors).std(axis=0).max())
    assert heading_sd_deg(truth, covariance, 1.0, dip, tilt=0.0) == pytest.approx(worst, rel=0.06)


def test_at_the_pole_the_answer_is_large_and_finite() -> None:
    assert 60.0 < heading_sd_deg(TriadModel(), offset_covariance(10.0), 490.0, math.pi / 2) < 90.0
