"""Whose noise it is: of the instances named, more than flights differ by, and no line's own unsteadiness."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mavcal.calib.gap.effects import forward_models
from mavcal.calib.gap.model.hypotheses import Hypothesis
from mavcal.calib.gap.model.joint import Model, NoiseTerm, setting_of
from mavcal.calib.gap.model.noise_fit import model_without_effects, noise_fitted, with_term
from mavcal.calib.gap.model.views import views_of
from mavcal.calib.gap.problem import GapProblem, ReferenceInfo, ReferenceKind
from mavcal.calib.gap.search.added_noise import (
    AddedNoise,
    drift_exceeds_lines,
    exceeds_flight_differences,
    is_line_unsteadiness,
    is_on_loud_instances,
    line_amplitudes,
    line_power,
    tone_exceeds_lines,
)
from mavcal.calib.gap.search.contest import noise_score
from mavcal.calib.recording import Sensor
from tests.unit.gap.synthetic import SIGMA, problem_of

ESTIMATOR = ReferenceInfo(ReferenceKind.ESTIMATOR, att_sigma_deg=1.0)
SETS = ((0,), (1,), (0, 1))


def model_of(seed: int, louder: tuple[int, ...], *, reference: ReferenceInfo = ESTIMATOR, times: float = 1.0) -> Model:
    """A gyroscope of two instances; those of `louder` have more noise than is declared."""
    rng = np.random.default_rng(seed + 1000)

    def gap(trace):
        own = times * SIGMA[Sensor.GYRO] * rng.normal(size=trace.ideal.shape)
        return own if trace.instances[0] in louder else 0.0

    problem = problem_of(np.random.default_rng(seed), (Sensor.GYRO,), gap, instances=2, reference=reference)
    setting = setting_of(views_of(problem, {}, {}))
    return model_without_effects(setting)


def noise(instances: tuple[int, ...]) -> AddedNoise:
    hypothesis = Hypothesis(forward_models()["gyro_noise"][-1], instances)
    return AddedNoise(hypothesis, np.nan, np.full((1, 3), SIGMA[Sensor.GYRO] ** 2 / 50.0))


@pytest.mark.parametrize("louder", SETS)
@pytest.mark.parametrize("seed", range(4))
def test_louder_noise_is_that_of_the_instances_that_show_it(seed, louder):
    model = model_of(seed, louder)
    assert [is_on_loud_instances(noise(named), model) for named in SETS] == [named == louder for named in SETS]


@pytest.mark.parametrize("shaken", SETS)
@pytest.mark.parametrize("at_hz", [9.5, 10.0, 10.5])
def test_units_with_clocks_of_their_own_shake_at_frequencies_of_their_own(shaken, at_hz):
    """87.07 and 87.61 Hz in one flight: a line half a hertz wide at either is of both."""

    def gap(trace):
        i = trace.instances[0]
        wave = np.cos(2.0 * np.pi * (9.7 + 0.55 * i) * trace.t + i)
        return 3.0 * SIGMA[Sensor.GYRO] * wave[:, None] * np.ones(3) if i in shaken else 0.0

    problem = problem_of(np.random.default_rng(9), (Sensor.GYRO,), gap, instances=2, reference=ESTIMATOR)
    setting = setting_of(views_of(problem, {}, {}))
    model = model_without_effects(setting)
    vibration = forward_models()["gyro_vibration"][-1]
    lines = [
        AddedNoise(Hypothesis(vibration, named), at_hz, np.full((1, 3), SIGMA[Sensor.GYRO] ** 2)) for named in SETS
    ]
    assert [is_on_loud_instances(line, model) for line in lines] == [named == shaken for named in SETS]


def test_series_of_one_instance_each_name_themselves():
    model = model_of(0, (0,), reference=ReferenceInfo(ReferenceKind.SIM))
    assert all(is_on_loud_instances(noise(named), model) for named in SETS)


@pytest.mark.parametrize("louder", SETS)
@pytest.mark.parametrize("seed", range(3))
def test_of_a_difference_alone_any_instance_may_be_the_one(seed, louder):
    rng = np.random.default_rng(seed + 1000)
    single = problem_of(np.random.default_rng(seed), (Sensor.GYRO,), instances=2).traces
    size = SIGMA[Sensor.GYRO]
    noisy = [t.measured + (t.instances[0] in louder) * 2.0 * size * rng.normal(size=t.ideal.shape) for t in single]
    pair = dataclasses.replace(
        single[0], measured=noisy[0], ideal=noisy[1], against=1, sigma=np.full(3, np.sqrt(2.0) * size)
    )
    setting = setting_of(views_of(GapProblem((pair,), ESTIMATOR, 40.0), {}, {}))
    assert [view.weights for view in setting.views] == [{0: 1.0, 1: -1.0}]
    model = model_without_effects(setting)
    assert all(is_on_loud_instances(noise(named), model) for named in SETS)
    chances = [noise_score(noise(named).hypothesis, model).p for named in SETS]
    assert max(chances) < 1e-6


def with_learned(model: Model) -> Model:
    """The same with its noise learned from another flight."""
    power = SIGMA[Sensor.GYRO] ** 2
    views = tuple(
        dataclasses.replace(v, density=np.full((v.count, 3), power), variance=None, dof=1000.0)
        for v in model.setting.views
    )
    setting = setting_of(views)
    return model_without_effects(setting)


def test_where_noise_was_learned_from_a_flight_a_little_more_is_no_effect():
    declared, learned = model_of(1, (0, 1)), with_learned(model_of(1, (0, 1)))
    few, many = (AddedNoise(noise((0, 1)).hypothesis, np.nan, k * noise((0, 1)).amplitudes) for k in (0.5, 1.5))
    assert exceeds_flight_differences(few, declared)
    assert exceeds_flight_differences(many, declared)
    assert not exceeds_flight_differences(few, learned)
    assert exceeds_flight_differences(many, learned)


def a_line(size: float) -> tuple[Model, NoiseTerm]:
    """A gyroscope with a line at 10 Hz of amplitude `size` (in noise of one sample) while the motors run."""

    def gap(trace):
        on = trace.throttle > 0.05
        return np.where(on, size * SIGMA[Sensor.GYRO] * np.cos(2.0 * np.pi * 10.0 * trace.t), 0.0)[:, None] * np.ones(3)

    problem = problem_of(np.random.default_rng(5), (Sensor.GYRO,), gap)
    setting = setting_of(views_of(problem, {}, {}))
    term = NoiseTerm(Hypothesis(forward_models()["gyro_vibration"][-1], (0,)), 10.0)
    model = noise_fitted(with_term(model_without_effects(setting), term)).model
    return model, term


@pytest.mark.parametrize("size", [2.0, 10.0])
def test_the_amplitude_of_a_line_is_read_at_its_frequency(size):
    model, term = a_line(size)
    squared, se = line_amplitudes(term, model)
    truth = (size * SIGMA[Sensor.GYRO]) ** 2
    assert squared == pytest.approx(np.full(3, truth), rel=0.15)
    assert (se > 0.0).all()


def test_a_little_broad_noise_beside_a_strong_line_is_its_unsteadiness():
    model, line = a_line(10.0)
    broad = NoiseTerm(Hypothesis(forward_models()["gyro_noise"][-1], (0,)), np.nan)
    both = noise_fitted(with_term(model, broad)).model
    assert is_line_unsteadiness(broad, both)
    assert not is_line_unsteadiness(line, both)
    alone = noise_fitted(with_term(model_of(2, (0, 1), times=2.0), noise_term((0, 1)))).model
    assert not is_line_unsteadiness(noise_term((0, 1)), alone)


def test_a_drift_beside_a_strong_line_has_to_be_more_than_its_skirts():
    model, _ = a_line(10.0)
    walk = Hypothesis(forward_models()["gyro_random_walk"][-1], (0,))
    small, large = (AddedNoise(walk, np.nan, np.full((1, 3), (size * SIGMA[Sensor.GYRO]) ** 2)) for size in (1e-4, 1.0))
    assert not drift_exceeds_lines(small, model)
    assert drift_exceeds_lines(large, model)
    assert drift_exceeds_lines(small, model_of(3, ()))
    assert drift_exceeds_lines(noise((0,)), model)


def noise_term(instances: tuple[int, ...]) -> NoiseTerm:
    return NoiseTerm(noise(instances).hypothesis, np.nan)


def test_a_small_tone_beside_a_strong_line_is_part_of_it():
    model, _ = a_line(10.0)
    tone = Hypothesis(forward_models()["gyro_tone"][-1], (0,))
    assert line_power(tone, model) > 0.0
    small, large = (np.full(6, k * SIGMA[Sensor.GYRO]) for k in (0.1, 10.0))
    assert not tone_exceeds_lines(tone, small, model)
    assert tone_exceeds_lines(tone, large, model)
    bias = Hypothesis(forward_models()["gyro_bias"][-1], (0,))
    assert tone_exceeds_lines(bias, small[:3], model)
