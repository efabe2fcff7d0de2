"""Which of two causes that explain nearly the same is believed."""

from __future__ import annotations

import math

import numpy as np
import pytest

from calib.gap.attribution import _behind
from calib.gap.contest import Score
from calib.gap.effects import forward_models
from calib.gap.hypotheses import Hypothesis
from calib.gap.selection import REAL


def scored(delta, df):
    hypothesis = Hypothesis(forward_models()["accel_bias"][-1], (0,))
    return Score(hypothesis, math.nan, delta, df, 1, 0.0, delta, np.zeros(df))


def test_of_causes_that_differ_by_a_second_order_the_one_with_fewer_numbers_is_believed():
    own, second = 1e6, REAL * 1e6
    assert _behind(own, scored(own + 0.9 * second, 9), 3, second) > 0.0
    assert _behind(own, scored(own + 1.1 * second, 9), 3, second) < 0.0
    assert _behind(own, scored(own - 0.05 * second, 3), 9, second) < 0.0
    assert _behind(own, scored(own - 0.2 * second, 3), 9, second) > 0.0
    assert _behind(own, scored(own + 1.0, 9), 3, 0.0) == pytest.approx(-1.0)
