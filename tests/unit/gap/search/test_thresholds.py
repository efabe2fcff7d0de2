"""What joins a model, and what of it is told, where two recordings differ anyway."""

from __future__ import annotations

import pytest

from mavcal.calib.gap.effects import by_id, catalogue
from mavcal.calib.gap.model.hypotheses import Hypothesis
from mavcal.calib.gap.problem import MinimumGain
from mavcal.calib.gap.search.thresholds import GainThresholds
from mavcal.calib.recording import Sensor

ACCEL = Sensor.ACCEL
LEAST = MinimumGain(
    steady_entry={ACCEL: 3.0},
    steady_report={ACCEL: 30.0},
    level={ACCEL: 6.0},
    noise_entry={ACCEL: 1.0},
    noise_report={ACCEL: 300.0},
    drift_entry={ACCEL: 2.0},
)


def of(name):
    return Hypothesis(next(e for e in catalogue() if e.id == name and not e.form), (0,))


@pytest.mark.parametrize(
    ("name", "joining", "reporting"),
    [
        ("accel_scale", 3.0, 30.0),
        ("accel_lever_arm", 3.0, 30.0),
        ("accel_bias", 6.0, 3.0),
        ("accel_step", 6.0, 3.0),
        ("accel_temp_linear", 6.0, 3.0),
        ("accel_noise", 1.0, 300.0),
        ("accel_flicker", 2.0, 300.0),
        ("accel_rotor_noise", 2.0, 300.0),
        ("accel_random_walk", 2.0, 300.0),
        ("gyro_scale", 0.0, 0.0),
        ("gyro_noise", 0.0, 0.0),
    ],
)
def test_each_kind_has_its_own(name, joining, reporting):
    thresholds = GainThresholds(LEAST)
    assert thresholds.to_enter(of(name)) == joining
    assert thresholds.to_report(of(name)) == reporting


def test_what_nuisance_effects_leave_open_comes_on_top():
    thresholds = GainThresholds(LEAST, {of("accel_scale").key: 100.0, of("accel_bias").key: 50.0})
    assert thresholds.to_report(of("accel_scale")) == 130.0
    assert thresholds.to_enter(of("accel_scale")) == 3.0
    assert thresholds.to_enter(of("accel_bias")) == 56.0
    assert thresholds.to_enter(of("accel_step")) == 6.0


def test_without_a_floor_everything_joins_and_is_told():
    thresholds = GainThresholds()
    for effect_id in by_id():
        if not any(effect_id.endswith(e) for e in ("_quantisation", "_hold")):
            assert thresholds.to_enter(of(effect_id)) == thresholds.to_report(of(effect_id)) == 0.0
    assert thresholds.lasting(ACCEL) == 0.0
