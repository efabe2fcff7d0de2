"""Missions: what the pilot is asked to fly, with order, sizes and headings drawn from the seed."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

Rng = np.random.Generator


class LegKind(StrEnum):
    """How a leg is flown."""

    REST = "rest"  # motors off
    TAKE_OFF = "take_off"  # until the height is reached
    FLY = "fly"  # at a velocity
    ROCK = "rock"  # sharp doublets of roll and pitch
    LOW = "low"  # down to a height, and stay there
    LAND = "land"  # until the ground is felt


@dataclass(frozen=True)
class Leg:
    """One part of a mission.

    Parameters
    ----------
    seconds
        How long; of take-off and landing the longest. A low leg has the way down in it.
    velocity
        Forward, right and up, m/s, in the heading at the leg's begin.
    turn
        By which the heading changes at the leg's begin, rad.
    rock
        Roll and pitch of the doublets, rad, and s of one side.
    height
        To take off to, or to stay at, m.
    """

    kind: LegKind
    seconds: float
    velocity: tuple[float, float, float] = (0.0, 0.0, 0.0)
    turn: float = 0.0
    rock: tuple[float, float, float] = (0.0, 0.0, 0.0)
    height: float = 0.0


@dataclass(frozen=True)
class Mission:
    """Legs in their order, and the heading at the begin, rad."""

    legs: tuple[Leg, ...]
    heading: float

    @property
    def longest(self) -> float:
        """s, if every leg takes its time."""
        return sum(leg.seconds for leg in self.legs)


def draw_mission(rng: Rng) -> Mission:
    """The flight that is asked for, 90 to 110 s: rest, all manoeuvres in a drawn order, landing, rest."""
    parts: list[Callable[[Rng], list[Leg]]] = [_climbs, _forward_and_back, _sideways_and_back, _turns, _rocking]
    middle = [leg for k in rng.permutation(len(parts)) for leg in parts[k](rng)]
    hover = Leg(LegKind.FLY, rng.uniform(5.0, 6.5))
    legs = [
        *(Leg(LegKind.REST, 8.0), Leg(LegKind.TAKE_OFF, 12.0, height=rng.uniform(4.0, 7.0))),
        *(hover, *middle, Leg(LegKind.FLY, rng.uniform(4.0, 6.0)), Leg(LegKind.LAND, 25.0), Leg(LegKind.REST, 4.0)),
    ]
    return Mission(tuple(legs), rng.uniform(-math.pi, math.pi))


LOW_M, LOW_S = 0.15, 26.0
"""Height of a low hover, m, and its time with the way down, s. Chosen, not measured: 20 s with the rotors at two radii.
"""


def with_low_hover(mission: Mission) -> Mission:
    """The same with a hover near the ground before it lands."""
    legs = list(mission.legs)
    landing = next(k for k, leg in enumerate(legs) if leg.kind is LegKind.LAND)
    legs.insert(landing, Leg(LegKind.LOW, LOW_S, height=LOW_M))
    return replace(mission, legs=tuple(legs))


def _climbs(rng: Rng) -> list[Leg]:
    legs = []
    for _ in range(3):
        speed = rng.uniform(2.0, 4.0)
        legs += [Leg(LegKind.FLY, rng.uniform(1.5, 2.0), (0.0, 0.0, speed)), Leg(LegKind.FLY, 0.3)]
        legs += [Leg(LegKind.FLY, rng.uniform(1.8, 2.2), (0.0, 0.0, -min(speed, 3.0))), Leg(LegKind.FLY, 0.3)]
    return legs


def _out_and_back(rng: Rng, axis: int) -> list[Leg]:
    legs = []
    for speed, seconds in ((4.0, 3.2), (8.0, 5.2)):
        size = speed * rng.uniform(0.9, 1.1) * rng.choice([-1.0, 1.0])
        for sign in (1.0, -1.0):
            velocity = [0.0, 0.0, 0.0]
            velocity[axis] = sign * size
            legs.append(Leg(LegKind.FLY, seconds, (velocity[0], velocity[1], 0.0)))
    return [*legs, Leg(LegKind.FLY, 2.5)]


def _forward_and_back(rng: Rng) -> list[Leg]:
    return _out_and_back(rng, 0)


def _sideways_and_back(rng: Rng) -> list[Leg]:
    return _out_and_back(rng, 1)


def _turns(rng: Rng) -> list[Leg]:
    side = rng.choice([-1.0, 1.0])
    sides = (side, side, side, -side)
    return [Leg(LegKind.FLY, 2.0, turn=float(s) * math.radians(rng.uniform(80.0, 100.0))) for s in sides]


def _rocking(rng: Rng) -> list[Leg]:
    legs = []
    for axis in rng.permutation(2):
        for _ in range(3):
            tilt = math.radians(rng.uniform(12.0, 22.0)) * rng.choice([-1.0, 1.0])
            rock = (tilt, 0.0, rng.uniform(0.2, 0.35)) if axis == 0 else (0.0, tilt, rng.uniform(0.2, 0.35))
            legs.append(Leg(LegKind.ROCK, 2.0 * rock[2], rock=rock))
            legs.append(Leg(LegKind.FLY, 0.6))
        legs.append(Leg(LegKind.FLY, 1.0))
    return legs
