"""A sensor that does not respond to its reference is left out, and said."""

from __future__ import annotations

import numpy as np
import pytest

from mavcal.calib.gap import diagnose
from mavcal.calib.gap.problem import GapProblem
from mavcal.calib.gap.schema import GapVerdict
from mavcal.calib.recording import Sensor
from tests.unit.gap.synthetic import problem_of


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
