"""Uncertainties of angles beside those of many draws: two routes to one number."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from mavcal.calib.attitude import drift_sd_deg_per_min, tilt_sd_deg
from mavcal.calib.mag.mounting import mounting_of, rotation_covariance
from mavcal.calib.triad import TriadModel
from tests.examples import examples

DRAWS = 400
G = 9.80665


def covariance_of(rng: np.random.Generator, size: float) -> np.ndarray:
    """A covariance (12, 12) of offset and matrix without any symmetry."""
    root = size * rng.normal(size=(12, 12))
    return root @ root.T


def drawn(model: TriadModel, covariance: np.ndarray, rng: np.random.Generator) -> list[TriadModel]:
    changes = rng.multivariate_normal(np.zeros(12), covariance, size=DRAWS)
    return [TriadModel(model.offset + c[:3], model.matrix + c[3:].reshape(3, 3)) for c in changes]


@settings(max_examples=examples(25))
@given(st.floats(0.0, 179.0), st.integers(0, 1000), st.lists(st.floats(0.7, 1.4), min_size=3, max_size=3))
def test_the_angle_is_that_of_the_rotation_whatever_the_scales(angle: float, seed: int, scales: list[float]) -> None:
    axis = np.random.default_rng(seed).normal(size=3)
    turn = Rotation.from_rotvec(math.radians(angle) * axis / np.linalg.norm(axis)).as_matrix()
    model = TriadModel(matrix=turn @ np.diag(scales))
    told = mounting_of(model, np.zeros((12, 12)))
    assert told["mounting_deg"] == pytest.approx(angle, abs=1e-5)
    assert told["mounting_sd_deg"] == 0.0


def test_the_covariance_of_the_rotation_is_that_of_many_draws() -> None:
    rng = np.random.default_rng(7)
    turn = Rotation.from_euler("xyz", [20.0, -35.0, 120.0], degrees=True).as_matrix()
    model = TriadModel(matrix=turn @ np.array([[1.1, 0.05, 0.0], [0.05, 0.9, -0.1], [0.0, -0.1, 1.0]]))
    covariance = covariance_of(rng, 3e-4)
    off = [Rotation.from_matrix(one.rotation @ model.rotation.T).as_rotvec() for one in drawn(model, covariance, rng)]
    expected = rotation_covariance(model, covariance)
    np.testing.assert_allclose(np.cov(np.array(off).T), expected, atol=0.2 * np.abs(expected).max())
    worst = math.degrees(math.sqrt(np.linalg.eigvalsh(expected)[-1]))
    assert mounting_of(model, covariance)["mounting_sd_deg"] == pytest.approx(worst)


def test_the_tilt_of_a_level_is_as_uncertain_as_many_draws_say() -> None:
    rng = np.random.default_rng(8)
    model = TriadModel(np.array([0.1, -0.2, 0.3]), np.array([[1.02, 0.01, 0.0], [0.0, 0.98, 0.02], [0.01, 0.0, 1.01]]))
    covariance = covariance_of(rng, 1e-3)
    raw = model.invert(np.array([[0.0, 0.0, -G]]))
    seen = np.array([one.apply(raw)[0] for one in drawn(model, covariance, rng)])
    spread = np.linalg.eigvalsh(np.cov(seen[:, :2].T))[-1]
    assert tilt_sd_deg(model, covariance, G) == pytest.approx(math.degrees(math.sqrt(spread) / G), rel=0.12)


def test_a_level_knows_an_offset_by_its_share_of_gravity() -> None:
    covariance = np.zeros((12, 12))
    covariance[0, 0] = 0.05**2
    covariance[2, 2] = 9.0  # along gravity: no tilt
    assert tilt_sd_deg(TriadModel(), covariance, G) == pytest.approx(math.degrees(0.05 / G))
    assert tilt_sd_deg(TriadModel(), np.zeros((12, 12)), G) == 0.0


def test_a_drift_is_the_worst_axis_of_the_offset_over_a_minute() -> None:
    covariance = np.zeros((15, 15))  # of a model with a thermal part as well
    covariance[:3, :3] = np.diag([1e-4, 2e-4, 1e-5]) ** 2
    assert drift_sd_deg_per_min(TriadModel(), covariance) == pytest.approx(math.degrees(60.0 * 2e-4))
    scaled = TriadModel(matrix=np.diag([10.0, 1.0, 1.0]))  # counts on one axis
    assert drift_sd_deg_per_min(scaled, covariance) == pytest.approx(math.degrees(60.0 * 1e-3))
