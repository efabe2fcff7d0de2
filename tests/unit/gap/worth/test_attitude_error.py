"""What the attitude of a re-estimated reference leaves open is in the intervals of what it could be taken for."""

from __future__ import annotations

import math

import numpy as np

from mavcal.calib.gap.diagnose import diagnose
from mavcal.calib.gap.effects import catalogue
from mavcal.calib.gap.problem import ReferenceInfo, ReferenceKind
from mavcal.calib.recording import Sensor
from tests.unit.gap.synthetic import SIGMA, problem_of

TILT_DEG = 0.5
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


def test_a_bias_beside_a_tilt_is_as_uncertain_as_the_tilt():
    params = [p for seed in range(8) for p in estimated(seed=seed)]
    off = np.array([(p.value - BIAS["xyz".index(p.name[-1])]) / p.se for p in params])
    assert 0.2 < np.sqrt((off**2).mean()) < 1.5
    assert np.median([p.se for p in params]) > 2.0 * WHITE


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


def test_what_a_re_estimated_trajectory_states_of_itself_is_no_finding():
    report = beside_a_wandering_attitude(stated_deg=1.5)
    assert [e.id for e in report.effects] == []


def test_an_attitude_that_wanders_more_than_it_states_is_a_finding():
    assert "reference_attitude" in [e.id for e in beside_a_wandering_attitude(stated_deg=0.05).effects]
