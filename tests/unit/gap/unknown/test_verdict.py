"""What has no name is said, and is not named as something else."""

from __future__ import annotations

import numpy as np
import pytest

from mavcal.calib.gap.diagnose import diagnose
from mavcal.calib.gap.effects import catalogue
from mavcal.calib.gap.model.joint import setting_of
from mavcal.calib.gap.model.noise_fit import model_without_effects
from mavcal.calib.gap.model.views import views_of
from mavcal.calib.gap.unknown.excess_power import excess_power
from mavcal.calib.gap.unknown.misattributed_noise import Unexplained
from mavcal.calib.gap.unknown.verdict import UnnamedCause, improbable_effects, unknown_of
from mavcal.calib.gap.worth.attribution import Attribution
from mavcal.calib.recording import Sensor
from tests.unit.gap.synthetic import problem_of

MOMENTS = (8.0, 16.0, 24.0, 32.0)
NAMED = {(effect.id, (0,)): effect for effect in catalogue()}


def jumping(moments):
    def gap(trace):
        size = np.array([0.4, -0.3, 0.2])
        levels = sum(sign * (trace.t > at) for at, sign in zip(moments, (1.0, -2.0, 2.0, -1.5), strict=False))
        return np.outer(levels, size)

    return gap


@pytest.mark.long
def test_two_jumps_are_events_with_a_name():
    report = diagnose(problem_of(np.random.default_rng(1), (Sensor.ACCEL,), jumping(MOMENTS[:2])), nested=False)
    assert [e.id for e in report.effects] == ["accel_step"] * 2
    assert not report.unknown.flag


@pytest.mark.long
def test_a_sensor_that_keeps_jumping_is_unknown_and_no_jump_is_named():
    report = diagnose(problem_of(np.random.default_rng(1), (Sensor.ACCEL,), jumping(MOMENTS)), nested=False)
    assert report.unknown.flag
    assert "jumps on accel" in report.unknown.shape
    assert not any(e.id == "accel_step" for e in report.effects)


@pytest.mark.long
def test_each_moment_is_said_once_however_many_instances_jump():
    def all_jump(truth, _sensor):
        return (
            0.5
            * sum(sign * (truth["t"] > at) for at, sign in zip(MOMENTS, (1.0, -2.0, 2.0, -1.5), strict=True))[:, None]
        )

    problem = problem_of(
        np.random.default_rng(1), (Sensor.ACCEL,), jumping(MOMENTS), instances=2, only=1, error=all_jump
    )
    report = diagnose(problem, nested=False)
    assert "4 jumps on accel: 8.0 s, 16.0 s, 24.0 s, 32.0 s" in report.unknown.shape
    assert "_step" not in report.unknown.shape


def test_what_the_references_own_nuisance_leave_over_is_not_unknown():
    def humming(trace):
        return 0.1 * np.sin(2.0 * np.pi * 9.0 * trace.t + 2.0 * np.sin(2.0 * np.pi * 0.7 * trace.t))[:, None]

    problem = problem_of(np.random.default_rng(3), (Sensor.ACCEL,), humming)
    views = views_of(problem, {}, {})
    setting = setting_of(views)
    model = model_without_effects(setting)
    (left,) = excess_power(model)
    assert left.sensor is Sensor.ACCEL
    assert "Hz on accel" in left.text
    assert excess_power(model, floor={Sensor.ACCEL: 1e6}) == []
    assert excess_power(model, floor={Sensor.MAG: 1e6}) == [left]


def test_what_stands_for_several_effects_is_said_once():
    setting = setting_of(views_of(problem_of(np.random.default_rng(4), (Sensor.ACCEL,)), {}, {}))
    model = model_without_effects(setting)
    texts = ("approach with 10 s on accel, or accel_bias", "3 jumps on accel", "a drift on accel")
    causes = [UnnamedCause((("accel_bias", (i,)),), texts[j]) for i, j in enumerate((0, 1, 0))]
    found = unknown_of(
        model, (), causes, [Unexplained(50.0, texts[1], Sensor.ACCEL), Unexplained(50.0, texts[2], Sensor.ACCEL)]
    )
    assert found.shape == "; ".join(texts)


def test_drift_that_one_driver_moves_is_unknown_and_not_a_walk():
    def driven(trace):
        walk = np.cumsum(np.random.default_rng(7).normal(size=len(trace.t)))
        return np.outer(0.02 * walk, [0.6, -0.5, 0.6])

    few = tuple(e for e in catalogue() if e.id in {"accel_random_walk", "accel_bias", "accel_noise"})
    report = diagnose(problem_of(np.random.default_rng(2), (Sensor.ACCEL,), driven), effects=few, nested=False)
    assert report.unknown.flag
    assert report.unknown.hidden_driver is not None
    assert not any(e.id == "accel_random_walk" for e in report.effects)


@pytest.mark.long
def test_what_is_unknown_on_one_sensor_is_not_hidden_by_a_large_effect_on_another():
    def gap(trace):
        if trace.sensor is Sensor.GYRO:
            return np.full(3, 0.2)
        return np.outer(0.004 * (np.abs(trace.ideal[:, 0]) - 2.0) ** 2, [1.0, -0.6, 0.4])

    report = diagnose(problem_of(np.random.default_rng(5), (Sensor.ACCEL, Sensor.GYRO), gap), nested=False)
    assert [e.id for e in report.effects] == ["gyro_bias"]
    assert report.unknown.flag
    assert report.unknown.share < 0.03
    assert "accel" in report.unknown.shape


def ringing(trace):
    hits = (trace.t % 13.0)[:, None]
    return 0.3 * np.exp(-hits / 2.0) * np.sin(2.0 * np.pi * 0.8 * hits) * [1.0, 0.6, -0.4]


def two_fans(trace):
    one, other = (np.sin(2.0 * np.pi * hz * trace.t)[:, None] for hz in (7.0, 11.0))
    return 0.1 * one * [1.0, 0.2, 0.0] + 0.1 * other * [0.0, 0.3, 1.0]


@pytest.mark.long
def test_a_wave_that_comes_and_goes_is_no_steady_tone_however_many_explain_it():
    few = tuple(e for e in catalogue() if e.id in {"accel_tone", "accel_bias", "accel_noise"})
    rung = diagnose(problem_of(np.random.default_rng(6), (Sensor.ACCEL,), ringing), effects=few, nested=False)
    assert rung.unknown.flag
    assert "that comes and goes" in rung.unknown.shape
    assert not any(e.id == "accel_tone" for e in rung.effects)


@pytest.mark.long
def test_two_steady_tones_are_two():
    few = tuple(e for e in catalogue() if e.id in {"accel_tone", "accel_bias", "accel_noise"})
    fans = diagnose(problem_of(np.random.default_rng(6), (Sensor.ACCEL,), two_fans), effects=few, nested=False)
    assert [e.id for e in fans.effects] == ["accel_tone"] * 2
    assert not fans.unknown.flag


def attribution(key="gyro_tone", probability=0.0, unknown=1.0):
    return Attribution((key, (0,)), 20.0, 3, 0.5, probability, unknown, ())


def improbable(*attributions, beside_withdrawn=False):
    return improbable_effects(attributions, NAMED, beside_withdrawn=beside_withdrawn)


@pytest.mark.parametrize(
    ("probability", "unknown", "withdrawn", "named"),
    [(0.0, 1.0, False, False), (0.0, 0.0, True, False), (0.0, 0.0, False, True), (0.5, 0.5, True, True)],
)
def test_a_name_that_something_nameless_beats_is_none(probability, unknown, withdrawn, named):
    found = improbable(attribution(probability=probability, unknown=unknown), beside_withdrawn=withdrawn)
    assert [s.keys for s in found] == ([] if named else [(("gyro_tone", (0,)),)])


def test_names_of_one_sensor_are_one_difference():
    found = improbable(attribution(), attribution("gyro_bias"), attribution("mag_tone"))
    assert [s.text.split()[3] for s in found] == ["gyro", "mag"]


def test_a_difference_of_the_clock_belongs_to_no_sensor():
    assert [s.text.split()[3] for s in improbable(attribution("clock_drift"))] == ["clock"]
