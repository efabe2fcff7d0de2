"""The catalogue: every effect that can be named, one family a file."""

from __future__ import annotations

from functools import cache

from mavcal.calib.gap.effects import (
    affine,
    dynamics,
    events,
    lattice,
    limits,
    magnetic,
    noise,
    nonlinear,
    reference_attitude,
    temperature,
    timing,
    tone,
    vibration,
)
from mavcal.calib.gap.effects.base import CatalogueEffect, EffectParameter, MeanEffect, NoiseEffect

_FAMILIES = (
    limits,
    lattice,
    affine,
    nonlinear,
    magnetic,
    temperature,
    dynamics,
    vibration,
    noise,
    tone,
    timing,
    events,
    reference_attitude,
)


@cache
def catalogue() -> tuple[CatalogueEffect, ...]:
    """Every effect, sensor by sensor within each family."""
    return tuple(effect for family in _FAMILIES for effect in family.EFFECTS)


@cache
def by_id() -> dict[str, CatalogueEffect]:
    """The catalogue by the effects' ids."""
    return {effect.id: effect for effect in catalogue()}


@cache
def forward_models() -> dict[str, tuple[MeanEffect | NoiseEffect, ...]]:
    """By id, every form of the effects on mean or noise, without lattice effects."""
    found: dict[str, tuple[MeanEffect | NoiseEffect, ...]] = {}
    for effect in catalogue():
        if isinstance(effect, MeanEffect | NoiseEffect):
            found[effect.id] = (*found.get(effect.id, ()), effect)
    return found


@cache
def parameter_table() -> dict[str, tuple[EffectParameter, ...]]:
    """Parameters by effect: amplitudes, then the shape (GAP 8).

    An effect found in the lattice or in the mean has the parameters of both.
    """
    table: dict[str, tuple[EffectParameter, ...]] = {}
    for e in catalogue():
        own = e.parameters + ((e.shape.parameter,) if e.shape is not None else ())
        table[e.id] = tuple(dict.fromkeys((*table.get(e.id, ()), *own)))
    return table
