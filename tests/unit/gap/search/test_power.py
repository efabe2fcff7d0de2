"""The weakest effect that is found half of the time, beside another library's non-central chi-square."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi2, ncx2

from mavcal.calib.gap.search.power import noncentrality
from tests.examples import examples


@settings(max_examples=examples(25), deadline=None)
@given(df=st.integers(1, 12), exponent=st.floats(-8.0, -1.0))
def test_a_test_at_that_size_fires_half_of_the_time(df, exponent):
    level = 10.0**exponent
    found = noncentrality(df, level)
    assert ncx2.sf(chi2.isf(level, df), df, found) == pytest.approx(0.5, abs=1e-6)


def test_one_number_needs_the_threshold_of_its_own_normal_error():
    """Two-sided at 5 %: 1.96 standard errors, and the far side adds next to nothing."""
    assert math.sqrt(noncentrality(1, 0.05)) == pytest.approx(1.96, abs=0.005)
    assert math.sqrt(noncentrality(1, 1e-6)) == pytest.approx(4.892, abs=1e-3)


@pytest.mark.parametrize("level", [1e-2, 1e-6])
def test_more_numbers_and_a_stricter_level_need_more(level):
    needed = [noncentrality(df, level) for df in (1, 2, 3, 6, 12)]
    assert (np.diff(needed) > 0.0).all()
    assert noncentrality(3, 0.1 * level) > noncentrality(3, level)
