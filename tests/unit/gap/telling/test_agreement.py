from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mavcal.calib.gap.schema import EffectEstimate, ParameterEstimate
from mavcal.calib.gap.telling.agreement import agreements, distance
from tests.examples import examples
from tests.unit.gap.export.making import effect


def told(
    *values: float, se: float = 0.01, instances: tuple[int, ...] = (1,), id_: str = "accel_bias"
) -> EffectEstimate:
    params = tuple(ParameterEstimate(f"p{k}", v, se, (v - se, v + se), "m/s2") for k, v in enumerate(values))
    return replace(effect("accel_bias", instances), id=id_, params=params)


@settings(max_examples=examples(40))
@given(st.floats(-5.0, 5.0), st.floats(0.001, 1.0), st.floats(0.001, 1.0))
def test_one_number_agrees_within_two_of_both_errors(difference: float, first: float, second: float) -> None:
    one, other = told(0.0, se=first), told(difference, se=second)
    apart = abs(difference) / math.hypot(first, second)
    assert distance(one, other) == pytest.approx(apart / 2.0, rel=1e-3)
    assert distance(one, other) == pytest.approx(distance(other, one))


def test_the_largest_of_several_may_differ_by_more() -> None:
    """As many more standard errors as the largest of several differs by chance: nothing is gained by more numbers."""
    rng = np.random.default_rng(1)
    for count in (1, 3, 12):
        far = [
            distance(told(*np.zeros(count), se=math.sqrt(0.5)), told(*rng.normal(size=count), se=math.sqrt(0.5))) > 1.0
            for _ in range(400)
        ]
        assert np.mean(far) == pytest.approx(0.0455, abs=0.035)


def test_only_what_both_know_is_compared() -> None:
    one, other = told(0.0, 0.0), told(0.0, 9.0)
    assert distance(one, other) > 1.0
    assert distance(one, told(0.0)) == 0.0
    endless = replace(other, params=(other.params[0], replace(other.params[1], se=math.inf)))
    assert distance(one, endless) == distance(endless, one) == 0.0
    assert distance(one, replace(other, params=())) == math.inf


def test_numbers_that_are_exact_agree_only_with_themselves() -> None:
    assert distance(told(1.0, se=0.0), told(1.0, se=0.0)) == 0.0
    assert distance(told(1.0, se=0.0), told(1.1, se=0.0)) > 1e6


def test_an_effect_agrees_with_the_same_one_of_the_same_instances() -> None:
    mine = told(0.3)
    for other in (told(0.3, id_="accel_scale"), told(0.3, instances=(2,)), told(0.3, instances=(1, 2))):
        [found] = agreements([mine], [other])
        assert (found.other, found.holds) == (None, False)
    [found] = agreements([mine], [told(0.31), told(0.9)])
    assert (found.other, found.holds) == (told(0.31), True)
    assert agreements([mine], [told(0.327)])[0].holds  # by 1.9 standard errors of the difference
    assert not agreements([mine], [told(0.33)])[0].holds  # by 2.1
    [found] = agreements([mine], [told(0.9)])
    assert (found.other, found.holds) == (told(0.9), False)  # it is there, and differs


def test_of_several_steps_each_has_a_counterpart_of_its_own() -> None:
    mine = [told(1.0), told(5.0), told(9.0)]
    found = agreements(mine, [told(5.001), told(1.001)])
    assert [f.other and f.other.params[0].value for f in found] == [1.001, 5.001, None]
    assert [f.holds for f in found] == [True, True, False]
    twice = agreements([told(1.0), told(1.0)], [told(1.0)])
    assert [f.holds for f in twice] == [True, False]


@settings(max_examples=examples(30))
@given(st.lists(st.floats(-9.0, 9.0), max_size=6), st.lists(st.floats(-9.0, 9.0), max_size=6))
def test_every_effect_has_a_row_and_no_counterpart_is_used_twice(mine: list[float], theirs: list[float]) -> None:
    others = [told(value) for value in theirs]
    found = agreements([told(value) for value in mine], others)
    assert [f.effect.params[0].value for f in found] == mine
    used = [id(f.other) for f in found if f.other is not None]
    assert len(used) == len(set(used)) == min(len(mine), len(theirs))
