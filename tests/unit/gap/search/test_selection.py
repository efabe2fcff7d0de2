"""Which of two causes that explain nearly the same is believed."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from mavcal.calib.gap.diagnose import _setup_of, diagnose
from mavcal.calib.gap.effects import catalogue, forward_models
from mavcal.calib.gap.model.hypotheses import Hypothesis
from mavcal.calib.gap.model.joint import NoiseTerm
from mavcal.calib.gap.problem import MinimumGain
from mavcal.calib.gap.search import prices
from mavcal.calib.gap.search.contest import Contest, ContestScore
from mavcal.calib.gap.search.exchange import (
    Alternative,
    Comparison,
    _after_best_exchange,
    evidence_deficit,
    stable_model,
)
from mavcal.calib.gap.search.projection import Projection
from mavcal.calib.gap.search.selection import (
    _better_by_sensor,
    _merged_by_sensor,
    _second_order_limit,
    _sensor_objective,
    extended,
    objective,
    select,
)
from mavcal.calib.gap.search.terms import without_effect
from mavcal.calib.gap.search.thresholds import GainThresholds
from mavcal.calib.gap.worth.attribution import attributions
from mavcal.calib.recording import Sensor
from tests.unit.gap.synthetic import SIGMA, problem_of


def scored(delta, df, effect="accel_bias"):
    hypothesis = Hypothesis(forward_models()[effect][-1], (0,))
    return ContestScore(hypothesis, math.nan, delta, df, 1, 0.0, delta, np.zeros(df))


THREE, NINE = (False, False, 3), (False, False, 9)


def test_of_causes_that_differ_by_a_second_order_the_one_with_fewer_numbers_is_believed():
    own, second = 1e6, prices.FLIGHT_SECOND_ORDER_SHARE * 1e6
    assert evidence_deficit(own, scored(own + 0.9 * second, 9), THREE, second) > 0.0
    assert evidence_deficit(own, scored(own + 1.1 * second, 9), THREE, second) < 0.0
    assert evidence_deficit(own, scored(own - 0.05 * second, 3), NINE, second) < 0.0
    assert evidence_deficit(own, scored(own - 0.2 * second, 3), NINE, second) > 0.0
    assert evidence_deficit(own, scored(own + 1.0, 9), THREE, 0.0) == pytest.approx(-1.0)
    for alike in (THREE, None):
        assert evidence_deficit(own, scored(own + 0.5 * second, 3), alike, second) == pytest.approx(-0.5 * second)


def test_noise_that_wanders_is_freer_than_any_number_of_amplitudes():
    own, second = 1e6, prices.FLIGHT_SECOND_ORDER_SHARE * 1e6
    assert evidence_deficit(own, scored(own + 0.5 * second, 1, "accel_random_walk"), NINE, second) > 0.0
    assert evidence_deficit(own, scored(own - 0.05 * second, 9), (True, False, 1), second) < 0.0
    assert evidence_deficit(own, scored(own + 1.0, 1, "accel_random_walk"), (True, False, 1), second) == pytest.approx(
        -1.0
    )


def test_a_name_goes_before_a_shape_that_is_better_by_a_second_order():
    """A scale about one axis of a gyroscope was "the product of a_z and w_z", which has one number for its three."""
    own, second = 1e6, prices.FLIGHT_SECOND_ORDER_SHARE * 1e6
    shape = unnamed(scored(own + 0.5 * second, 1))
    assert evidence_deficit(own, shape, THREE, second) > 0.0
    assert evidence_deficit(own, scored(own - 0.05 * second, 3), (False, True, 1), second) < 0.0


def unnamed(score):
    effect = dataclasses.replace(score.hypothesis.effect, family="one product")
    return dataclasses.replace(score, hypothesis=dataclasses.replace(score.hypothesis, effect=effect))


A, G = Sensor.ACCEL, Sensor.GYRO
FEW = {"accel_bias", "accel_random_walk", "gyro_temp_linear", "gyro_random_walk"}


def walking_and_warm(trace):
    """An accelerometer that walks, a gyroscope that follows its temperature."""
    if trace.sensor is A:
        return np.cumsum(0.3 * SIGMA[A] * np.random.default_rng(4).normal(size=trace.ideal.shape), axis=0)
    return np.outer(trace.temperature - 25.0, 0.3 * SIGMA[G] * np.array([1.0, -0.7, 0.4]))


def paths():
    """The models of steady effects alone, of drifts alone, and what the contest makes of both."""
    problem = problem_of(np.random.default_rng(3), (A, G), walking_and_warm)
    task = _setup_of(problem, tuple(e for e in catalogue() if e.id in FEW))
    bare = select(task.bare, Contest(()), 0.005)
    steady, drifts = (
        extended(bare, task.contest, 1e-4, [h for h in task.contest.hypotheses if h.effect.id.endswith(ends)])
        for ends in (("_bias", "_linear"), ("_walk",))
    )
    return task, steady, drifts


def ids(chosen):
    return {t.hypothesis.effect.id for t in chosen.model.members}


def test_sensor_by_sensor_the_better_of_two_models_is_taken():
    task, steady, drifts = paths()
    both = _better_by_sensor(steady, drifts, task.contest)
    assert ids(both) == {"accel_random_walk", "gyro_temp_linear"}
    assert _sensor_objective(both, A) == pytest.approx(_sensor_objective(drifts, A), abs=1.0)
    assert _sensor_objective(both, G) == pytest.approx(_sensor_objective(steady, G), abs=1.0)
    assert ids(_merged_by_sensor(steady, drifts, {A, G})) == ids(drifts)


def test_a_model_is_judged_by_what_its_sensors_are_and_by_how_many_effects_it_has():
    _, steady, drifts = paths()
    for chosen in (steady, drifts):
        assert objective(chosen) == pytest.approx(_sensor_objective(chosen, A) + _sensor_objective(chosen, G))
    halves = [dataclasses.replace(s, gain=s.gain / 2, delta=s.delta / 2) for s in steady.scores for _ in range(2)]
    assert sum(h.price for h in halves) == pytest.approx(sum(s.price for s in steady.scores))
    assert objective(dataclasses.replace(steady, scores=tuple(halves))) > objective(steady) + 5.0


def test_a_mean_is_no_second_order_of_what_shakes():
    task, steady, _ = paths()
    warm = next(h for h in task.contest.hypotheses if h.effect.id == "gyro_temp_linear")
    bias = next(h for h in task.contest.hypotheses if h.effect.id == "accel_bias")
    gains = {t.hypothesis.key: (1e6, 3, 1) for t in steady.model.members}
    assert _second_order_limit(warm, steady.model, gains) > 1e3
    shaken = NoiseTerm(Hypothesis(forward_models()["accel_vibration"][-1], (0,)), 10.0)
    alone = dataclasses.replace(steady.model, terms=(), noise_terms=(shaken,))
    assert _second_order_limit(bias, alone, {shaken.hypothesis.key: (1e6, 3, 1)}) < 1e3
    noise = Hypothesis(forward_models()["accel_noise"][-1], (0,))
    assert _second_order_limit(noise, alone, {shaken.hypothesis.key: (1e6, 3, 1)}) > 1e3


@pytest.mark.parametrize("honest", [True, False])
def test_an_exchange_that_does_not_keep_its_promise_is_taken_back(honest):
    """A rival is scored beside the others as they are fitted; its score must still hold once all are fitted again."""
    task, _, drifts = paths()
    keys = {t.hypothesis.effect.id: t.hypothesis.key for t in drifts.model.members}
    rivals = {h.effect.id: h for h in task.contest.hypotheses}
    own, promised = (
        (keys["gyro_random_walk"], "gyro_temp_linear") if honest else (keys["accel_random_walk"], "accel_bias")
    )
    beside = Projection(without_effect(drifts.model, own))
    kept = task.contest.score(rivals[promised], beside)
    score = dataclasses.replace(kept, gain=kept.gain + 1e6, delta=kept.delta + 1e6, p=0.0)
    only = task.contest.restricted_to([rivals[promised]])
    other = _after_best_exchange(drifts, {own: Comparison((Alternative(score, 0.0),), 10.0)}, 1e-4, only)
    assert (other is not None) is honest
    if other is not None:
        assert promised in ids(other)


def test_what_is_known_of_other_places_says_what_looking_again_would():
    """An exchange is looked at beside its own sensors, and a contest with more hypotheses at those it did not have."""
    task, _, drifts = paths()
    found = stable_model(drifts, task.contest, 1e-3)
    assert ids(found.chosen) == {"accel_random_walk", "gyro_temp_linear"}
    half = task.contest.restricted_to([h for h in task.contest.hypotheses if not h.effect.id.endswith("_bias")])
    more = stable_model(found.chosen, task.contest, 1e-3, stable_model(found.chosen, half, 1e-3))
    again = stable_model(found.chosen, task.contest, 1e-3)
    expected = attributions(again, task.contest)
    for one in (found, more):
        for a, b in zip(attributions(one, task.contest), expected, strict=True):
            assert a.key == b.key
            assert a.probability == pytest.approx(b.probability, abs=1e-9)
            assert [r.id for r in a.rivals] == [r.id for r in b.rivals]


@pytest.mark.long
def test_what_one_compass_has_is_no_second_order_of_what_all_have():
    """The motors' field of 200 uT on all compasses hid 2.5 uT of one, which the others show exactly."""
    problem = problem_of(
        np.random.default_rng(5), (Sensor.MAG,), lambda t: np.outer(t.current, [10.0, -6.0, 3.0]), instances=3
    )
    traces = tuple(
        dataclasses.replace(t, measured=t.measured - (np.array([2.5, 0.0, 0.0]) if t.instances == (0,) else 0.0))
        for t in problem.traces
    )
    few = tuple(e for e in catalogue() if e.id in ("mag_motor_current", "mag_hard_iron"))
    report = diagnose(dataclasses.replace(problem, traces=traces), effects=few, nested=False)
    assert {(e.id, e.instances) for e in report.effects} == {("mag_motor_current", (1, 2, 3)), ("mag_hard_iron", (1,))}


@pytest.mark.parametrize(("least", "found"), [(1e3, {"accel_bias"}), (3e3, {"accel_bias"}), (1e4, set())])
def test_a_mean_that_the_noise_hid_enters_by_what_it_is_worth_and_no_drift_takes_its_place(least, found):
    """Learned noise whose level is a parameter holds an offset: it gains 2000, and 9000 once the noise is fitted."""
    problem = problem_of(np.random.default_rng(1), (A,), lambda _: np.array([0.0, 0.0, 10.0 * SIGMA[A]]))
    traces = tuple(dataclasses.replace(trace, sigma_dof=50.0) for trace in problem.traces)
    few = {"accel_bias", "accel_scale", "accel_flicker", "accel_noise"}
    task = _setup_of(dataclasses.replace(problem, traces=traces), tuple(e for e in catalogue() if e.id in few))
    all_alike = {A: least}
    thresholds = GainThresholds(MinimumGain(all_alike, all_alike, all_alike, all_alike, drift_entry=all_alike))
    assert ids(select(task.bare, Contest(task.contest.hypotheses, thresholds=thresholds), 0.005)) == found


def test_what_the_noise_hides_and_is_worth_too_little_keeps_no_other_sensor_out():
    def gap(trace):
        return np.array([0.0, 0.0, (10.0 if trace.sensor is A else 0.3) * SIGMA[trace.sensor]])

    problem = problem_of(np.random.default_rng(1), (A, G), gap)
    traces = tuple(dataclasses.replace(t, sigma_dof=50.0) for t in problem.traces)
    few = {"accel_bias", "accel_scale", "gyro_bias"}
    task = _setup_of(dataclasses.replace(problem, traces=traces), tuple(e for e in catalogue() if e.id in few))
    thresholds = GainThresholds(MinimumGain(steady_entry={A: 1e5}, level={A: 1e5}))
    assert ids(select(task.bare, Contest(task.contest.hypotheses, thresholds=thresholds), 0.005)) == {"gyro_bias"}
