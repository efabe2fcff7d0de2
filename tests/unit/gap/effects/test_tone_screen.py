"""The screen that picks which frequencies are worth a fit."""

from __future__ import annotations

import numpy as np
import pytest

from mavcal.calib.gap.effects.tone import strongest_bins
from mavcal.calib.recording import Sensor

from .conftest import make

EVIDENCE = 60.0


def without_a_mean(rng: np.random.Generator, n: int) -> np.ndarray:
    """White noise of one whose three means are zero to the last bit: their logarithm has no bottom."""
    half = np.round(rng.standard_normal((n // 2, 3)) * 1024.0) / 1024.0
    return rng.permuted(np.concatenate([half, -half]), axis=0)


@pytest.mark.sampled
@pytest.mark.parametrize("frequency", [2.0, 4.9, 20.0, 43.0])
@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("seed", range(4))
def test_a_line_that_stands_out_is_among_the_frequencies_that_are_tried(frequency, axis, seed):
    trace = make(Sensor.MAG)
    n = len(trace.t)
    residual = without_a_mean(np.random.default_rng(seed), n)
    assert not residual.sum(axis=0).any()
    residual[:, axis] += np.sqrt(2.0 * EVIDENCE / n) * np.cos(2.0 * np.pi * frequency * trace.t + 0.3)
    tried = strongest_bins(trace, residual)
    assert np.abs(tried - frequency).min() < 1.5 * trace.fs / n
