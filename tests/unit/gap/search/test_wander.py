"""The marginal likelihood of a wandering reference."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mavcal.calib.gap.search.wander import inverse_root, marginal_gain


def test_the_marginal_likelihood_stands_squares_that_rounding_makes_negative():
    inner = np.array([[2.0, 1.0], [1.0, 3.0]])
    right = np.array([1.0, 2.0])
    plain = float(right @ np.linalg.solve(inner, right)) - math.log(5.0)
    assert marginal_gain(inverse_root(inner), right) == pytest.approx(plain)
    broken = np.array([[1.0 + 1e20, 1e20], [1e20, 1e20 - 1e5]])
    assert math.isfinite(marginal_gain(inverse_root(broken), right))
