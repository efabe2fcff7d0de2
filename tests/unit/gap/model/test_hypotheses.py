"""What competes, and at which handicap where it is rather another instance that has something."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mavcal.calib.gap.effects import by_id, forward_models
from mavcal.calib.gap.model.hypotheses import Hypothesis, hypotheses_of
from mavcal.calib.gap.model.views import views_of
from mavcal.calib.gap.problem import FaultyInstances, ReferenceInfo, ReferenceKind
from mavcal.calib.recording import Sensor
from tests.unit.gap.synthetic import problem_of

SLOW_AND_FAST = FaultyInstances(slow=(0,), fast=(0, 1))
SETS = ((0,), (1,), (0, 1))


def handicapped(effect_id, worse, *, sensors=(Sensor.GYRO,), kind=ReferenceKind.SIM):
    """The sets of instances on which an effect has a handicap, of all that it can sit on; it is one and the same."""
    problem = problem_of(np.random.default_rng(1), sensors, instances=2, reference=ReferenceInfo(kind))
    tested, missing = hypotheses_of(forward_models()[effect_id], views_of(problem, {}, {}), worse)
    assert not missing
    assert {h.instances for h in tested} == set(SETS)
    assert len({h.handicap for h in tested} - {0.0}) <= 1
    assert all(h.handicap >= 0.0 for h in tested)
    return {h.instances for h in tested if h.handicap}


@pytest.mark.parametrize("kind", [ReferenceKind.SIM, ReferenceKind.ESTIMATOR])
@pytest.mark.parametrize(
    ("effect_id", "elsewhere"),
    [
        ("gyro_bias", {(1,)}),  # both of them add nothing to the difference
        ("gyro_scale", {(1,)}),
        ("gyro_step", {(1,)}),
        ("gyro_noise", {(0,), (1,)}),
        ("gyro_random_walk", {(1,), (0, 1)}),  # noise, and slow
        ("gyro_flicker", {(1,), (0, 1)}),
        ("gyro_tone", set()),  # a fast mean: one alone is not what two are
    ],
)
def test_another_instance_than_the_one_that_has_something_has_the_handicap(effect_id, elsewhere, kind):
    assert handicapped(effect_id, {Sensor.GYRO: SLOW_AND_FAST}, kind=kind) == elsewhere


@pytest.mark.parametrize("effect_id", ["gyro_bias", "gyro_noise", "gyro_tone", "gyro_random_walk"])
def test_where_nothing_says_which_nobody_has_a_handicap(effect_id):
    assert handicapped(effect_id, None) == set()
    assert handicapped(effect_id, {}) == set()
    assert handicapped(effect_id, {Sensor.ACCEL: SLOW_AND_FAST}) == set()
    assert handicapped(effect_id, {Sensor.GYRO: FaultyInstances()}) == set()


@pytest.mark.parametrize(
    ("effect_id", "elsewhere"),
    [
        ("gyro_tone", {(0,)}),
        ("gyro_noise", {(0,), (0, 1)}),
        ("gyro_random_walk", {(0,), (0, 1)}),
        ("gyro_bias", set()),
        ("gyro_scale", set()),  # it goes with the movement, that of both
    ],
)
def test_fast_bands_speak_of_noise_and_tones_alone(effect_id, elsewhere):
    assert handicapped(effect_id, {Sensor.GYRO: FaultyInstances(fast=(1,))}) == elsewhere


@pytest.mark.parametrize(
    ("effect_id", "elsewhere"), [("gyro_tone", set()), ("gyro_noise", set()), ("gyro_bias", {(0,)})]
)
def test_slow_bands_do_not_speak_for_fast_ones(effect_id, elsewhere):
    assert handicapped(effect_id, {Sensor.GYRO: FaultyInstances(slow=(1,))}) == elsewhere


@pytest.mark.parametrize("count", [1, 2, 3])
def test_an_earth_that_only_one_compass_sees_is_no_earth(count):
    problem = problem_of(np.random.default_rng(1), (Sensor.MAG,), instances=count)
    tested, _ = hypotheses_of([by_id()["mag_earth_field"]], views_of(problem, {}, {}))
    assert [h.instances for h in tested] == [tuple(range(count))]


def test_every_repetition_of_an_effect_has_the_same_handicap():
    problem = problem_of(np.random.default_rng(1), (Sensor.GYRO,), instances=2)
    tested, _ = hypotheses_of([by_id()["gyro_step"]], views_of(problem, {}, {}), {Sensor.GYRO: SLOW_AND_FAST})
    of_other = [h.handicap for h in tested if h.instances == (1,)]
    assert len(of_other) > 1
    assert len(set(of_other)) == 1
    assert of_other[0] > 0.0


def test_what_all_sensors_share_is_on_no_instance():
    problem = problem_of(np.random.default_rng(1), (Sensor.ACCEL, Sensor.GYRO), instances=2)
    shared = [e for forms in forward_models().values() for e in forms if e.shared]
    shared.append(dataclasses.replace(by_id()["gyro_noise"], shared=True))
    worse = dict.fromkeys((Sensor.ACCEL, Sensor.GYRO, Sensor.MAG), FaultyInstances(slow=(0,), fast=(0,)))
    tested, _ = hypotheses_of(shared, views_of(problem, {}, {}), worse)
    assert len(tested) == len(shared)
    assert not any(h.handicap for h in tested)


@pytest.mark.parametrize(
    ("effect_id", "worse", "loud"),
    [
        ("gyro_noise", SLOW_AND_FAST, {(0,): False, (1,): False, (0, 1): True}),
        ("gyro_rotor_noise", FaultyInstances(fast=(1,)), {(0,): False, (1,): True, (0, 1): False}),
        ("gyro_noise", FaultyInstances(slow=(0,)), dict.fromkeys(SETS)),
        ("gyro_random_walk", SLOW_AND_FAST, dict.fromkeys(SETS)),
        ("accel_noise", SLOW_AND_FAST, dict.fromkeys(SETS)),
    ],
)
def test_noise_of_the_gyroscope_that_drives_a_trajectory_is_told_by_both_units_alone(effect_id, worse, loud):
    sensors = (Sensor.ACCEL, Sensor.GYRO)
    problem = problem_of(np.random.default_rng(1), sensors, instances=2)
    by_sensor = dict.fromkeys(sensors, worse)
    tested, _ = hypotheses_of(forward_models()[effect_id], views_of(problem, {}, {}), by_sensor)
    assert {h.instances: h.loud for h in tested} == loud


def test_what_happens_once_is_described_by_another_form_of_it():
    wave, noise = sorted(forward_models()["accel_vibration"], key=lambda effect: not effect.form)
    late, throttle = (e for e in forward_models()["mag_motor_current"] if e.form)
    there = [Hypothesis(wave, (0,), again=1), Hypothesis(late, (0, 1))]
    assert Hypothesis(noise, (0,)).is_covered_by(there)
    assert Hypothesis(throttle, (0, 1)).is_covered_by(there)
    assert not Hypothesis(noise, (1,)).is_covered_by(there)
    assert not Hypothesis(wave, (0,)).is_covered_by(there)  # it can happen again
    assert not Hypothesis(by_id()["accel_noise"], (0,)).is_covered_by(there)


def test_one_error_of_both_units_is_not_observable_in_their_difference():
    """Both gyroscopes of a vehicle without a trajectory were 52 ms late: equal delays cancel in what they differ by."""
    problem = problem_of(np.random.default_rng(1), (Sensor.GYRO,), instances=2)
    own = views_of(problem, {}, {})[0]
    apart = dataclasses.replace(own, weights={0: 1.0, 1: -1.0})
    delay, noise = by_id()["gyro_delay"], by_id()["gyro_noise"]
    first, second = (Hypothesis(delay, (k,)) for k in (0, 1))
    assert second.is_unobservable_beside([first], [apart])
    assert not second.is_unobservable_beside([], [apart])
    assert not second.is_unobservable_beside([Hypothesis(by_id()["gyro_scale"], (0,))], [apart])
    assert not Hypothesis(noise, (1,)).is_unobservable_beside([Hypothesis(noise, (0,))], [apart])
    step = by_id()["gyro_step"]
    assert not Hypothesis(step, (1,)).is_unobservable_beside([Hypothesis(step, (0,))], [apart])
    assert not second.is_unobservable_beside([first], [apart, own])
    third = dataclasses.replace(own, weights={0: 0.5, 1: 0.5, 2: -1.0})
    assert not second.is_unobservable_beside([first], [third])
