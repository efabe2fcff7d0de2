"""A trajectory that follows an inertial unit reads its noise at rest."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mavcal.calib.gap.problem import ReferenceInfo, ReferenceKind
from mavcal.calib.gap.reference.ideal import with_unit_noise
from mavcal.calib.recording import Sensor
from tests.unit.gap.synthetic import problem_of

FOLLOWS = ReferenceInfo(ReferenceKind.SIM, bandwidth_hz=2.0, turns_hz=20.0)
NOISE = 2e-3


def trace_of(sensor=Sensor.GYRO):
    """Five seconds of rest, and then the movement."""
    rng = np.random.default_rng(2)
    trace = problem_of(rng, (sensor,)).traces[0]
    ideal = trace.ideal.copy()
    ideal[: round(5.0 * trace.fs)] = 0.0
    return dataclasses.replace(trace, ideal=ideal + NOISE * rng.standard_normal(ideal.shape))


def test_the_quietest_second_tells_the_noise_of_the_unit_inside():
    assert with_unit_noise(trace_of(), FOLLOWS).unit_sd == pytest.approx(NOISE, rel=0.2)


def test_a_hole_in_the_recording_is_no_rest():
    """The values that fill a hole are constant, so they do not count as a quiet second."""
    trace = trace_of()
    hole = (trace.t > 2.0) & (trace.t < 4.5)
    filled = dataclasses.replace(
        trace, ideal=np.where(hole[:, None], 0.0, trace.ideal), observed=trace.observed & ~hole
    )
    assert with_unit_noise(filled, FOLLOWS).unit_sd == pytest.approx(NOISE, rel=0.2)
    nowhere = dataclasses.replace(trace, observed=np.zeros_like(trace.observed))
    assert with_unit_noise(nowhere, FOLLOWS) is nowhere


@pytest.mark.parametrize(
    ("trace", "reference"),
    [
        (trace_of(), ReferenceInfo(ReferenceKind.SIM)),
        (trace_of(Sensor.MAG), FOLLOWS),
        (dataclasses.replace(trace_of(), against=1), FOLLOWS),
    ],
    ids=["exact", "compass", "difference"],
)
def test_no_unit_is_inside(trace, reference):
    assert with_unit_noise(trace, reference) is trace
