"""What a nominal recording shows against a pose of its own is no gap of another one."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from mavcal.calib import gap
from mavcal.calib.gap.companion.baselines import compared_with_nominal, nominal_baseline_of
from mavcal.calib.gap.reference import build, companion_with_pose
from mavcal.calib.gap.reference.signals import interpolated
from mavcal.calib.gap.schema import GapVerdict
from mavcal.calib.recording import Recording, Sensor
from tests.unit.gap.reference.test_recorded import RATE, SIGMA, channel

ALPHA = 0.005
SECONDS = 60.0
DELAY_S, BIAS = 0.008, np.array([0.008, -0.004, 0.006])
SAID = np.array([0.05, 0.0, -0.04])


def recording(seed, delay=DELAY_S, bias=0.0, pose=True):
    """Sensors on a body that is turned by hand, beside its attitude; their stamps are `delay` s late."""
    rng = np.random.default_rng(seed)
    fine, step = np.arange(-1.0, SECONDS + 1.0, 1e-3), 1e-3
    waves = [
        rng.uniform(0.1, 0.5, 3) * np.sin(2.0 * np.pi * hz * fine[:, None] + rng.uniform(0.0, 6.0, 3))
        for hz in np.geomspace(0.05, 3.0, 25)
    ]
    body = Rotation.from_euler("ZYX", 0.15 * np.sum(waves, axis=0))
    rate = (body[:-1].inv() * body[1:]).as_rotvec() / step
    field = body.inv().apply([22.0, 1.0, 42.0])
    t = np.arange(0.0, SECONDS, 1.0 / RATE)
    late = {
        Sensor.GYRO: interpolated(fine[:-1] + 0.5 * step, rate, t - delay) + bias,
        Sensor.MAG: interpolated(fine, field, t - delay),
    }
    readings = [channel(s, t, v + SIGMA[s] * rng.standard_normal(v.shape)) for s, v in late.items()]
    q = Slerp(fine, body)(t).as_quat()[:, [3, 0, 1, 2]]
    return Recording((*readings, channel(Sensor.ATTITUDE, t, q)) if pose else tuple(readings))


def learned(nominal):
    return nominal_baseline_of(lambda known: build(nominal, None, [nominal], nuisance=known, companion=nominal), ALPHA)


@pytest.fixture(scope="module")
def nominal():
    return recording(1)


@pytest.mark.long
def test_its_delays_are_found_with_their_size(nominal):
    found = {e.id: e for e in learned(nominal).effects}
    for name in ("gyro_delay", "mag_delay"):
        assert found[name].params[0].value == pytest.approx(DELAY_S, rel=0.05)


def test_what_both_have_is_no_gap(nominal):
    report = gap.run(recording(2), None, [nominal], nested=False)
    assert report.verdict is GapVerdict.NO_GAP
    assert any("taken off" in w and "gyro_delay (delay_s 0.008 s)" in w for w in report.warnings)


@pytest.mark.long
def test_without_a_nominal_recording_it_is_one():
    assert "gyro_delay" in {e.id for e in gap.run(recording(2), nested=False).effects}


@pytest.mark.long
def test_what_only_the_other_has_is_found_in_its_own_size(nominal):
    report = gap.run(recording(2, bias=SAID), None, [nominal], nested=False)
    assert [e.id for e in report.effects] == ["gyro_bias"]
    said = np.array([p.value for p in report.effects[0].params])
    assert said == pytest.approx(SAID, abs=0.002)


@pytest.mark.long
def test_a_bias_is_not_carried_over_but_one_as_large_is_no_gap():
    switched_on = recording(1, 0.0, BIAS)
    baseline = learned(switched_on)
    said = next(e for e in baseline.biases if e.sensor is Sensor.GYRO)
    assert [p.value for p in said.params] == pytest.approx(BIAS, abs=1e-3)
    changed = compared_with_nominal(build(recording(2, 0.0), None, [switched_on]), baseline)
    gyro = next(t for t in changed.traces if t.sensor is Sensor.GYRO)
    assert gyro.residual.mean(axis=0) == pytest.approx(np.zeros(3), abs=1e-3)
    for bias in (np.zeros(3), BIAS, -BIAS):
        assert gap.run(recording(3, 0.0, bias), None, [switched_on], nested=False).effects == ()
    report = gap.run(recording(3, 0.0, 3.0 * BIAS), None, [switched_on], nested=False)
    assert [e.id for e in report.effects] == ["gyro_bias"]


@pytest.mark.long
def test_it_is_the_first_nominal_table_with_a_pose(nominal):
    bare = recording(5, pose=False)
    assert companion_with_pose(recording(2), [bare, nominal]) is nominal
    assert companion_with_pose(bare, [nominal]) is None
    assert companion_with_pose(recording(2), []) is None
    gyro = recording(2).channel(Sensor.GYRO, 0)
    with_reference = dataclasses.replace(recording(2), reference=(gyro,))
    assert companion_with_pose(with_reference, [nominal]) is None
    assert companion_with_pose(recording(2), [with_reference]) is None


@pytest.mark.long
def test_a_simulators_table_with_a_pose_of_its_own_is_compared_as_another_flight():
    """Both are late by as much, and have the same bias: no gap. It was a delay of the real gyroscope."""
    sim = recording(2, bias=BIAS)
    report = gap.run(recording(1, bias=BIAS), sim, nested=False)
    assert report.verdict is GapVerdict.NO_GAP
    assert report.effects == ()
    later = gap.run(recording(1, delay=DELAY_S + 0.012, bias=BIAS), sim, nested=False)
    assert "gyro_delay" in {e.id for e in later.effects}
