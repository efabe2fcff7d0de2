"""Events that take time: several jumps, or a gradual one, are one event whose duration is left out."""

from __future__ import annotations

import numpy as np
import pytest

from calib.gap.diagnose import diagnose
from calib.recording import Sensor
from tests.unit.gap.synthetic import problem_of

ON_S, OFF_S = 10.0, 28.0
SIZE = np.array([0.5, -0.2, 1.5])


def put_on(trace):
    """Something is brought near over 0.8 s and taken away over 0.4 s, wobbling."""
    up = np.clip((trace.t - ON_S) / 0.8, 0.0, 1.0)
    down = np.clip((trace.t - OFF_S) / 0.4, 0.0, 1.0)
    wobble = np.sin(2.0 * np.pi * (trace.t - ON_S)) * ((up > 0.0) & (up < 1.0))
    return np.outer(up - down, SIZE) + 0.2 * np.outer(wobble, SIZE[::-1])


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_levels_before_and_after_give_the_size(seed):
    problem = problem_of(np.random.default_rng(seed), (Sensor.ACCEL,), put_on)
    report = diagnose(problem, nested=False)
    assert {e.id for e in report.effects} == {"accel_step"}
    values = [{p.name: p for p in e.params} for e in report.effects]
    on, off = sorted(values, key=lambda v: v["time_s"].value)
    for found, sign in ((on, 1.0), (off, -1.0)):
        for axis, size in zip("xyz", SIZE, strict=True):
            one = found[f"step.{axis}"]
            assert one.value == pytest.approx(sign * size, abs=4.0 * one.se)
    assert on["time_s"].value == pytest.approx(ON_S + 0.4, abs=1.5)
    assert off["time_s"].value == pytest.approx(OFF_S + 0.2, abs=1.5)


def test_a_jump_is_no_event_that_takes_time():
    def jump(trace):
        return np.outer(trace.t > ON_S, 0.2 * SIZE)

    problem = problem_of(np.random.default_rng(3), (Sensor.ACCEL,), jump)
    (effect,) = diagnose(problem, nested=False).effects
    assert effect.id == "accel_step"
    assert {p.name: p.value for p in effect.params}["time_s"] == pytest.approx(ON_S, abs=0.05)
