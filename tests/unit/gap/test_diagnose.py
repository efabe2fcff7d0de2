from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from mavcal.calib.gap.diagnose import diagnose
from mavcal.calib.gap.effects import catalogue
from mavcal.calib.gap.heldout.shrink import block_agreement
from mavcal.calib.gap.model.bands import split
from mavcal.calib.gap.model.hypotheses import hypotheses_of
from mavcal.calib.gap.model.joint import setting_of
from mavcal.calib.gap.model.noise_fit import model_without_effects, noise_fitted
from mavcal.calib.gap.model.views import views_of
from mavcal.calib.gap.problem import GapProblem, ReferenceInfo, ReferenceKind
from mavcal.calib.gap.schema import GapReport, GapVerdict, as_json
from mavcal.calib.gap.search.contest import Contest
from mavcal.calib.gap.search.selection import select
from mavcal.calib.gap.telling.estimates import estimates_of
from mavcal.calib.recording import Sensor
from tests.unit.gap.effects.conftest import make
from tests.unit.gap.synthetic import problem_of

A, G, M = Sensor.ACCEL, Sensor.GYRO, Sensor.MAG


def found(report: GapReport) -> dict[str, tuple[int, ...]]:
    return {effect.id: effect.instances for effect in report.effects}


def holds(report: GapReport, effect_id: str, truth: list[float], sd: float = 4.0) -> None:
    effect = next(e for e in report.effects if e.id == effect_id)
    values = np.array([p.value for p in effect.params[: len(truth)]])
    errors = np.array([p.se for p in effect.params[: len(truth)]])
    assert np.all(np.abs(values - truth) < sd * errors), (values, errors)


@pytest.mark.parametrize("seed", range(5))
def test_no_gap_is_found_where_there_is_none(seed):
    report = diagnose(problem_of(np.random.default_rng(seed), (A, G, M)), nested=False)
    assert report.verdict is GapVerdict.NO_GAP
    assert report.effects == ()
    assert report.where == ()
    assert not report.unknown.flag


def test_two_effects_on_two_sensors_are_named_with_their_parameters():
    def gap(trace):
        if trace.sensor is M:
            return trace.current[:, None] * np.array([0.03, 0.0, -0.02])
        return np.array([0.0, 0.0015, 0.0]) if trace.sensor is G else 0.0

    report = diagnose(problem_of(np.random.default_rng(1), (A, G, M), gap))
    assert found(report) == {"mag_motor_current": (1,), "gyro_bias": (1,)}
    assert report.verdict is GapVerdict.EXPLAINED
    holds(report, "mag_motor_current", [0.03, 0.0, -0.02])
    holds(report, "gyro_bias", [0.0, 0.0015, 0.0])
    assert report.shrink is not None
    assert report.shrink.nested
    assert report.shrink.closed is not None
    assert report.shrink.closed > 0.95
    assert all(effect.gates.heldout_blocks for effect in report.effects)
    assert all(effect.gates.dose_response for effect in report.effects)
    assert {finding.channel for finding in report.where} <= {"mag.x", "mag.z", "gyro.y"}
    assert sum(effect.evidence.share for effect in report.effects) == pytest.approx(1.0)
    text = json.dumps(as_json(report), allow_nan=False)
    assert set(json.loads(text)) >= {"schema", "inputs", "verdict", "where", "effects", "unknown", "shrink"}


@pytest.mark.long
def test_bias_and_scale_together_are_not_a_random_walk():
    def gap(trace):
        return trace.ideal * np.array([0.004, -0.003, 0.0]) + np.array([0.01, 0.03, 0.0])

    report = diagnose(problem_of(np.random.default_rng(6), (A,), gap), nested=False)
    assert set(found(report)) == {"accel_bias", "accel_scale"}
    holds(report, "accel_scale", [0.004, -0.003, 0.0])


@pytest.mark.long
@pytest.mark.parametrize("seed", [11, 19, 21])
def test_two_effects_at_once_do_not_become_a_walk_because_each_alone_is_worth_less(seed):
    def gap(trace):
        return trace.ideal * np.array([0.01, 0.0, -0.01]) + np.array([0.05, -0.03, 0.02])

    report = diagnose(problem_of(np.random.default_rng(seed), (A,), gap), nested=False)
    assert set(found(report)) == {"accel_bias", "accel_scale"}


@pytest.mark.long
@pytest.mark.parametrize("seed", range(2))
def test_what_a_sensor_shows_stays_although_nobody_declared_its_noise(seed):
    problem = problem_of(np.random.default_rng(seed), (A,), lambda _trace: np.array([0.3, -0.2, 0.1]))
    quiet = tuple(dataclasses.replace(t, sigma=None) for t in problem.traces)
    report = diagnose(dataclasses.replace(problem, traces=quiet), nested=False)
    assert found(report) == {"accel_bias": (1,)}
    assert not report.unknown.flag


@pytest.mark.long
@pytest.mark.parametrize("seed", range(3))
def test_an_offset_in_hover_is_no_end_of_the_range(seed):
    trace = make(A, "hover", seconds=40.0, fs=50.0)
    noise = np.random.default_rng(seed).normal(0.0, 0.05, trace.ideal.shape)
    measured = trace.ideal + noise + np.array([0.0, 0.0, 0.1])
    trace = dataclasses.replace(trace, measured=measured, sigma=np.full(3, 0.05))
    report = diagnose(GapProblem((trace,), ReferenceInfo(ReferenceKind.SIM), 40.0), nested=False)
    assert found(report) == {"accel_bias": (1,)}


@pytest.mark.long
def test_a_wave_that_follows_a_rotor_is_found_with_its_order_beside_an_offset():
    def turns(trace):
        return 16.0 * np.sqrt(np.maximum(trace.throttle, 0.0))

    def gap(trace):
        speed = turns(trace)
        angle = 2.0 * np.pi * np.append(0.0, np.cumsum(0.5 * (speed[1:] + speed[:-1]))) / 50.0
        wave = (speed / speed.mean()) ** 2 * np.cos(angle)
        return np.outer(wave, [0.05, 0.02, -0.03]) + np.array([0.05, -0.03, 0.02])

    problem = problem_of(np.random.default_rng(2), (A,), gap)
    known = tuple(dataclasses.replace(t, rotor_hz=turns(t)[:, None] * [0.9, 1.0, 1.1]) for t in problem.traces)
    report = diagnose(dataclasses.replace(problem, traces=known), nested=False)
    assert set(found(report)) == {"accel_bias", "accel_vibration"}
    holds(report, "accel_vibration", [0.05, 0.02, -0.03, 0.0, 0.0, 0.0])
    holds(report, "accel_bias", [0.05, -0.03, 0.02])
    wave = next(e for e in report.effects if e.id == "accel_vibration")
    assert wave.params[-1].value == pytest.approx(201.0, abs=1e-3)


@pytest.mark.long
def test_a_large_rotation_is_neither_a_scale_nor_a_misalignment():
    def gap(trace):
        return Rotation.from_rotvec([0.06, 0.0, -0.03]).apply(trace.ideal) - trace.ideal

    report = diagnose(problem_of(np.random.default_rng(3), (A,), gap), nested=False)
    assert found(report) == {"accel_rotation": (1,)}
    holds(report, "accel_rotation", [0.06, 0.0, -0.03])


def test_a_magnet_that_comes_and_goes_is_two_steps():
    def gap(trace):
        return ((trace.t > 12.3) & (trace.t < 29.1))[:, None] * np.array([6.0, -2.0, 1.0])

    report = diagnose(problem_of(np.random.default_rng(4), (M,), gap), nested=False)
    assert [effect.id for effect in report.effects] == ["mag_step", "mag_step"]
    moments = sorted(effect.params[-1].value for effect in report.effects)
    assert moments == pytest.approx([12.3, 29.1], abs=0.05)


@pytest.mark.parametrize(("only", "instances"), [(None, (1, 2)), (1, (2,))])
def test_an_effect_is_shared_or_of_one_instance(only, instances):
    def gap(_trace):
        return np.array([0.03, -0.02, 0.0])

    report = diagnose(problem_of(np.random.default_rng(5), (A,), gap, instances=2, only=only), nested=False)
    assert found(report) == {"accel_bias": instances}
    holds(report, "accel_bias", [0.03, -0.02, 0.0])


@pytest.mark.long
def test_instances_tell_their_own_bias_from_the_error_of_their_reference():
    def wrong(truth, _sensor):
        slow = np.radians(1.0) * np.sin(2 * np.pi * truth["t"] / 17.0)[:, None] * np.array([1.0, 0.6, -0.3])
        return np.cross(slow, truth["force"])

    problem = problem_of(
        np.random.default_rng(6),
        (A,),
        lambda _trace: np.array([0.03, -0.02, 0.01]),
        instances=2,
        only=0,
        reference=ReferenceInfo(ReferenceKind.ESTIMATOR, att_sigma_deg=0.3),
        error=wrong,
    )
    report = diagnose(problem, nested=False)
    assert found(report)["accel_bias"] == (1,)
    assert found(report)["reference_attitude"] == (1, 2)
    holds(report, "accel_bias", [0.03, -0.02, 0.01])


@pytest.mark.long
def test_a_wandering_reference_is_a_finding_about_the_reference():
    def wrong(truth, sensor):
        slow = np.radians(0.6) * np.sin(2 * np.pi * truth["t"] / 17.0)[:, None] * np.array([1.0, 0.6, -0.3])
        return np.cross(slow, truth["force"] if sensor is A else truth["field"])

    report = diagnose(problem_of(np.random.default_rng(7), (A, M), error=wrong), nested=False)
    assert report.verdict is GapVerdict.REFERENCE
    assert report.where


@pytest.mark.long
def test_a_reference_that_wanders_about_a_turn_is_one_finding():
    """The turn alone would be two sensors', and beside both of them the rest is next to nothing."""

    def wrong(truth, sensor):
        wave = np.sin(2 * np.pi * truth["t"] / 17.0)[:, None] * np.array([1.0, 0.6, -0.3])
        return np.cross(
            np.radians(0.1) * (np.array([1.5, -1.0, 0.5]) + wave), truth["force" if sensor is A else "field"]
        )

    report = diagnose(problem_of(np.random.default_rng(7), (A, M), error=wrong), nested=False)
    assert report.verdict is GapVerdict.REFERENCE
    assert found(report) == {"reference_attitude": (1,)}


@pytest.mark.long
def test_a_reference_that_moves_faster_than_its_cosines_is_still_one_finding():
    """Drifts, which explain it at all frequencies, say more at first than the process does with those that it has."""
    rng = np.random.default_rng(99)

    def wrong(truth, sensor):
        error = np.random.default_rng(99).standard_normal((len(truth["t"]) + 2000, 3))
        for keep in (np.exp(-0.02 / 3.0), np.exp(-0.02 / 1.0)):  # two lags, s, at 50 Hz
            error = lfilter([1.0 - keep], [1.0, -keep], error, axis=0)
        turn = np.radians(0.3) * error[2000:] / error[2000:].std()
        return np.cross(turn, truth["force"] if sensor is A else truth["field"])

    report = diagnose(problem_of(rng, (A, M), error=wrong), nested=False)
    assert report.verdict is GapVerdict.REFERENCE


@pytest.mark.long
def test_what_the_catalogue_does_not_have_is_unknown_with_its_shape():
    def gap(trace):
        return np.abs(trace.force[:, :1] - 1.0) * np.array([0.02, 0.0, 0.0])

    report = diagnose(problem_of(np.random.default_rng(8), (A,), gap), nested=False)
    assert report.verdict is GapVerdict.UNKNOWN
    assert "a_x on accel.x" in report.unknown.shape
    assert set(as_json(report)["unknown"]) == {"flag", "share", "shape", "hidden_driver", "log_odds"}


@pytest.mark.long
def test_a_small_effect_that_a_huge_one_hides_is_named_without_the_huge_one():
    def gap(iron):
        offsets = {A: np.array([-0.0036, 0.0032, -0.0047]), M: np.array([88.0, -102.0, 52.0]) * iron}
        return lambda trace: offsets[trace.sensor]

    both, small = (diagnose(problem_of(np.random.default_rng(12), (A, M), gap(iron)), nested=False) for iron in (1, 0))
    assert found(both) == {"mag_hard_iron": (1,)}
    assert found(small) == {"accel_bias": (1,)}


def test_missing_telemetry_is_not_testable_rather_than_absent():
    problem = problem_of(np.random.default_rng(9), (M,))
    bare = tuple(dataclasses.replace(t, current=None, throttle=None, temperature=None) for t in problem.traces)
    report = diagnose(dataclasses.replace(problem, traces=bare), nested=False)
    reasons = {entry.id: entry.reason for entry in report.not_testable}
    assert "no current" in reasons["mag_motor_current"]
    assert "mag_hard_iron" not in reasons


def test_without_a_series_nothing_is_testable():
    report = diagnose(GapProblem((), ReferenceInfo(ReferenceKind.SIM), 0.0))
    assert report.verdict is GapVerdict.NOT_TESTABLE
    assert report.not_testable


def test_blocks_that_disagree_widen_the_errors():
    """A current's field whose size changes on the way: the stated error must not be that of the noise alone."""
    only = tuple(e for e in catalogue() if e.id == "mag_motor_current" and not e.form)
    errors = []
    for swing in (0.0, 0.3):

        def gap(trace, swing=swing):
            size = 1.0 + swing * np.sin(2.0 * np.pi * trace.t / 13.0)
            return np.outer(trace.current * size, [0.2, -0.1, 0.3])

        problem = problem_of(np.random.default_rng(21), (Sensor.MAG,), gap)
        views = split(views_of(problem, {}, {}))
        setting = setting_of(views)
        contest = Contest(hypotheses_of(only, views)[0])
        chosen = select(noise_fitted(model_without_effects(setting)).model, contest, 0.005)
        (term,) = chosen.model.terms
        dose = block_agreement(chosen, term.hypothesis.key)
        assert dose.agrees is (swing == 0.0)
        errors.append(max(e.se for e in estimates_of(chosen, term, dose.widening)))
    assert errors[1] > 3.0 * errors[0]
