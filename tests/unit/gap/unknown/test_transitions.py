"""Events that take time: several jumps, or a gradual one, are one event whose duration is left out."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mavcal.calib.gap.diagnose import diagnose
from mavcal.calib.gap.effects import catalogue
from mavcal.calib.gap.model.hypotheses import Hypothesis
from mavcal.calib.gap.model.joint import (
    Joint,
    NoiseTerm,
    Term,
    jacobian,
    normal_equations,
    setting_of,
    with_residual,
)
from mavcal.calib.gap.model.noise_fit import FittedNoise, model_without_effects
from mavcal.calib.gap.model.normal_equations import solved
from mavcal.calib.gap.model.views import views_of
from mavcal.calib.gap.schema import GapVerdict
from mavcal.calib.gap.search.selection import ChosenModel
from mavcal.calib.gap.telling.estimates import estimates_of
from mavcal.calib.gap.unknown.transitions import JumpSpan, level_mismatch, transient_events, transitions
from mavcal.calib.recording import Sensor
from tests.unit.gap.synthetic import problem_of

ON_S, OFF_S = 10.0, 28.0
SIZE = np.array([0.5, -0.2, 1.5])


def put_on(trace):
    """Something is brought near over 0.8 s and taken away over 0.4 s, wobbling."""
    up = np.clip((trace.t - ON_S) / 0.8, 0.0, 1.0)
    down = np.clip((trace.t - OFF_S) / 0.4, 0.0, 1.0)
    wobble = np.sin(2.0 * np.pi * (trace.t - ON_S)) * ((up > 0.0) & (up < 1.0))
    return np.outer(up - down, SIZE) + 0.2 * np.outer(wobble, SIZE[::-1])


@pytest.mark.long
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
    for found, start, end in ((on, ON_S, ON_S + 0.8), (off, OFF_S, OFF_S + 0.4)):
        low, high = found["time_s"].ci95
        assert low < start < end < high  # whenever in the time that was left out
        assert high - low < 3.0


@pytest.mark.long
@pytest.mark.parametrize("at", [10.01, 10.019, 20.003])
def test_the_moment_of_a_jump_is_no_surer_than_the_samples_beside_it(at):
    def jump(trace):
        return np.outer(trace.t > at, SIZE)

    report = diagnose(problem_of(np.random.default_rng(6), (Sensor.ACCEL,), jump), nested=False)
    (effect,) = report.effects
    low, high = next(p.ci95 for p in effect.params if p.name == "time_s")
    assert low < at < high < low + 0.03


@pytest.mark.long
def test_instances_that_jump_together_by_different_sizes_leave_nothing_out():
    def both(truth, _sensor):
        return np.outer(truth["t"] > ON_S, SIZE)

    def one(trace):
        return np.outer(trace.t > ON_S, -0.4 * SIZE[::-1])

    rng = np.random.default_rng(7)
    report = diagnose(problem_of(rng, (Sensor.ACCEL,), one, instances=2, only=1, error=both), nested=False)
    assert [e.id for e in report.effects] == ["accel_step"] * 2
    for effect in report.effects:
        found = {p.name: p for p in effect.params}
        assert found["time_s"].value == pytest.approx(ON_S, abs=0.025)
        assert max(found[f"step.{axis}"].se for axis in "xyz") < 0.02


def approached(trace, size=SIZE):
    """On at once, but brought to its place over the next second and a half: the level is reached late."""
    settling = np.clip(1.0 - (trace.t - ON_S) / 1.5, 0.0, 1.0) * (trace.t > ON_S)
    return np.outer(trace.t > ON_S, size) - 0.4 * np.outer(settling, size[::-1])


def stepped(gap, at=ON_S, size=SIZE):
    """A model that holds a gap for a single jump of that size."""
    problem = problem_of(np.random.default_rng(5), (Sensor.ACCEL,), gap)
    setting = setting_of(views_of(problem, {}, {}))
    step = next(e for e in catalogue() if e.id == "accel_step" and not e.form)
    term = Term(Hypothesis(step, (0,)), np.array(size), at)
    bare = model_without_effects(setting)
    return with_residual(dataclasses.replace(bare, terms=(term,)))


def test_a_level_that_is_reached_late_is_a_transition_although_one_jump_was_found():
    (found,) = transitions(stepped(approached))
    assert found.start <= ON_S
    assert ON_S + 1.2 < found.end < ON_S + 3.0
    assert transitions(stepped(lambda trace: np.outer(trace.t > ON_S, SIZE))) == ()


@pytest.mark.parametrize("late", np.arange(12) / 50.0)
def test_readings_beside_a_jump_are_seen_whenever_it_is(late):
    """At 50 Hz a window has 12 samples: wherever the jump falls among them."""

    def gradual(trace):
        return np.outer(np.clip((trace.t - ON_S - late + 0.15) / 0.4, 0.0, 1.0), SIZE)

    def sudden(trace):
        return np.outer(trace.t > ON_S + late, SIZE)

    (found,) = transitions(stepped(gradual, ON_S + late))
    assert found.end > ON_S + late + 0.25
    for off in (-0.02, 0.0, 0.02):
        assert transitions(stepped(sudden, ON_S + late + off)) == ()


@pytest.mark.parametrize(("apart", "events"), [(0.0, 0), (0.01, 0), (0.029, 0), (0.4, 1)])
def test_jumps_within_a_sample_and_a_half_are_one_moment(apart, events):
    """Two instances whose jumps are fitted each by its own samples: at 50 Hz the same one up to 0.03 s."""

    def both(truth, _sensor):
        return np.outer(truth["t"] > ON_S, SIZE)

    problem = problem_of(np.random.default_rng(8), (Sensor.ACCEL,), instances=2, error=both)
    setting = setting_of(views_of(problem, {}, {}))
    step = next(e for e in catalogue() if e.id == "accel_step" and not e.form)
    terms = tuple(Term(Hypothesis(step, (i,)), SIZE, ON_S + i * apart) for i in (0, 1))
    bare = model_without_effects(setting)
    model = with_residual(dataclasses.replace(bare, terms=terms))
    assert len(transitions(model)) == events
    if not events:
        assert all((level_mismatch(model, term) < 0.05).all() for term in terms)


def test_a_step_between_levels_that_do_not_fit_it_is_no_surer_than_they_differ():
    def jump(trace):
        return np.outer(trace.t > ON_S, SIZE)

    right, wrong = stepped(jump), stepped(jump, size=SIZE + np.array([0.3, 0.0, 0.0]))
    assert level_mismatch(right, right.terms[0]).max() < 0.03
    assert level_mismatch(wrong, wrong.terms[0])[0] == pytest.approx(0.3, abs=0.03)
    start = dataclasses.replace(wrong, terms=())
    chosen = ChosenModel(wrong, _joint(wrong), FittedNoise(start, {}), (), 1, (), start)
    errors = [p.se for p in estimates_of(chosen, wrong.terms[0])]
    assert errors[0] == pytest.approx(0.3, abs=0.03)
    assert max(errors[1:3]) < 0.02


def _joint(model):
    normal = normal_equations([jacobian(t, model.setting) for t in model.terms], model.y, model.weight)
    return Joint(solved(normal.gram, normal.right)[1], normal.slices, normal)


@pytest.mark.long
def test_a_jump_is_no_event_that_takes_time():
    def jump(trace):
        return np.outer(trace.t > ON_S, 0.2 * SIZE)

    problem = problem_of(np.random.default_rng(3), (Sensor.ACCEL,), jump)
    (effect,) = diagnose(problem, nested=False).effects
    assert effect.id == "accel_step"
    assert {p.name: p.value for p in effect.params}["time_s"] == pytest.approx(ON_S, abs=0.05)


def passed_by(trace):
    """Iron goes past within two seconds, and nothing stays."""
    return np.outer(np.exp(-0.5 * ((trace.t - 20.0) / 0.5) ** 2), SIZE)


@pytest.mark.long
def test_what_passes_by_is_not_forgotten_with_its_samples():
    problem = problem_of(np.random.default_rng(4), (Sensor.ACCEL,), passed_by)
    report = diagnose(problem, nested=False)
    assert report.unknown.flag
    assert "passes on accel" in report.unknown.shape
    assert not any(e.id == "accel_step" for e in report.effects)
    assert report.verdict is GapVerdict.UNKNOWN


@pytest.mark.parametrize(("gain", "says"), [(0.0, 1), (150.0, 1), (250.0, 0)])
def test_jumps_that_became_a_walk_are_nothing_that_passes(gain, says):
    """A walk that replaces two jumps says more than they did; a weaker one does not."""
    problem = problem_of(np.random.default_rng(4), (Sensor.GYRO,))
    setting = setting_of(views_of(problem, {}, {}))
    walk = Hypothesis(next(e for e in catalogue() if e.id == "gyro_random_walk"), (0,))
    model = model_without_effects(setting)
    left_out = (JumpSpan(Sensor.GYRO, 10.0, 12.0, nats=100.0),)
    assert len(transient_events(left_out, model)) == 1
    model = dataclasses.replace(model, noise_terms=(NoiseTerm(walk, np.nan),))
    assert len(transient_events(left_out, model, {walk.key: gain})) == says
    assert len(transient_events((dataclasses.replace(left_out[0], sensor=Sensor.MAG),), model, {walk.key: gain})) == 1


def test_changes_that_overlap_are_said_once():
    problem = problem_of(np.random.default_rng(4), (Sensor.GYRO,))
    setting = setting_of(views_of(problem, {}, {}))
    model = model_without_effects(setting)
    spans = [(Sensor.MAG, 33.8, 39.3), (Sensor.MAG, 143.1, 147.3), (Sensor.MAG, 33.0, 39.1), (Sensor.ACCEL, 38.0, 40.0)]
    left_out = tuple(JumpSpan(sensor, start, end, nats=10.0) for sensor, start, end in spans)
    said = [(one.sensor, one.start, one.end, one.nats) for one in transient_events(left_out, model)]
    assert said == [
        (Sensor.ACCEL, 38.0, 40.0, 10.0),
        (Sensor.MAG, 33.0, 39.3, 20.0),
        (Sensor.MAG, 143.1, 147.3, 10.0),
    ]
