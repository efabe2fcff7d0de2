"""Whose samples show something: of instances with a reference, and of those that only others are a reference for."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mavcal.calib.gap.diagnose import diagnose
from mavcal.calib.gap.effects import by_id, catalogue
from mavcal.calib.gap.effects.base import LatticeEffect
from mavcal.calib.gap.problem import GapProblem, ReferenceInfo, ReferenceKind
from mavcal.calib.gap.search.lattice_effects import covered_by, lattice_of
from mavcal.calib.recording import Sensor
from tests.unit.gap.synthetic import SIGMA, problem_of

G = Sensor.GYRO
STEP = 4.0 * SIGMA[G]


def rounded(trace, step=STEP):
    return dataclasses.replace(trace, measured=np.round(trace.measured / step) * step)


def singles(coarse=(), count=2, seed=1):
    """Instances against a simulator's reference, those of `coarse` on levels."""
    traces = problem_of(np.random.default_rng(seed), (G,), instances=count).traces
    return [rounded(t) if t.instances[0] in coarse else t for t in traces]


def held(one, other):
    """`one` against the reading of the `other`."""
    return dataclasses.replace(one, ideal=other.measured, against=other.instances[0])


def of(*traces):
    return GapProblem(traces, ReferenceInfo(ReferenceKind.REDUNDANT), 40.0)


def named(lattice):
    return [(e.id, e.instances) for e in lattice.effects]


@pytest.mark.parametrize("coarser", [0, 1])
def test_of_a_difference_alone_the_coarser_instance_is_found_once(coarser):
    one, other = singles(coarse=(coarser,))
    lattice = lattice_of(of(held(one, other)), catalogue())
    assert named(lattice) == [("gyro_quantisation", (coarser + 1,))]
    (found,) = lattice.effects
    assert [p.value for p in found.params] == pytest.approx([STEP] * 3)
    assert lattice.variance == {0: pytest.approx(STEP**2 / 12.0)}


@pytest.mark.parametrize("coarser", [0, 1])
def test_of_two_on_levels_it_is_the_coarser_one(coarser):
    one, other = singles()
    steps = [STEP, STEP]
    steps[coarser] *= 3.0
    pair = held(rounded(one, steps[0]), rounded(other, steps[1]))
    assert named(lattice_of(of(pair), catalogue())) == [("gyro_quantisation", (coarser + 1,))]


def test_a_base_that_several_are_held_against_is_found_once():
    *others, base = singles(coarse=(2,), count=3)
    lattice = lattice_of(of(*(held(t, base) for t in others)), catalogue())
    assert named(lattice) == [("gyro_quantisation", (3,))]


@pytest.mark.parametrize("coarser", [0, 1])
def test_an_instance_with_a_reference_is_not_found_again_in_a_difference(coarser):
    one, other = singles(coarse=(coarser,))
    lattice = lattice_of(of(one, other, held(one, other)), catalogue())
    assert named(lattice) == [("gyro_quantisation", (coarser + 1,))]
    assert list(lattice.variance) == [coarser]


def looked_at(*traces):
    """Instances, what they are compared with, and whether it is they that are measured, as detectors see them."""
    seen = []

    def detect(trace):
        seen.append((trace.instances[0], trace.against, trace.measured))

    lattice_of(of(*traces), [LatticeEffect("gyro_probe", G, (), "", "", detect=detect)])
    return seen


def test_every_instance_is_looked_at_once_against_the_best_that_it_has():
    zero, one, two = singles(count=3)
    readings = [t.measured for t in (zero, one, two)]

    def seen(*traces):
        found = looked_at(*traces)
        assert all(measured is readings[i] for i, _, measured in found)
        return [(i, against) for i, against, _ in found]

    assert seen(held(zero, one)) == [(0, 1), (1, 0)]
    assert seen(held(zero, two), held(one, two)) == [(0, 2), (2, 0), (1, 2)]
    assert seen(zero, one, held(zero, one)) == [(0, None), (1, None)]
    assert seen(held(one, zero), zero) == [(1, 0), (0, None)]


def saturated(trace):
    """At half of the range, on one axis."""
    limit = np.array([0.5 * float(np.abs(trace.ideal[:, 0]).max()), np.inf, np.inf])
    return dataclasses.replace(trace, measured=np.clip(trace.measured, -limit, limit))


def estimate(lattice, effect_id, instances):
    return dataclasses.replace(lattice.effects[0], id=effect_id, sensor=by_id()[effect_id].sensor, instances=instances)


def test_what_the_samples_show_is_not_shown_again_by_the_contest():
    one, other = singles(coarse=(0,))
    lattice = lattice_of(of(one, saturated(other)), catalogue())
    assert named(lattice) == [("gyro_quantisation", (1,)), ("gyro_saturation", (2,))]

    def again(effect_id, instances):
        return covered_by(lattice, estimate(lattice, effect_id, instances))

    assert again("gyro_dead_band", (1,))  # one of the levels is at zero
    assert not again("gyro_dead_band", (2,))
    assert not again("gyro_dead_band", (1, 2))
    assert not again("accel_dead_band", (1,))
    assert again("gyro_saturation", (2,))
    assert not again("gyro_saturation", (1,))
    assert not again("gyro_bias", (1,))
    assert not covered_by(lattice_of(of(*singles()), catalogue()), estimate(lattice, "gyro_dead_band", (1,)))


def test_a_dead_band_that_the_contest_sees_in_coarse_levels_is_not_reported_beside_them():
    report = diagnose(of(rounded(singles()[0], 30.0 * SIGMA[G])), nested=False)
    assert [(e.id, e.instances) for e in report.effects] == [("gyro_quantisation", (1,))]


def test_coarse_levels_are_no_dead_band_beside():
    band = np.where(np.abs(singles()[0].measured) < STEP, 0.0, singles()[0].measured)
    trace = dataclasses.replace(singles()[0], measured=band)
    lattice = lattice_of(of(trace), catalogue())
    assert named(lattice) == [("gyro_dead_band", (1,))]
    assert covered_by(lattice, lattice.effects[0])
    assert not covered_by(lattice, estimate(lattice, "gyro_quantisation", (1,)))
