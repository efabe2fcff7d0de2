"""A simulator's effects put into the ideal readings of another flight."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mavcal.calib.gap.effects import forward_models
from mavcal.calib.gap.effects.replay import with_effects
from mavcal.calib.gap.problem import GapProblem
from mavcal.calib.recording import Sensor
from tests.unit.gap.export.making import effect
from tests.unit.gap.synthetic import SIGMA, problem_of
from tests.unit.gap_report.flown import WEAK, WIND

BIAS = np.array([0.3, -0.2, 0.15])


def a_problem(instances: int = 1) -> GapProblem:
    return problem_of(np.random.default_rng(8), (Sensor.ACCEL,), lambda _: BIAS, instances=instances, only=0)


def test_the_same_effect_leaves_the_noise() -> None:
    problem, lost = with_effects(a_problem(2), [effect("accel_bias", (1,), bias=(0.3, -0.2, 0.15))])
    assert lost == ()
    for trace in problem.traces:  # the second instance never had it
        np.testing.assert_allclose(trace.residual.mean(axis=0), 0.0, atol=0.01)


def test_what_another_instance_has_counts_against_it() -> None:
    first, second = a_problem(2).traces
    pair = dataclasses.replace(second, ideal=first.measured, against=0)
    problem, _ = with_effects(
        GapProblem((pair,), a_problem().reference, 40.0), [effect("accel_bias", (1,), bias=(0.3, -0.2, 0.15))]
    )
    np.testing.assert_allclose(problem.traces[0].residual.mean(axis=0), 0.0, atol=0.01)


UNKNOWN = dict.fromkeys(("force", "rate", "spin", "field", "attitude", "temperature", "current", "throttle"))
UNKNOWN |= dict.fromkeys(("motors", "rotor_hz", "place"))


@pytest.mark.parametrize("effect_id", sorted(forward_models()))
def test_what_a_flight_does_not_know_is_lost_and_no_failure(effect_id: str) -> None:
    """A simulator's lever arm beside a real flight whose rate is not known."""
    shapes = {e.shape.parameter.name for e in forward_models()[effect_id] if e.shape is not None}
    one = effect(effect_id, **dict.fromkeys(shapes, 5.0))
    sensor = one.sensor or Sensor.ACCEL
    (trace,) = problem_of(np.random.default_rng(8), (sensor,)).traces
    bare = dataclasses.replace(trace, **UNKNOWN)
    problem, lost = with_effects(GapProblem((bare,), a_problem().reference, 40.0), [one])
    assert len(problem.traces) == 1
    if effect_id in {"accel_lever_arm", "gyro_g_sensitivity", "mag_motor_current", "mag_motor_throttle"}:
        assert lost == (effect_id,)


def test_holes_stay_without_a_residual() -> None:
    (trace,) = a_problem().traces
    seen = trace.observed.copy()
    seen[100:200] = False
    holed = dataclasses.replace(trace, observed=seen, measured=np.where(seen[:, None], trace.measured, trace.ideal))
    problem, _ = with_effects(
        GapProblem((holed,), a_problem().reference, 40.0), [effect("accel_bias", bias=(0.3, -0.2, 0.15))]
    )
    assert not problem.traces[0].residual[100:200].any()


def test_noise_is_expected_then() -> None:
    density = (0.01, 0.02, 0.03)
    problem, _ = with_effects(a_problem(), [effect("accel_noise", density=density)])
    (trace,) = problem.traces
    assert trace.psd is not None
    expected = SIGMA[Sensor.ACCEL] ** 2 + trace.fs * np.square(density)
    np.testing.assert_allclose(trace.psd, np.broadcast_to(expected, trace.psd.shape), rtol=1e-9)


def test_what_cannot_be_replayed_is_named() -> None:
    problem, lost = with_effects(
        a_problem(), [effect("accel_quantisation", lsb=(0.1, 0.1, 0.1)), effect("mag_quantisation")]
    )
    assert lost == ("accel_quantisation",)
    np.testing.assert_array_equal(problem.traces[0].ideal, a_problem().traces[0].ideal)


def test_an_end_of_the_range_clips_the_ideal_reading() -> None:
    problem, lost = with_effects(a_problem(), [effect("accel_saturation", limit=5.0)])
    assert lost == ()
    np.testing.assert_allclose(problem.traces[0].ideal, np.clip(a_problem().traces[0].ideal, -5.0, 5.0))


def test_what_the_airframe_does_moves_no_sensor() -> None:
    problem = a_problem()
    again, lost = with_effects(problem, (WEAK, WIND))
    assert lost == ()
    np.testing.assert_array_equal(again.traces[0].ideal, problem.traces[0].ideal)
