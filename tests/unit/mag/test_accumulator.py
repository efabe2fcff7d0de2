from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.fit import FitStatus
from mavcal.calib.mag.accumulator import EllipsoidAccumulator, directions_of
from mavcal.calib.mag.coverage import Coverage
from mavcal.calib.mag.ellipsoid import fit_ellipsoid
from tests.examples import examples
from tests.fields import field_of

FIELD = field_of(49.1, math.radians(66.0), norm_sd=0.15)


@settings(max_examples=examples(15), deadline=None)
@given(cuts=st.lists(st.integers(0, 1500), max_size=6))
def test_chunking_does_not_matter(cuts: list[int]) -> None:
    rng = np.random.default_rng(1)
    u = rng.normal(size=(1500, 3))
    samples = u / np.linalg.norm(u, axis=1, keepdims=True) * [50.0, 47.0, 52.0] + 0.3 * rng.normal(size=u.shape)
    grown = EllipsoidAccumulator()
    for chunk in np.split(samples, sorted(cuts)):
        grown.add(chunk)
    assert len(grown) == 1500
    np.testing.assert_array_equal(grown.samples, samples)


def coverage_of(grown: EllipsoidAccumulator) -> Coverage:
    """Directions of the field seen so far, by the rough shape, as the procedure counts them."""
    shape = grown.rough()
    return Coverage.empty() if shape is None else Coverage.of(directions_of(grown.samples, shape))


def test_the_prediction_follows_a_movement_that_grows(compass: Any) -> None:
    rng = np.random.default_rng(2)
    grown = EllipsoidAccumulator()
    assert grown.rough() is None
    assert coverage_of(grown).count == 0
    predicted = []
    for tilt in (2.0, 20.0, 45.0, 180.0):
        grown.add(compass.read(compass.tilted(rng, 300, tilt), rng))
        predicted.append(coverage_of(grown).heading_sd_deg(0.006, compass.dip))
    assert predicted == sorted(predicted, reverse=True)
    fit = fit_ellipsoid(grown.samples, field=FIELD)
    assert fit.status == FitStatus.OK
    assert fit.quality["heading_sd_deg"] == pytest.approx(predicted[-1], rel=0.2)
    assert coverage_of(grown).count == len(grown) == 1200
    rough = grown.rough()
    assert rough is not None
    np.testing.assert_allclose(rough.offset, compass.truth.offset, atol=0.3)


def test_a_bad_chunk_changes_nothing(compass: Any, rng: np.random.Generator) -> None:
    grown = EllipsoidAccumulator()
    grown.add(compass.read(compass.everywhere(rng, 20), rng))
    with pytest.raises(InvalidInputError, match="finite"):
        grown.add([[1.0, math.nan, 2.0]])
    with pytest.raises(InvalidInputError, match="shape"):
        grown.add([[1.0, 2.0]])
    grown.add(np.empty((0, 3)))
    assert len(grown) == 20
    with pytest.raises(ValueError, match="read-only"):
        grown.samples[0] = 0.0
    grown.add([1.0, 2.0, 3.0])
    assert len(grown) == 21


def test_a_sensor_that_stands_still_has_no_shape() -> None:
    grown = EllipsoidAccumulator()
    grown.add(np.tile([10.0, 20.0, 30.0], (50, 1)))
    assert grown.rough() is None
    assert fit_ellipsoid(grown.samples).status == FitStatus.REFUSED


def test_a_resting_compass_of_whole_steps_has_no_shape_or_one_with_directions() -> None:
    """As a simulator without noise has it: the same reading again and again, or a step beside it."""
    rng = np.random.default_rng(7)
    for case in range(900):
        steps = np.tile(np.round(300.0 * rng.normal(size=3)), (int(rng.integers(10, 60)), 1))
        if case % 3 == 1:
            steps[:, rng.integers(3)] += rng.integers(-1, 2, size=len(steps))
        elif case % 3 == 2:
            steps += rng.integers(0, 2, size=steps.shape)
        grown = EllipsoidAccumulator()
        grown.add(0.1 * steps)
        coverage = coverage_of(grown)
        assert np.isfinite(coverage.information).all()
        assert case % 3 == 2 or coverage.count == 0
