"""What the attitude of a re-estimated reference leaves open is in the intervals of what it could be taken for."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from mavcal.calib.gap.diagnose import diagnose
from mavcal.calib.gap.effects import catalogue
from mavcal.calib.gap.problem import ReferenceInfo, ReferenceKind
from mavcal.calib.gap.reference.redundant import faulty_instances_of
from mavcal.calib.recording import Sensor
from tests.unit.gap.synthetic import SIGMA, problem_of

TILT_DEG = 0.5
BIAS_ONLY = tuple(e for e in catalogue() if e.id == "accel_bias")
BIAS = np.array([0.3, -0.2, 0.15])
WHITE = SIGMA[Sensor.ACCEL] / math.sqrt(2000.0)


def estimated(kind=ReferenceKind.ESTIMATOR, seed=1):
    """An accelerometer with an offset, beside a reference that is tilted."""
    rng = np.random.default_rng(seed)
    tilt = math.radians(TILT_DEG) * rng.normal(size=3)

    def error(flight, _sensor):
        return np.cross(flight["force"], tilt)

    problem = problem_of(
        rng,
        (Sensor.ACCEL,),
        lambda _: np.tile(BIAS, (2000, 1)),
        reference=ReferenceInfo(kind, TILT_DEG),
        error=error,
    )
    few = tuple(e for e in catalogue() if e.id == "accel_bias")
    (effect,) = diagnose(problem, effects=few, nested=False).effects
    return effect.params


@pytest.mark.long
def test_a_bias_beside_a_tilt_is_as_uncertain_as_the_tilt():
    params = [p for seed in range(8) for p in estimated(seed=seed)]
    off = np.array([(p.value - BIAS["xyz".index(p.name[-1])]) / p.se for p in params])
    assert 0.2 < np.sqrt((off**2).mean()) < 1.5
    assert np.median([p.se for p in params]) > 2.0 * WHITE


@pytest.mark.long
def test_a_reference_that_is_exact_adds_nothing():
    assert all(p.se < 1.5 * WHITE for p in estimated(kind=ReferenceKind.SIM))


def beside_a_wandering_attitude(stated_deg, kind=ReferenceKind.ESTIMATOR):
    """All sensors beside an attitude that wanders by 0.5 degrees, and a gyroscope with crossed axes."""
    reference = ReferenceInfo(kind, stated_deg, gyro_sd=(0.02,) * 9, field_sd=(0.3,) * 3)
    slow = np.random.default_rng(7).standard_normal((4, 3))

    def error(flight, sensor):
        if sensor is Sensor.GYRO:
            return 0.0
        t = flight["t"]
        turn = math.radians(0.5) * sum(np.sin(0.1 * np.pi * (k + 1) * t)[:, None] * slow[k] for k in range(4))
        return np.cross(flight["force" if sensor is Sensor.ACCEL else "field"], turn)

    def crossed(trace):
        if trace.sensor is not Sensor.GYRO:
            return 0.0
        return trace.ideal @ np.array([[0.0, 0.01, 0.0], [0.01, 0.0, 0.0], [0.0, 0.01, 0.0]])

    problem = problem_of(
        np.random.default_rng(3), (Sensor.ACCEL, Sensor.GYRO, Sensor.MAG), crossed, reference=reference, error=error
    )
    return diagnose(problem, nested=False)


@pytest.mark.long
def test_what_a_re_estimated_trajectory_states_of_itself_is_no_finding():
    report = beside_a_wandering_attitude(stated_deg=1.5)
    assert [e.id for e in report.effects] == []


@pytest.mark.long
def test_an_attitude_that_wanders_more_than_it_states_is_a_finding():
    assert "reference_attitude" in [e.id for e in beside_a_wandering_attitude(stated_deg=0.05).effects]


def two_at_rest(offset, tilt_deg=1.0):
    """Two accelerometers at rest beside an attitude that is levelled by the first one, which is off by `offset`."""
    gravity, offset = np.array([0.0, 0.0, -9.80665]), np.array(offset)
    levelled = gravity + offset * [1.0, 1.0, 0.0]
    whole = problem_of(
        np.random.default_rng(11),
        (Sensor.ACCEL,),
        instances=2,
        reference=ReferenceInfo(ReferenceKind.ESTIMATOR, tilt_deg),
    )
    traces = []
    for trace in whole.traces:
        ideal = np.tile(levelled * 9.80665 / np.linalg.norm(levelled), (len(trace.t), 1))
        measured = gravity + trace.residual + (offset if trace.instances == (0,) else 0.0)
        still = np.zeros_like(ideal)
        upright = np.tile([1.0, 0.0, 0.0, 0.0], (len(trace.t), 1))
        traces.append(
            replace(trace, measured=measured, ideal=ideal, force=ideal, rate=still, spin=still, attitude=upright)
        )
    worse = faulty_instances_of(traces, (), math.radians(tilt_deg))
    return diagnose(replace(whole, traces=tuple(traces), worse=worse), effects=BIAS_ONLY, nested=False)


@pytest.mark.long
def test_of_two_units_the_one_that_is_off_along_gravity_has_the_bias_and_not_the_other():
    (effect,) = two_at_rest((0.3, -0.2, 0.15), tilt_deg=2.0).effects
    assert effect.instances == (1,)
    assert [p.value for p in effect.params] == pytest.approx([0.3, -0.2, 0.15], abs=0.01)
    assert effect.evidence.probability > 0.7


@pytest.mark.long
def test_a_bias_that_a_tilt_hides_is_on_either_unit_and_the_report_says_so():
    (effect,) = two_at_rest((0.3, -0.2, 0.0)).effects
    assert effect.evidence.probability < 0.7  # the tilt would be two of its standard deviations
    assert effect.confusable_with[0].id == "accel_bias"
    other = 3 - effect.instances[0]
    assert f"instance {other} may have it instead" in effect.confusable_with[0].fix


@pytest.mark.long
def test_a_unit_that_differs_by_more_than_any_tilt_is_the_one():
    (effect,) = two_at_rest((0.3, -0.2, 0.0), tilt_deg=0.2).effects
    assert effect.confusable_with == ()
    assert effect.evidence.probability > 0.7
