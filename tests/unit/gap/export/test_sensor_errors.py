"""The sensor that a simulator should have reads what the diagnosis plays forward: two routes to one reading."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mavcal.calib.gap.effects import catalogue
from mavcal.calib.gap.effects.replay import with_effects_in
from mavcal.calib.gap.effects.traits import SensorTerm
from mavcal.calib.gap.export.sensor_errors import (
    doubt_text,
    matrix_of,
    named,
    recentred,
    sensors_with,
    term_of,
    value,
    vector,
)
from mavcal.calib.gap.problem import Trace
from mavcal.calib.gap.schema import EffectEstimate
from mavcal.calib.recording import Sensor
from mavcal.calib.simulate import SensorErrors
from tests.unit.gap.export.making import effect
from tests.unit.gap.synthetic import problem_of
from tests.unit.gap_report.flown import WEAK, WIND

TRACES = {t.sensor: t for t in problem_of(np.random.default_rng(4), (Sensor.ACCEL, Sensor.GYRO, Sensor.MAG)).traces}
SHAPED = [
    effect("accel_bias", bias=(0.3, -0.2, 0.15)),
    effect("mag_hard_iron", hard_iron=(-6.0, 4.0, -3.0)),
    effect("gyro_scale", scale=(0.01, -0.02, 0.03)),
    effect("accel_misalignment", misalignment={"xy": 0.01, "xz": -0.02, "yx": 0.03, "zx": 0.05, "zy": -0.06}),
    effect("mag_soft_iron", soft_iron={"xx": 0.02, "yy": -0.01, "zz": 0.03, "xy": 0.04, "xz": -0.02, "yz": 0.01}),
    effect("gyro_rotation", rotation=(0.02, -0.03, 0.05)),
    effect("accel_temp_linear", per_degc=(0.01, -0.02, 0.005), t_ref=20.0),
    effect("gyro_temp_poly", per_degc=(1e-3, 0, -1e-3), per_degc2=(0, 2e-5, 0), per_degc3=(0, 0, 2e-6), t_ref=31.0),
    effect("mag_temp_scale", scale_per_degc=(1e-5, -2e-5, 3e-5), t_ref=25.0),
    effect("gyro_g_sensitivity", g_sensitivity={"xx": 1e-3, "yx": 2e-3, "zy": -1e-3, "xz": 5e-4}),
]  # fmt: skip


def read(errors: SensorErrors, trace: Trace) -> np.ndarray:
    return errors.systematic(trace.ideal, trace.temperature, trace.force)


def played(trace: Trace, *effects: EffectEstimate) -> np.ndarray:
    [changed], lost = with_effects_in([trace], effects)
    assert lost == ()
    return changed.ideal


@pytest.mark.parametrize("found", SHAPED, ids=lambda found: found.id)
@pytest.mark.parametrize("t_ref", [20.0, 35.0])
def test_the_sensor_reads_what_the_effect_does(found: EffectEstimate, t_ref: float) -> None:
    trace = TRACES[found.sensor]
    state = sensors_with([found], t_ref=t_ref)
    assert state.rest == ()
    change = played(trace, found) - trace.ideal
    assert np.abs(change).max() > 0.0
    got = read(state.of(found.sensor, 1), trace) - trace.ideal
    np.testing.assert_allclose(got, change, atol=2e-3 * np.abs(change).max())


def test_effects_of_one_sensor_add_up() -> None:
    several = [SHAPED[0], SHAPED[6], effect("accel_bias", bias=(0.1, 0.1, 0.1))]
    trace = TRACES[Sensor.ACCEL]
    np.testing.assert_allclose(
        read(sensors_with(several).of(Sensor.ACCEL, 1), trace), played(trace, *several), atol=1e-9
    )


@settings(max_examples=10)
@given(st.lists(st.floats(-0.01, 0.01), min_size=9, max_size=9), st.floats(-20.0, 60.0), st.floats(-20.0, 60.0))
def test_a_drift_may_be_stated_about_any_temperature(table: list[float], before: float, after: float) -> None:
    errors = SensorErrors(temperature=np.reshape(table, (3, 3)), t_ref=before, bias=np.array([1.0, 2.0, 3.0]))
    trace = TRACES[Sensor.ACCEL]
    moved = recentred(errors, after)
    if np.any(table):
        assert moved.t_ref == after
    np.testing.assert_allclose(read(moved, trace), read(errors, trace), atol=1e-6)


def test_what_the_simulator_has_stays_and_its_sensor_is_turned_as_a_whole() -> None:
    base = SensorErrors(bias=np.array([1.0, 2.0, 3.0]), matrix=np.diag([2.0, 1.0, 1.0]), noise_density=np.full(3, 3e-3))
    found = [effect("gyro_scale", scale=(0.1, 0.0, 0.0)), effect("gyro_noise", density=(4e-3, 0.0, 0.0))]
    made = sensors_with(found, {(Sensor.GYRO, 1): base}).of(Sensor.GYRO, 1)
    np.testing.assert_allclose(made.matrix, np.diag([2.2, 1.0, 1.0]))
    np.testing.assert_allclose(made.bias, [1.0, 2.0, 3.0])
    np.testing.assert_allclose(made.noise_density, [5e-3, 3e-3, 3e-3])  # in power
    untouched = sensors_with([], {(Sensor.GYRO, 1): base})
    assert untouched.instances == ()


@pytest.mark.parametrize(
    ("found", "field", "expected"),
    [
        (effect("mag_flicker", instability=(1.0, 2.0, 3.0)), "bias_instability", [1.0, 2.0, 3.0]),
        (effect("mag_random_walk", random_walk=(1.0, 2.0, 3.0)), "random_walk", [1.0, 2.0, 3.0]),
        (effect("mag_saturation", limit=60.0), "full_scale", 60.0),
        (effect("mag_quantisation", lsb=(0.1, 0.3, 0.2)), "resolution", 0.3),  # of the coarsest axis
        (effect("mag_thermal_lag", per_degc=(0.1, 0, 0), lag_s=20.0), "thermal_lag", -20.0),
        (effect("mag_temp_scale", scale_per_degc=(1e-3, 0, 0), t_ref=25.0), "temperature_scale", [1e-3, 0.0, 0.0]),
    ],
    ids=lambda found: getattr(found, "id", ""),
)
def test_noise_range_and_resolution_have_fields_of_their_own(found, field, expected) -> None:
    made = getattr(sensors_with([found]).of(Sensor.MAG, 1), field)
    np.testing.assert_allclose(made, expected)


def test_each_instance_has_its_own_and_what_has_no_field_is_left_over() -> None:
    delay = effect("gyro_delay", delay_s=0.01)
    state = sensors_with(
        [effect("gyro_bias", (1, 3), bias=(0.1, 0, 0)), delay, effect("accel_bias", (2,), bias=(1.0, 0, 0))]
    )
    assert state.rest == (delay,)
    assert state.instances == (1, 2, 3)
    assert [state.of(Sensor.GYRO, k).bias[0] for k in (1, 2, 3)] == [0.1, 0.0, 0.1]
    assert state.of(Sensor.ACCEL, 2).bias[0] == 1.0


def test_a_matrix_is_symmetric_where_its_effect_is_and_a_rotation_is_one() -> None:
    iron = matrix_of(effect("mag_soft_iron", soft_iron={"xy": 0.1, "xz": 0.2, "yz": 0.3, "xx": 0.4}))
    np.testing.assert_allclose(iron, iron.T)
    np.testing.assert_allclose(iron[0], [0.4, 0.1, 0.2])
    turned = np.eye(3) + matrix_of(effect("accel_rotation", rotation=(0.3, -0.2, 0.5)))
    np.testing.assert_allclose(turned @ turned.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(turned) == pytest.approx(1.0)


@pytest.mark.parametrize("term", SensorTerm)
def test_every_term_is_that_of_an_effect_and_changes_a_field_of_the_sensor(term: SensorTerm) -> None:
    having = {e.id for e in catalogue() if e.term is term}
    assert having
    for id_ in having:
        stated = effect(id_)
        stated = replace(stated, params=tuple(replace(p, value=0.01) for p in stated.params))
        state = sensors_with([stated])
        assert state.rest == ()
        made, ideal = state.of(stated.sensor, 1), SensorErrors()
        names = [f.name for f in fields(ideal) if f.name != "t_ref"]
        assert not all(np.array_equal(getattr(made, name), getattr(ideal, name)) for name in names)


def test_an_effect_without_a_term_is_left_over() -> None:
    for id_ in ("accel_tone", "gyro_rotor_noise", "mag_step"):
        assert term_of(effect(id_)) is None
    assert term_of(replace(SHAPED[0], id="accel_of_another_version")) is None
    odd = replace(SHAPED[0], id="accel_of_another_version")
    assert sensors_with([odd, SHAPED[0]]).rest == (odd,)


def test_an_effect_is_spoken_of_by_its_instances() -> None:
    assert named(SHAPED[1]) == "mag_hard_iron of instance 1"
    assert named(replace(SHAPED[1], instances=(1, 2))) == "mag_hard_iron of instances 1, 2"
    assert doubt_text(SHAPED[1]).startswith("mag_hard_iron of instance 1: it has a probability of 0.99")
    assert vector(SHAPED[1], "hard_iron").tolist() == [-6.0, 4.0, -3.0]
    assert value(SHAPED[1], "no_such") == 0.0


def test_an_effect_of_the_airframe_is_of_no_sensor() -> None:
    found = sensors_with((effect("accel_bias", bias=(0.3, 0.0, 0.0)), WEAK, WIND))
    assert set(found.errors) == {(Sensor.ACCEL, 1)}
    assert found.rest == (WEAK, WIND)
    assert [named(e) for e in found.rest] == ["motor_weak of motor 3", "wind"]
