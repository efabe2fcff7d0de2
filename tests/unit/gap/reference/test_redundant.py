from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mavcal.calib.gap.problem import ReferenceKind
from mavcal.calib.gap.reference import build
from mavcal.calib.recording import Recording, Sensor

from .test_re_estimated import flight
from .test_recorded import RATE, SECONDS, channel, flown, truth


def several(biases, seed=1):
    """An accelerometer with as many instances as `biases`, and no other reference."""
    rng = np.random.default_rng(seed)
    t = np.arange(int(RATE * SECONDS)) / RATE
    ideal, _ = truth(t)
    return Recording(
        tuple(
            channel(Sensor.ACCEL, t, ideal[Sensor.ACCEL] + bias + 0.02 * rng.standard_normal((len(t), 3)), instance=i)
            for i, bias in enumerate(biases)
        )
    )


def test_the_difference_of_two_instances_needs_no_attitude():
    problem = build(several([[0.3, -0.2, 0.15], [0.0, 0.0, 0.0]]))
    assert problem.reference.kind == ReferenceKind.REDUNDANT
    (trace,) = problem.traces
    assert (trace.instances, trace.against) == ((0,), 1)
    assert trace.residual.mean(axis=0) == pytest.approx([0.3, -0.2, 0.15], abs=0.003)


def test_of_three_the_one_that_most_agree_with_is_the_reference():
    problem = build(several([[0.0, 0.0, 0.0], [0.4, 0.0, 0.0], [0.001, 0.0, 0.0]]))
    assert {t.against for t in problem.traces} < {0, 2}
    odd = next(t for t in problem.traces if t.instances == (1,))
    assert odd.residual.mean(axis=0)[0] == pytest.approx(0.4, abs=0.005)


@pytest.mark.parametrize("stepped", [0, 1, 2])
def test_of_three_one_with_a_step_in_a_third_of_its_samples_is_not_the_reference(stepped):
    real = several([[0.0, 0.0, 0.0]] * 3)
    quiet = real.channels[0].values  # the one that steps is between both others but for its step
    beside = dict(zip([i for i in range(3) if i != stepped], (0.05, -0.05), strict=True))

    def read(c, step):
        late = (c.t > SECONDS * 2.0 / 3.0)[:, None] * np.array([step, 0.0, 0.0])
        return quiet + late if c.instance == stepped else quiet + beside[c.instance]

    for step, base in ((0.0, True), (3.0, False)):
        problem = build(real.with_channels(dataclasses.replace(c, values=read(c, step)) for c in real.channels))
        assert all((t.against == stepped) is base for t in problem.traces)


def test_with_another_reference_the_better_of_two_is_the_base():
    single = flown(effects={Sensor.ACCEL: np.array([0.2, 0.0, 0.0])})
    clean = flown(seed=5)
    second = channel(Sensor.ACCEL, clean.channels[0].t, clean.channels[0].values, instance=1)
    for channels, base in (((*single.channels, second), 1), ((*clean.channels, *_as_second(single)), 0)):
        problem = build(Recording(tuple(channels), reference=single.reference))
        pair = [t for t in problem.traces if t.against is not None]
        assert [t.against for t in pair] == [base]
        assert np.abs(pair[0].residual.mean(axis=0)) == pytest.approx([0.2, 0.0, 0.0], abs=0.005)


def _as_second(recording):
    return (channel(Sensor.ACCEL, recording.channels[0].t, recording.channels[0].values, instance=1),)


def test_instances_sampled_at_different_times_are_not_compared():
    both = several([[0.3, 0.0, 0.0], [0.0, 0.0, 0.0]])
    late = channel(Sensor.ACCEL, both.channels[1].t + 0.004, both.channels[1].values, instance=1)
    with pytest.raises(ValueError, match="ideal sensor"):
        build(Recording((both.channels[0], late)))


@pytest.mark.long
def test_while_the_trajectory_contradicts_its_own_unit_no_unit_is_compared():
    whole = flight(instances=2)
    crash = [
        dataclasses.replace(c, values=np.where(((c.t > 30.0) & (c.t < 30.3))[:, None], 80.0, c.values))
        if c.sensor == Sensor.ACCEL
        else c
        for c in whole.channels
    ]
    pairs = [t for t in build(whole.with_channels(crash)).traces if t.against is not None]
    assert {t.sensor for t in pairs} == {Sensor.ACCEL, Sensor.GYRO}
    for pair in pairs:
        assert not pair.observed[(pair.t > 30.0) & (pair.t < 30.3)].any()
        assert pair.observed.mean() > 0.8
    assert all(t.observed.all() for t in build(whole).traces if t.against is not None)
