"""The screen that picks which frequencies are worth a fit."""

from __future__ import annotations

import numpy as np
import pytest

from calib.gap.effects.tone import strongest_bins
from calib.recording import Sensor

from .conftest import make


@pytest.mark.parametrize("frequency", [2.0, 4.9, 20.0, 43.0])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_line_that_stands_out_is_among_the_frequencies_that_are_tried(frequency, seed):
    trace = make(Sensor.MAG)
    rng = np.random.default_rng(seed)
    size = 12.0 / np.sqrt(len(trace.t))  # of white noise of one: a line of evidence 72
    wave = size * np.cos(2.0 * np.pi * frequency * trace.t)[:, None] * [1.0, 0.0, 0.0]
    tried = strongest_bins(trace, rng.standard_normal((len(trace.t), 3)) + wave)
    assert np.abs(tried - frequency).min() < 1.5 * trace.fs / len(trace.t)
