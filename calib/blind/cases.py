"""Cases: a mission, sensors, what is wrong with them and how much, all drawn from one seed."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.blind import nuisance
from mavcal.calib.blind.effects import KNOWN, UNKNOWN
from mavcal.calib.blind.effects.kind import Kind
from mavcal.calib.blind.missions import ALL, MissionKind, Rng, World, make_mission
from mavcal.calib.blind.render import Columns, render
from mavcal.calib.blind.sensors import Effect, Suite, draw_suite
from mavcal.calib.blind.severity import draw_severity, net_severity, severity, with_severity

Array = NDArray[np.float64]

FIRST_SEALED = 1_000_000
"""Seeds below are for development; from here on a case is run once, for the table."""

LADDER = (5.0, 10.0, 20.0, 30.0, 45.0, 70.0, 120.0, 300.0)
LINEAR = (
    *("accel_bias", "gyro_bias", "mag_hard_iron", "accel_scale", "gyro_scale", "accel_misalignment", "gyro_rotation"),
    *("gyro_g_sensitivity", "accel_temp_linear", "gyro_temp_linear", "mag_motor_current", "accel_lever_arm"),
)
"""Effects of the power ladder: linear, so that the limit of a likelihood-ratio test is known."""

FAMILIES: tuple[frozenset[str], ...] = (
    frozenset({"bias", "hard_iron", "step"}),
    frozenset({"scale", "misalignment", "rotation", "soft_iron"}),
    frozenset({"temp_linear", "temp_poly", "temp_scale", "thermal_lag"}),
    frozenset({"g_sensitivity"}),
    frozenset({"lever_arm"}),
    frozenset({"vibration", "vibration_rectification", "aliasing", "rotor_noise", "tone"}),
    frozenset({"noise", "random_walk", "flicker"}),
    frozenset({"quantisation", "saturation", "dead_band", "hold"}),
    frozenset({"delay", "low_pass", "drift"}),
    frozenset({"motor_current"}),
    frozenset({"earth_field", "field_gradient"}),
    frozenset({"attitude"}),
)
"""Kinds that leave the catalogue together when a whole family is left out."""


class Tier(StrEnum):
    """What a case tries. T8 and T9, simulators' flights and real recordings, are files and not made here."""

    NULL = "T0"
    SINGLE = "T1"
    LADDER = "T2"
    MIXED = "T3"
    LEFT_OUT = "T4"
    UNKNOWN = "T5"
    KNOWN_AND_UNKNOWN = "T6"
    NUISANCE = "T7"
    NULL_TILTED = "T10"


@dataclass(frozen=True, eq=False)
class Case:
    """One sealed case.

    Parameters
    ----------
    id
        Random digits that say nothing.
    tier, seed
        They make the case again.
    real, sim
        The two logs as columns.
    without
        Effect ids that the catalogue must do without.
    label
        What was put in: never given to the diagnosis.
    """

    id: str
    tier: Tier
    seed: int
    real: Columns
    sim: Columns
    without: tuple[str, ...]
    label: Mapping[str, Any]


@dataclass(frozen=True, eq=False)
class _Draft:
    """A case before it is rendered."""

    world: World
    suite: Suite
    effects: tuple[tuple[Kind, Effect], ...]
    nuisance: str | None = None
    without: tuple[str, ...] = ()


def make_case(tier: Tier, seed: int) -> Case:
    """The case of that tier and seed; the same digits every time."""
    rng, draft, label = _begun(tier, seed)
    extra: list[Effect] = []
    if draft.nuisance is not None and draft.nuisance in nuisance.EFFECTS:
        extra.append(nuisance.EFFECTS[draft.nuisance](rng, draft.world))
    real, sim = render(draft.world, draft.suite, [*(e for _, e in draft.effects), *extra], rng)
    if draft.nuisance is not None and draft.nuisance in nuisance.LOGS:
        real, sim = nuisance.LOGS[draft.nuisance](real, sim, draft.world, rng)
    return Case(str(label["id"]), tier, seed, real, sim, draft.without, label)


def make_label(tier: Tier, seed: int) -> dict[str, Any]:
    """Only what was put in: for the seal."""
    return _begun(tier, seed)[2]


def _begun(tier: Tier, seed: int) -> tuple[Rng, _Draft, dict[str, Any]]:
    rng = np.random.default_rng([seed, int(tier.value[1:])])
    draft = _drafts(tier, rng)
    name = hashlib.sha256(f"mavcal {tier} {seed} {rng.integers(2**62)}".encode()).hexdigest()[:16]
    return rng, draft, _label(name, tier, seed, draft)


def _drafts(tier: Tier, rng: Rng) -> _Draft:
    match tier:
        case Tier.NULL:
            return _Draft(make_mission(_any(rng, ALL), rng), draw_suite(rng), ())
        case Tier.NULL_TILTED:
            return _Draft(make_mission(_any(rng, ALL), rng), draw_suite(rng), (), "reference_0.3_deg")
        case Tier.SINGLE:
            return _with(rng, [_pick(rng, KNOWN)])
        case Tier.LADDER:
            kind = _pick(rng, [k for k in KNOWN if k.id in LINEAR])
            return _with(rng, [kind], sizes=[float(rng.choice(LADDER))])
        case Tier.MIXED:
            return _with(rng, _several(rng, int(rng.choice([2, 3]))))
        case Tier.LEFT_OUT:
            kind = _pick(rng, KNOWN)
            whole = rng.random() < 0.5
            return _with(rng, [kind], without=family(kind.id) if whole else (kind.id,))
        case Tier.UNKNOWN:
            return _with(rng, [_pick(rng, UNKNOWN)])
        case Tier.KNOWN_AND_UNKNOWN:
            return _with(rng, [*_several(rng, int(rng.choice([1, 2]))), _pick(rng, UNKNOWN)])
        case Tier.NUISANCE:
            names = nuisance.NUISANCES
            chosen = names[int(rng.integers(len(names)))]
            kinds = [_pick(rng, KNOWN)] if rng.random() < 0.5 else []
            return _with(rng, kinds, nuisance_name=chosen)


def _any(rng: Rng, missions: Sequence[MissionKind]) -> MissionKind:
    return missions[int(rng.integers(len(missions)))]


def _pick(rng: Rng, kinds: Sequence[Kind]) -> Kind:
    return kinds[int(rng.integers(len(kinds)))]


def _several(rng: Rng, count: int) -> list[Kind]:
    """Distinct kinds that some mission excites together, and not two that cut the same samples."""
    for _ in range(1000):
        kinds = [_pick(rng, KNOWN) for _ in range(count)]
        cut = [k.sensor for k in kinds if k.id.endswith(("hold", "saturation", "quantisation", "dead_band"))]
        if len({k.id for k in kinds}) == count and len(set(cut)) == len(cut) and _common(kinds):
            return kinds
    raise AssertionError("kinds that no mission excites together")


def _common(kinds: Sequence[Kind]) -> list[MissionKind]:
    return [m for m in ALL if all(m in k.missions for k in kinds)]


def _with(
    rng: Rng,
    kinds: Sequence[Kind],
    *,
    sizes: Sequence[float] | None = None,
    nuisance_name: str | None = None,
    without: tuple[str, ...] = (),
) -> _Draft:
    """The kinds at drawn severities on a mission that excites them all; another mission where no size will do."""
    missions = _common(kinds)
    if not missions:  # a known and an unknown type that need different ones
        missions = [MissionKind.FULL]
    targets = list(sizes) if sizes is not None else [draw_severity(rng) for _ in kinds]
    for _ in range(12):
        world = make_mission(_any(rng, missions), rng)
        suite = draw_suite(rng)
        effects: list[tuple[Kind, Effect]] = []
        for kind, target in zip(kinds, targets, strict=True):
            made = with_severity(world, suite, kind.draw(rng, world, suite, kind.sensor), kind.bounds, target)
            if made is not None:
                effects.append((kind, made))
        if len(effects) == len(kinds):
            return _Draft(world, suite, tuple(effects), nuisance_name, without)
    # Some kinds have a least size in some missions: then severity is drawn again, never clipped to the edge.
    return _with(rng, kinds, nuisance_name=nuisance_name, without=without)


def split(effect_id: str) -> tuple[str, str]:
    """Sensor and kind of an id."""
    sensor, _, kind = effect_id.partition("_")
    return sensor, kind


def family(effect_id: str) -> tuple[str, ...]:
    """Ids of the same sensor that leave the catalogue with `effect_id`."""
    sensor, kind = split(effect_id)
    kinds = next(f for f in FAMILIES if kind in f)
    return tuple(sorted({k.id for k in KNOWN if split(k.id)[0] == sensor and split(k.id)[1] in kinds}))


def _label(name: str, tier: Tier, seed: int, draft: _Draft) -> dict[str, Any]:
    def entry(kind: Kind, effect: Effect) -> dict[str, Any]:
        return {
            "id": effect.id,
            "sensor": kind.sensor,
            "lambda": round(float(severity(draft.world, draft.suite, effect)), 6),
            "net_lambda": round(float(net_severity(draft.world, draft.suite, effect)), 6),
            "df": kind.df,
            "foreseen": kind.foreseen,
            "predictable": kind.predictable,
            "params": {key: float(value) for key, value in effect.truth.items()},
        }

    entries = [entry(kind, effect) for kind, effect in draft.effects]
    return {
        "id": name,
        "tier": tier.value,
        "seed": seed,
        "mission": draft.world.kind.value,
        "suite": {s: [float(q.sd), float(q.step), int(q.every)] for s, q in draft.suite.items()},
        "effects": [e for e in entries if not e["id"].startswith("unknown_")],
        "unknown": [e for e in entries if e["id"].startswith("unknown_")],
        "nuisance": draft.nuisance,
        "without": list(draft.without),
    }
