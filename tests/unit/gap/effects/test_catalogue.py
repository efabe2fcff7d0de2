"""The catalogue as a whole: ids, units, shapes of what it gives, and the page that lists it."""

from __future__ import annotations

import dataclasses
import re
from collections import Counter

import numpy as np
import pytest

from mavcal.calib.gap.effects import by_id, catalogue, forward_models, parameter_table
from mavcal.calib.gap.effects.base import LatticeEffect, MeanEffect, NoiseEffect
from mavcal.calib.recording import Sensor
from scripts import effects

from .conftest import make

BOTH = """
    rotation temp_linear temp_poly temp_scale thermal_lag noise random_walk flicker rotor_noise quantisation saturation
    dead_band step delay low_pass hold tone
"""
INERTIAL = "bias scale misalignment vibration vibration_rectification aliasing" + BOTH
MAGNETIC = "hard_iron soft_iron motor_current earth_field field_gradient" + BOTH
LIMITS = {f"{sensor}_{kind}" for sensor in ("accel", "gyro", "mag") for kind in ("saturation", "dead_band")}
LATE = {"mag_motor_current"}
SLOW = {f"{sensor}_step" for sensor in ("accel", "gyro", "mag")}
LINES = {f"{sensor}_{kind}" for sensor in ("accel", "gyro") for kind in ("vibration", "aliasing")}


def test_every_kind_of_the_schema_is_there_and_nothing_else():
    expected = {f"{sensor}_{kind}" for sensor in ("accel", "gyro") for kind in INERTIAL.split()}
    expected |= {f"mag_{kind}" for kind in MAGNETIC.split()}
    expected |= {"accel_lever_arm", "accel_nonlinearity", "gyro_g_sensitivity", "clock_drift", "reference_attitude"}
    assert set(by_id()) == expected
    assert Counter(e.id for e in catalogue()) == {
        name: 1 + (name in LIMITS | LINES | SLOW) + 2 * (name in LATE) for name in expected
    }


def test_an_end_of_the_range_is_sought_in_the_samples_and_in_the_mean():
    for name in LIMITS:
        assert isinstance(by_id()[name], LatticeEffect)
        assert isinstance(forward_models()[name][-1], MeanEffect)


def test_a_line_is_power_or_a_wave_and_both_compete_under_names_of_their_own():
    for name in LINES:
        forms = {e.form: type(e) for e in catalogue() if e.id == name}
        assert forms == {"~wave": MeanEffect, "": NoiseEffect}
    names = [e.id + e.form for e in catalogue() if not isinstance(e, LatticeEffect)]
    assert len(set(names)) == len(names)


def test_a_lag_of_the_current_and_a_gradual_step_are_forms_of_their_effects():
    assert {e.form for e in catalogue() if e.id in LATE} == {"", "~late", "~throttle"}
    for name in SLOW:
        assert {e.form for e in catalogue() if e.id == name} == {"", "~slow"}


def test_rivals_exist_and_every_effect_says_what_excites_it_and_what_helps():
    for effect in catalogue():
        assert set(effect.rivals) <= set(by_id()) - {effect.id}, effect.id
        assert effect.rivals, effect.id
        assert effect.excited_by, effect.id
        assert effect.fix, effect.id
        assert effect.plain, effect.id


@pytest.mark.long
@pytest.mark.parametrize("effect", catalogue(), ids=lambda effect: effect.id)
@pytest.mark.parametrize("seconds", [70.0, 0.6])
def test_what_it_gives_has_the_shape_that_its_parameters_say(effect, seconds):
    for sensor in Sensor if effect.shared else (effect.sensor,):
        if sensor not in (Sensor.ACCEL, Sensor.GYRO, Sensor.MAG):
            continue
        trace = make(sensor, seconds=seconds)
        for array in (trace.measured, trace.ideal, trace.observed, trace.attitude, trace.temperature):
            array.setflags(write=False)
        if effect.missing(trace) is not None:
            continue
        _check(effect, trace)


def _check(effect, trace):
    n, thetas = len(trace.t), [np.nan]
    if effect.shape is not None:
        grid = effect.shape.grid(trace)
        assert len(grid) > 0
        assert (np.diff(grid) > 0.0).all()
        thetas = [grid[0], grid[-1]]
        if effect.shape.screen is not None:
            found = effect.shape.screen(trace, trace.residual + np.sin(trace.t)[:, None])
            assert 1 <= len(found) <= 20
            assert (found >= grid[0]).all()
            assert (found <= grid[-1]).all()
    omega = np.pi * np.arange(n) / n
    for theta in thetas:
        if isinstance(effect, MeanEffect):
            columns = effect.columns(trace, theta)
            assert columns.shape == (1 if effect.fixed else len(effect.parameters), n, 3)
            assert np.isfinite(columns).all()
            if effect.signals is not None:
                for q, signal in enumerate(effect.signals(trace, theta)):
                    for axis in range(3):
                        np.testing.assert_array_equal(columns[3 * q + axis, :, axis], signal)
            if effect.noise_gain is not None:
                assert (effect.noise_gain(trace, omega, theta)[0] <= 1.0).all()
        elif isinstance(effect, NoiseEffect):
            density = effect.density(trace, omega, theta)
            assert density.shape == (len(effect.parameters) // 3, n)
            assert np.isfinite(density).all()
            assert (density >= 0.0).all()
            if effect.variance is not None:
                assert effect.variance(trace).mean() == pytest.approx(1.0)
        else:
            assert isinstance(effect, LatticeEffect)
            found = effect.detect(trace)
            assert found is None or len(found.values) == len(found.se) == len(effect.parameters)


def test_the_table_of_parameters_names_each_one_once_with_its_unit():
    for effect in catalogue():
        rows = parameter_table()[effect.id]
        own = effects.estimated(effect)
        assert set(own) <= set(rows)
        if effect.id not in LIMITS | LINES | LATE:
            assert list(rows) == own
        assert len({r.name for r in rows}) == len(rows) > 0
        assert all(r.unit for r in rows)


def test_no_trace_changes():
    trace = make(Sensor.GYRO, seconds=20.0)
    before = {
        f.name: np.copy(v) for f in dataclasses.fields(trace) if isinstance(v := getattr(trace, f.name), np.ndarray)
    }
    for effect in catalogue():
        if effect.sensor == Sensor.GYRO and effect.missing(trace) is None:
            _check(effect, trace)
    for name, value in before.items():
        np.testing.assert_array_equal(getattr(trace, name), value)


def test_the_page_lists_the_catalogue_as_it_is():
    page = effects.PAGE.read_text(encoding="utf-8")
    assert effects.with_tables(page) == page, "scripts/effects writes it"


def test_every_parameter_has_its_sign_and_unit_on_the_page():
    """`quadratic` and `exponent` had none."""
    _, _, rest = effects.PAGE.read_text(encoding="utf-8").partition("## Signs and units\n")
    section, _, _ = rest.partition("\n## ")
    said = set(re.findall(r"`([a-z_0-9]+)(?:\.[a-z]+)?`", section))
    stems = {p.name.partition(".")[0] for params in parameter_table().values() for p in params}
    assert stems - said == set()
