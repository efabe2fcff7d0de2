"""The pole through which temperatures come late, where a sample is long."""

from __future__ import annotations

import numpy as np

from mavcal.calib.gap.effects.parts import lagged


def test_a_ramp_through_one_pole_is_exact_however_long_a_sample_is():
    dt, tau = 1.0, 1.5
    t = dt * np.arange(12)
    expected = 2.0 * (t - tau * (1.0 - np.exp(-t / tau))) + 7.0
    np.testing.assert_allclose(lagged(2.0 * t + 7.0, dt, tau), expected, atol=1e-12)
