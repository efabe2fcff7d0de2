"""What joins a model, and what of it is told, where two recordings differ anyway."""

from __future__ import annotations

import pytest

from mavcal.calib.gap.effects import by_id, catalogue
from mavcal.calib.gap.model.hypotheses import Hypothesis
from mavcal.calib.gap.problem import Floor
from mavcal.calib.gap.search.thresholds import GainThresholds
from mavcal.calib.recording import Sensor

ACCEL = Sensor.ACCEL
FLOOR = Floor(joins={ACCEL: 3.0}, lasting={ACCEL: 30.0}, level={ACCEL: 6.0}, noise={ACCEL: 1.0}, loud={ACCEL: 300.0})


def of(name):
    return Hypothesis(next(e for e in catalogue() if e.id == name and not e.form), (0,))


@pytest.mark.parametrize(
    ("name", "joining", "telling"),
    [
        ("accel_scale", 3.0, 30.0),
        ("accel_lever_arm", 3.0, 30.0),
        ("accel_bias", 6.0, 3.0),
        ("accel_step", 6.0, 3.0),
        ("accel_temp_linear", 6.0, 3.0),
        ("accel_noise", 1.0, 300.0),
        ("gyro_scale", 0.0, 0.0),
        ("gyro_noise", 0.0, 0.0),
    ],
)
def test_each_kind_has_its_own(name, joining, telling):
    floors = GainThresholds(FLOOR)
    assert floors.joining(of(name)) == joining
    assert floors.telling(of(name)) == telling


def test_what_flaws_leave_open_comes_on_top():
    floors = GainThresholds(FLOOR, {of("accel_scale").key: 100.0, of("accel_bias").key: 50.0})
    assert floors.telling(of("accel_scale")) == 130.0
    assert floors.joining(of("accel_scale")) == 3.0
    assert floors.joining(of("accel_bias")) == 56.0
    assert floors.joining(of("accel_step")) == 6.0


def test_without_a_floor_everything_joins_and_is_told():
    floors = GainThresholds()
    for effect_id in by_id():
        if not any(effect_id.endswith(e) for e in ("_quantisation", "_hold")):
            assert floors.joining(of(effect_id)) == floors.telling(of(effect_id)) == 0.0
    assert floors.lasting(ACCEL) == 0.0
