from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mavcal.calib.gap.diagnose import _setup_of
from mavcal.calib.gap.effects import catalogue
from mavcal.calib.gap.model.hypotheses import Key
from mavcal.calib.gap.model.joint import Model, Term, with_residual
from mavcal.calib.gap.telling.identifiability import inseparable_notice
from mavcal.calib.gap.telling.recordings import diagnoser_sha256, inputs_of, series_of
from mavcal.calib.recording import Sensor
from tests.unit.gap.synthetic import SIGMA, problem_of

BIAS = np.array([0.3, -0.2, 0.1])


def model_with(*values: np.ndarray, instances: int = 1) -> tuple[Model, list[Key]]:
    """A gyroscope with an offset in its model for each of `values`, on one instance after the other."""
    problem = problem_of(
        np.random.default_rng(2), (Sensor.GYRO,), lambda _: np.tile(BIAS, (2000, 1)), instances=instances
    )
    task = _setup_of(problem, tuple(e for e in catalogue() if e.id == "gyro_bias"))
    own = [h for h in task.contest.hypotheses if len(h.instances) == 1]
    terms = tuple(Term(h, value, np.nan) for h, value in zip(own, values, strict=False))
    return with_residual(replace(task.bare, terms=terms)), [t.hypothesis.key for t in terms]


def test_a_series_is_what_was_measured_less_what_is_ideal() -> None:
    model, _ = model_with(BIAS)
    [series] = series_of(model)
    assert (series.sensor, series.instances, series.unit) == (Sensor.GYRO, (1,), "rad/s")
    np.testing.assert_allclose(series.residual.mean(axis=0), BIAS, atol=4.0 * SIGMA[Sensor.GYRO] / np.sqrt(2000))
    np.testing.assert_allclose(series.modelled, np.tile(BIAS, (len(series.t), 1)))
    np.testing.assert_allclose(series.sigma, SIGMA[Sensor.GYRO], rtol=0.1)
    assert series.ideal is not None
    assert series.ideal.shape == series.residual.shape
    assert set(series.covariates) == {"temperature", "current", "throttle"}
    assert {len(values) for values in series.covariates.values()} == {len(series.t)}


def test_an_effect_touches_the_series_of_its_instance_alone() -> None:
    model, _ = model_with(BIAS, -BIAS, instances=2)
    first, second = series_of(model)
    assert (first.instances, second.instances) == ((1,), (2,))
    np.testing.assert_allclose(first.modelled[0], BIAS)
    np.testing.assert_allclose(second.parts["gyro_bias"][0], -BIAS)


def test_what_happens_more_than_once_is_shown_as_one() -> None:
    model, _ = model_with(BIAS)
    twice = with_residual(replace(model, terms=(model.terms[0], replace(model.terms[0], beta=0.5 * BIAS))))
    [series] = series_of(twice)
    assert set(series.parts) == {"gyro_bias"}


def test_what_is_tolerated_is_modelled_and_not_shown() -> None:
    model, keys = model_with(BIAS)
    [series] = series_of(model, keys)
    assert series.parts == {}
    np.testing.assert_allclose(series.modelled[0], BIAS)


def test_without_an_effect_nothing_is_modelled() -> None:
    model, _ = model_with()
    [series] = series_of(model)
    assert not series.modelled.any()
    assert series.parts == {}


def test_the_inputs_are_those_of_the_problem() -> None:
    problem = problem_of(np.random.default_rng(3), (Sensor.GYRO, Sensor.MAG), instances=2)
    told = inputs_of(replace(problem, inputs={"real": "ab", "sim": "cd"}))
    assert (told.real_sha256, told.sim_sha256, told.reference_kind) == ("ab", "cd", "sim")
    assert told.fs_hz == pytest.approx(50.0)
    assert set(told.declared_noise) == {"gyro1", "gyro2", "mag1", "mag2"}
    assert told.declared_noise["mag2"] == (SIGMA[Sensor.MAG],) * 3
    silent = replace(problem, traces=(replace(problem.traces[0], sigma=None), *problem.traces[1:]))
    assert "gyro1" not in inputs_of(silent).declared_noise
    against = replace(problem, traces=(replace(problem.traces[0], against=1), *problem.traces[1:]))
    assert "gyro1" not in inputs_of(against).declared_noise
    assert inputs_of(problem).real_sha256 is None
    assert len(told.diagnoser_sha256) == 64
    assert told.diagnoser_sha256 == diagnoser_sha256()


def test_small_effects_are_named_once_in_a_sentence() -> None:
    [said] = inseparable_notice(["accel_bias", "gyro_bias", "accel_bias"])
    assert said.endswith("error: accel_bias, gyro_bias")
    assert inseparable_notice([]) == ()
