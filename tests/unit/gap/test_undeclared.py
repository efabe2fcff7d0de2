"""Noise that nobody declares is learned from the recording: what was in it meanwhile is no drift."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mavcal.calib import gap
from mavcal.calib.gap.diagnose import diagnose
from mavcal.calib.recording import Sensor
from tests.unit.gap.recorded import CLEAN, REAL, recorded
from tests.unit.gap.synthetic import SIGMA, problem_of


@pytest.mark.long
def test_an_offset_beside_a_larger_effect_is_no_second_order_of_it_in_a_long_recording():
    whole = recorded(REAL, 20261122, seconds=400.0, rate=100.0)
    compass, ideal = (
        tuple(c for c in channels if c.sensor is Sensor.MAG) for channels in (whole.channels, whole.reference)
    )
    report = gap.run(replace(whole, channels=compass, reference=ideal), nested=False)
    found = {e.id: e for e in report.effects}
    assert set(found) == {"mag_hard_iron", "mag_soft_iron"}
    np.testing.assert_allclose([p.value for p in found["mag_hard_iron"].params], REAL.mag.bias, atol=0.05)


def alone(seed, gap, sensor=Sensor.ACCEL):
    """What is said of a sensor whose noise nobody declared."""
    problem = problem_of(np.random.default_rng(seed), (sensor,), gap)
    return diagnose(replace(problem, traces=tuple(replace(t, sigma=None) for t in problem.traces)), nested=False)


@pytest.mark.long
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_an_offset_is_no_slow_noise(seed):
    def offset(trace):
        return 0.5 * SIGMA[Sensor.ACCEL] * np.tile([1.0, -0.5, 0.3], (len(trace.t), 1))

    report = alone(seed, offset)
    assert [e.id for e in report.effects] == ["accel_bias"]
    assert not report.unknown.flag


@pytest.mark.sampled
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_slow_noise_is_no_offset(seed):
    def walk(trace):
        steps = np.random.default_rng(100 + seed).normal(size=trace.ideal.shape)
        return 0.05 * SIGMA[Sensor.ACCEL] * np.cumsum(steps, axis=0)

    report = alone(seed, walk)
    assert not report.effects
    assert not report.unknown.flag


@pytest.mark.long
def test_a_slow_effect_that_the_noise_of_a_block_takes_for_its_own_is_not_withdrawn():
    """Held out, an offset gains next to nothing where noise that was learned without it has room for it."""
    suite = replace(CLEAN, mag=replace(CLEAN.mag, bias=0.032 * np.array([1.0, 1.0, -1.0])))
    report = gap.run(recorded(suite, 1, seconds=1200.0, rate=50.0), nested=False)
    assert [e.id for e in report.effects] == ["mag_hard_iron"]
    assert not report.unknown.flag
