from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.mag.coverage import CENTRES, Coverage, mask_bytes, ring, sections, visited
from mavcal.calib.mag.ellipsoid import fit_ellipsoid
from tests.fields import field_of


def test_eighty_sections_of_nearly_one_size() -> None:
    assert CENTRES.shape == (80, 3)
    np.testing.assert_allclose(np.linalg.norm(CENTRES, axis=1), 1.0)
    cosine = CENTRES @ CENTRES.T - 2.0 * np.eye(80)
    nearest = np.degrees(np.arccos(cosine.max(axis=1)))
    assert 15.0 < nearest.min() <= nearest.max() < 25.0
    u = np.random.default_rng(1).normal(size=(80_000, 3))
    share = np.bincount(sections(u), minlength=80)
    assert 600 < share.min() <= share.max() < 1400
    assert np.array_equal(sections(CENTRES * 7.0), np.arange(80))


def test_the_mask_is_that_of_the_bits() -> None:
    seen = visited(CENTRES[[0, 8, 79]])
    assert mask_bytes(seen) == [1, 1, 0, 0, 0, 0, 0, 0, 0, 128]


@given(st.lists(st.integers(0, 79), min_size=1, max_size=40), st.integers(1, 39))
def test_chunks_add_up(numbers: list[int], cut: int) -> None:
    directions = CENTRES[numbers]
    whole = Coverage.of(directions)
    parts = Coverage.of(directions[:cut]).merged(Coverage.of(directions[cut:]))
    np.testing.assert_allclose(parts.information, whole.information, atol=1e-12)
    assert parts.mask == whole.mask
    assert parts.count == whole.count == len(numbers)


def test_the_prediction_is_what_the_fit_then_states(compass: Any) -> None:
    """Noise of 0.6 % and 2000 samples, everywhere and within 45 degrees of tilt."""
    rng = np.random.default_rng(4)
    for u in (compass.everywhere(rng, 2000), compass.tilted(rng, 2000, 45.0)):
        predicted = Coverage.of(u).heading_sd_deg(0.3 / compass.truth.mean_radius, compass.dip)

        fit = fit_ellipsoid(compass.read(u, rng), field=field_of(49.1, compass.dip))
        assert fit.quality["heading_sd_deg"] == pytest.approx(predicted, rel=0.15)


def test_advice_leads_to_the_goal_and_every_step_improves() -> None:
    dip, noise = math.radians(66.0), 0.006
    covered = Coverage.empty()
    before = covered.heading_sd_deg(noise, dip)
    for _ in range(6):
        advice = covered.advice(noise, dip)
        assert "full circle" in advice.text
        covered = covered.merged(Coverage.of(np.repeat(ring(np.array(advice.direction), dip), 10, axis=0)))
        after = covered.heading_sd_deg(noise, dip)
        assert after < before
        before = after
    assert before < 0.3


def test_advice_after_level_turns_is_to_tilt() -> None:
    dip = math.radians(66.0)
    level = Coverage.of(np.repeat(ring(np.array([0.0, 0.0, 1.0]), dip), 20, axis=0))
    advice = level.advice(0.006, dip)
    assert advice.direction[2] < 0.9
    assert advice.heading_sd_deg < level.heading_sd_deg(0.006, dip)


@given(st.floats(-math.pi / 2, math.pi / 2))
def test_a_ring_is_what_the_dip_makes_it(dip: float) -> None:
    down = np.array([0.6, 0.0, 0.8])
    np.testing.assert_allclose(ring(down, dip) @ down, math.sin(dip), atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(ring(down, dip), axis=1), 1.0)


def test_nothing_seen_is_finite() -> None:
    empty = Coverage.of(np.empty((0, 3)))
    assert empty.fraction == 0.0
    assert 10.0 < empty.heading_sd_deg(0.01, 1.0) < 1000.0


@pytest.mark.parametrize("directions", [[[0.0, 0.0, 0.0]], [[math.nan, 0.0, 1.0]], [1.0, 2.0, 3.0]])
def test_what_is_no_direction_is_refused(directions: Any) -> None:
    with pytest.raises(InvalidInputError):
        Coverage.of(directions)
    with pytest.raises(InvalidInputError, match="noise"):
        Coverage.empty().heading_sd_deg(0.0, 1.0)
