from __future__ import annotations

import pytest

from mavcal.calib.gap.effects import catalogue
from mavcal.calib.gap.effects.shape_ids import family_of, is_part, is_shape, shape_id


@pytest.mark.parametrize("part", [False, True])
def test_an_id_says_its_family_and_whether_it_is_a_part(part):
    made = shape_id("line", "function of a_x on accel.x: one of many", part=part)
    assert is_shape(made)
    assert family_of(made) == "line"
    assert is_part(made) is part


def test_no_effect_of_the_catalogue_is_nameless():
    assert not any(effect.nameless for effect in catalogue())


def test_jumps_and_tones_are_what_they_are_called():
    named = {effect.id: effect for effect in catalogue()}
    assert {i for i, e in named.items() if e.jumps} == {f"{s}_step" for s in ("accel", "gyro", "mag")}
    assert {i for i, e in named.items() if e.tonal} == {f"{s}_tone" for s in ("accel", "gyro", "mag")}
