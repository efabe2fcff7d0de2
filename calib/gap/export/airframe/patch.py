"""Settings of a simulator that reproduce the airframe effects of a report: for all effects together, and for each."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from mavcal.calib.airframe.answer import Domain, Geometry
from mavcal.calib.errors import InvalidInputError
from mavcal.calib.gap.export.airframe import sih, sitl
from mavcal.calib.gap.export.airframe.frame import frame_of
from mavcal.calib.gap.export.airframe.wanted import missing, wanted_of
from mavcal.calib.gap.schema import EffectEstimate

_MILLIAMPERE_HOURS = 1e-3
"""Ah in a mAh. Source: definition."""


@dataclass(frozen=True)
class Patch:
    """Keys of the simulator's frame file, parameters to load, notes on what they cannot represent, and advice."""

    frame_json: Mapping[str, Any] = field(default_factory=dict)
    parameters: Mapping[str, float] = field(default_factory=dict)
    lost: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()


def airframe_effects(effects: Iterable[EffectEstimate]) -> tuple[EffectEstimate, ...]:
    """The effects of the airframe, without those of the day's air, which are not settings of a vehicle."""
    return tuple(e for e in effects if e.domain is Domain.AIRFRAME)


def is_sih(simulator: Mapping[str, float]) -> bool:
    """Whether the parameters are of PX4's simulation in hardware; else the simulator is taken for ArduPilot's."""
    return any(name.startswith("SIH_") for name in simulator)


def airframe_patch(
    effects: Sequence[EffectEstimate],
    simulator: Mapping[str, float],
    frame: Mapping[str, Any] | None = None,
    *,
    geometry: Geometry | None = None,
    mass: float | None = None,
    vehicle: Mapping[str, float] | None = None,
) -> Patch:
    """Settings with which the simulator has all of `effects`, solved together.

    Parameters
    ----------
    effects
        Of a report; those of other domains are left alone.
    simulator
        Parameters of the simulator's log: SIH_* say that it is PX4's, and what it has. Else it is ArduPilot's.
    frame
        Keys of the frame file that ArduPilot's simulator was flown with; None: the stock frame.
    geometry
        Where the motors sit, for what needs it; None: not known.
    mass
        Of the real vehicle, kg. None: not known; thrust, drag and inertia are right as ratios to the simulator's mass.
    vehicle
        Parameters of the real vehicle: its battery's capacity (BATT_CAPACITY).

    Raises
    ------
    InvalidInputError
        If `mass` is not above 0, or the frame has a key that is no number.
    """
    if mass is not None and not mass > 0.0:
        raise InvalidInputError(f"the mass is {mass:g} kg: it must be above 0")
    chosen = airframe_effects(effects)
    wanted = wanted_of(chosen)
    simulator = {name: float(v) for name, v in simulator.items() if math.isfinite(float(v))}
    if is_sih(simulator):
        reasons, made = sih.REASONS, sih.sih_settings(wanted, simulator, mass=mass)
    else:
        charge = (vehicle or {}).get("BATT_CAPACITY", 0.0) * _MILLIAMPERE_HOURS
        stock = frame_of(frame, simulator, geometry)
        reasons = sitl.REASONS
        made = sitl.sitl_settings(wanted, stock, simulator, mass=mass, capacity=charge if charge > 0.0 else None)
    notes = (*made.notes, *_of_mass(chosen, mass))
    lost = tuple(dict.fromkeys((*missing(chosen, reasons), *made.lost)))
    return Patch(made.frame, made.parameters, lost, notes)


def _of_mass(effects: Iterable[EffectEstimate], mass: float | None) -> Iterator[str]:
    """Note on whether a thrust scale was found to be thrust or mass."""
    for effect in effects:
        if effect.forms:
            cause, chance = max(effect.forms.items(), key=lambda form: form[1])
            asks = "" if mass is not None else "; weigh the vehicle and state --mass"
            yield f"{effect.id}: another {cause} (probability {chance:.2f}){asks if cause == 'mass' else ''}"


def own_patches(
    effects: Sequence[EffectEstimate],
    simulator: Mapping[str, float],
    frame: Mapping[str, Any] | None = None,
    *,
    geometry: Geometry | None = None,
    mass: float | None = None,
    vehicle: Mapping[str, float] | None = None,
) -> tuple[Mapping[str, Any], ...]:
    """``sim_patch`` of each of `effects`: its part of :func:`airframe_patch` of all, so that they are consistent.

    A key that several effects change has its common value in each, and so have those that a stated `mass` changes.
    """
    whole = airframe_patch(effects, simulator, frame, geometry=geometry, mass=mass, vehicle=vehicle)
    found: list[Mapping[str, Any]] = []
    for effect in effects:
        alone = airframe_patch((effect,), simulator, frame, geometry=geometry, mass=mass, vehicle=vehicle)
        keys = {key: whole.frame_json[key] for key in alone.frame_json if key in whole.frame_json}
        values = {name: whole.parameters[name] for name in alone.parameters if name in whole.parameters}
        found.append({**values, **({"frame_json": keys} if keys else {})})
    return tuple(found)
