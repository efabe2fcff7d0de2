from __future__ import annotations

import math

import numpy as np
import pytest

from mavcal.calib.gap import diagnose
from mavcal.calib.gap.effects import catalogue
from mavcal.calib.gap.problem import GapProblem
from mavcal.calib.gap.schema import GapVerdict
from mavcal.calib.gap.search.wander import inverse_root, marginal_gain
from mavcal.calib.gap.unknown.plausibility import improbable_effects
from mavcal.calib.gap.worth.attribution import Attribution
from mavcal.calib.recording import Sensor
from tests.unit.gap.synthetic import problem_of

EFFECTS = {(effect.id, (0,)): effect for effect in catalogue()}


def attribution(key="gyro_tone", probability=0.0, unknown=1.0):
    return Attribution((key, (0,)), 20.0, 3, 0.5, probability, unknown, ())


@pytest.mark.parametrize(
    ("probability", "unknown", "withdrawn", "named"),
    [(0.0, 1.0, 0.0, False), (0.0, 0.0, 300.0, False), (0.0, 0.0, 0.0, True), (0.5, 0.5, 300.0, True)],
)
def test_a_name_that_something_nameless_beats_is_none(probability, unknown, withdrawn, named):
    found = improbable_effects([attribution(probability=probability, unknown=unknown)], EFFECTS, withdrawn)
    assert [s.keys for s in found] == ([] if named else [(("gyro_tone", (0,)),)])


def test_names_of_one_sensor_are_one_difference():
    found = improbable_effects([attribution(), attribution("gyro_bias"), attribution("mag_tone")], EFFECTS, 0.0)
    assert [s.text.split()[3] for s in found] == ["gyro", "mag"]


def test_a_difference_of_the_clock_belongs_to_no_sensor():
    assert [s.text.split()[3] for s in improbable_effects([attribution("clock_drift")], EFFECTS, 0.0)] == ["clock"]


def test_a_sensor_that_reads_nothing_has_no_scale_error():
    rng = np.random.default_rng(8)
    problem = problem_of(rng, (Sensor.MAG,), lambda trace: -trace.ideal)
    report = diagnose(problem, nested=False)
    assert report.verdict is GapVerdict.NOT_TESTABLE
    assert not report.effects
    assert any("does not follow" in why.reason for why in report.not_testable)


@pytest.mark.long
def test_the_other_sensors_are_diagnosed_without_it():
    rng = np.random.default_rng(9)
    dead = problem_of(rng, (Sensor.MAG,), lambda trace: -trace.ideal)
    late = problem_of(rng, (Sensor.GYRO,), lambda _: np.array([0.01, 0.0, -0.02]))
    report = diagnose(GapProblem((*dead.traces, *late.traces), late.reference, late.duration_s), nested=False)
    assert [e.id for e in report.effects] == ["gyro_bias"]
    assert [n.id for n in report.not_testable].count("mag") == 1


@pytest.mark.long
def test_a_difference_without_noise_is_still_explained():
    rng = np.random.default_rng(10)
    problem = problem_of(rng, (Sensor.ACCEL,), lambda trace: 1.01 * trace.ideal - trace.measured)
    report = diagnose(problem, nested=False)
    assert next(e.params[0].value for e in report.effects if e.id == "accel_scale") == pytest.approx(0.01, abs=1e-5)


def test_the_marginal_likelihood_stands_squares_that_rounding_makes_negative():
    inner = np.array([[2.0, 1.0], [1.0, 3.0]])
    right = np.array([1.0, 2.0])
    plain = float(right @ np.linalg.solve(inner, right)) - math.log(5.0)
    assert marginal_gain(inverse_root(inner), right) == pytest.approx(plain)
    broken = np.array([[1.0 + 1e20, 1e20], [1e20, 1e20 - 1e5]])
    assert math.isfinite(marginal_gain(inverse_root(broken), right))
