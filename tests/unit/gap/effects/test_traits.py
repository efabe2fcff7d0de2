"""Kinds of effects are told by their traits, and nowhere by parts of their ids."""

from __future__ import annotations

import re
from collections import defaultdict
from pathlib import Path

import pytest

from mavcal.calib.gap.effects import catalogue
from mavcal.calib.gap.effects.base import NoiseEffect
from mavcal.calib.gap.effects.traits import Trait

CALIB = Path(__file__).parents[4] / "calib"


def test_an_effect_has_the_same_traits_and_the_same_term_on_every_sensor() -> None:
    traits = defaultdict(set)
    for effect in catalogue():
        traits[effect.id.removeprefix(f"{effect.sensor}_")].add((effect.traits, effect.term))
    assert {kind: found for kind, found in traits.items() if len(found) > 1} == {}


@pytest.mark.parametrize(
    ("trait", "implied"), [(Trait.JUMPING, Trait.LEVEL), (Trait.THERMAL, Trait.LEVEL), (Trait.SIZE, Trait.STEADY)]
)
def test_one_trait_implies_another(trait: Trait, implied: Trait) -> None:
    having = [effect for effect in catalogue() if trait in effect.traits]
    assert having
    assert [effect.id for effect in having if implied not in effect.traits] == []


@pytest.mark.parametrize("trait", [Trait.WANDERING, Trait.BROADBAND])
def test_only_noise_wanders_or_is_broadband(trait: Trait) -> None:
    having = [effect for effect in catalogue() if trait in effect.traits]
    assert having
    assert all(isinstance(effect, NoiseEffect) for effect in having)


def test_what_happens_once_can_happen_again_and_has_its_moment_as_shape() -> None:
    for effect in catalogue():
        if effect.jumps:
            assert effect.repeatable
            assert effect.shape is not None
            assert effect.shape.parameter.name == "time_s"


TAKEN_APART = re.compile(
    r"(?:\beffect_?id|\b\w+\.id|key\[0\]|\bk\[0\])"
    r"(?:\.(?:endswith|startswith|r?partition|r?split|remove(?:pre|suf)fix|find|index)\(|\[-?\d*:)"
    r"|== f\"\{[\w.]*sensor[\w.]*\}_|split\((?:\"[_~]|_FORM)"
)
"""An id in front of a method that takes it apart, or one that is put together to compare with."""


def test_no_module_goes_by_parts_of_an_effects_id() -> None:
    paths = [p for room in ("gap", "gap_report", "simulate") for p in sorted((CALIB / room).rglob("*.py"))]
    assert len(paths) > 100
    assert [str(p.relative_to(CALIB)) for p in paths if TAKEN_APART.search(p.read_text(encoding="utf-8"))] == []


@pytest.mark.parametrize(
    "line",
    [
        'e.id.removeprefix(f"{e.sensor}_")',
        'effect.id.split("_", 1)[0]',
        "one.id[4:]",
        'e.id == f"{fit.sensor.value}_step"',
        'name.split("~")[0]',
    ],
)
def test_an_id_that_is_taken_apart_is_seen(line: str) -> None:
    assert TAKEN_APART.search(line)


def test_no_effect_of_the_catalogue_is_nameless() -> None:
    assert not any(effect.nameless or effect.part for effect in catalogue())


def test_jumps_and_tones_are_what_they_are_called() -> None:
    named = {effect.id: effect for effect in catalogue()}
    assert {i for i, e in named.items() if e.jumps} == {f"{s}_step" for s in ("accel", "gyro", "mag")}
    assert {i for i, e in named.items() if e.tonal} == {f"{s}_tone" for s in ("accel", "gyro", "mag")}
