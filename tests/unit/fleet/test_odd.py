from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.fleet.odd import LEAST, limit_of, oddness
from tests.unit.fleet.odd_groups import alarms, limit


def healthy(n: int, seed: int = 1) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal((n, 3))


def test_one_that_is_off_is_named_with_its_axis() -> None:
    values = healthy(30)
    values[4, 2] += 12.0
    found = oddness(values.tolist(), [0.0] * 30)
    assert [i for i, one in enumerate(found) if one is not None and one.odd] == [4]
    assert found[4] is not None
    assert (found[4].axis, found[4].group, found[4].limit) == (2, 30, limit_of(30))


def test_a_third_of_the_group_hides_none_of_its_own() -> None:
    values = healthy(30)
    values[:9, 0] += 40.0
    found = oddness(values.tolist(), [0.0] * 30)
    assert [i for i, one in enumerate(found) if one is not None and one.odd] == list(range(9))


def test_few_sensors_say_nothing_of_each_other() -> None:
    assert oddness(healthy(LEAST - 1).tolist(), [0.0] * (LEAST - 1)) == (None,) * (LEAST - 1)
    assert oddness([], []) == ()


def test_differences_below_the_measurement_are_none() -> None:
    values = np.zeros((12, 3))
    values[0, 0] = 0.01
    assert not any(one is not None and one.odd for one in oddness(values.tolist(), [0.01] * 12))
    exact = oddness(values.tolist(), [0.0] * 12)
    assert exact[0] is not None
    assert exact[0].odd
    assert np.isfinite(exact[0].distance)


def test_what_is_not_finite_is_refused() -> None:
    values = healthy(8)
    values[3, 1] = np.nan
    with pytest.raises(InvalidInputError):
        oddness(values.tolist(), [0.0] * 8)


@pytest.mark.parametrize("n", [6, 10, 21, 101])
def test_the_table_of_limits_is_what_healthy_groups_say(n: int) -> None:
    assert limit_of(n) == pytest.approx(limit(n, 8000, seed=7), rel=0.12)


def test_a_size_between_two_has_the_limit_of_the_smaller_and_a_very_large_group_a_larger_one() -> None:
    assert limit_of(24) == limit_of(21)
    assert limit_of(100_000) > limit_of(1001)


@pytest.mark.parametrize("n", [7, 23, 60])
def test_healthy_groups_are_called_odd_as_rarely_as_stated(n: int) -> None:
    wrong, _ = alarms(n, 600, seed=5)
    assert wrong <= 6 + 3.0 * np.sqrt(6.0)


@given(st.integers(LEAST, 20), st.integers(0, 1000), st.floats(0.1, 10.0), st.floats(-5.0, 5.0))
def test_unit_and_origin_do_not_matter(n: int, seed: int, scale: float, shift: float) -> None:
    values = healthy(n, seed)
    one = oddness(values.tolist(), [0.0] * n)
    other = oddness((scale * values + shift).tolist(), [0.0] * n)
    for a, b in zip(one, other, strict=True):
        assert a is not None
        assert b is not None
        assert a.distance == pytest.approx(b.distance, rel=1e-6)
