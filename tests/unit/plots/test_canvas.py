from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavcal.calib.plots.canvas import MOST, density, name_of, shown, thinned


@pytest.mark.parametrize(
    ("unit", "told", "factor"),
    [("rad/s", "deg/s", math.degrees(1.0)), ("m/s2", "m/s²", 1.0), ("uT", "µT", 1.0), ("counts", "counts", 1.0)],
)
def test_a_unit_is_one_that_people_read(unit: str, told: str, factor: float) -> None:
    assert shown(unit) == (told, pytest.approx(factor))


def test_instances_count_from_one() -> None:
    assert name_of("mag", 0) == "Compass 1"
    assert name_of("ground_speed", 2) == "Ground speed 3"


@given(st.integers(1, 10 * MOST))
def test_few_samples_are_all_drawn_and_many_are_few(count: int) -> None:
    left = len(range(count)[thinned(count)])
    assert left <= MOST
    assert left == count or left > MOST // 2


T = np.arange(5000) / 100.0


def test_the_density_of_white_noise_is_even_and_its_power_whole() -> None:
    values = 0.2 * np.random.default_rng(1).normal(size=(5000, 3)) + 0.01 * T[:, None]  # and a trend
    found = density(T, values)
    assert found is not None
    hz, root = found
    assert np.median(root) == pytest.approx(0.2 * np.sqrt(2.0 / 100.0), rel=0.1)
    assert (root[0] < 3.0 * np.median(root, axis=0)).all()  # a trend is no power
    assert hz[0] > 0.0
    assert hz[-1] == pytest.approx(50.0)


def test_a_tone_stands_at_its_frequency_on_its_axis() -> None:
    values = 0.01 * np.random.default_rng(2).normal(size=(5000, 3))
    values[:, 1] += np.sin(2 * np.pi * 12.0 * T)
    values[::7] = np.nan  # samples that are missing move nothing
    found = density(T, values)
    assert found is not None
    hz, root = found
    assert hz[np.argmax(root[:, 1])] == pytest.approx(12.0, abs=0.2)
    assert root[:, 0].max() < 0.01 * root[:, 1].max()


@pytest.mark.parametrize(("count", "t"), [(15, None), (100, np.zeros(100)), (0, None)])
def test_too_few_samples_or_times_have_no_density(count: int, t: np.ndarray | None) -> None:
    assert density(T[:count] if t is None else t, np.ones((count, 3))) is None
    assert density(T[:50], np.full((50, 3), np.nan)) is None
