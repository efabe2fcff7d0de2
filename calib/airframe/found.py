"""What a diagnosis of the airframe found, before it becomes part of a gap report."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from mavcal.calib.airframe.air import Jump, Turbulence
from mavcal.calib.airframe.answer import AirframePart, Domain
from mavcal.calib.airframe.testable import Missing


@dataclass(frozen=True)
class FoundValue:
    """One parameter of an effect: `value` is a ratio less one where `relative`, else a difference; `sd` its error.

    `real` and `sim` are those of the flights in SI, None where they say nothing by themselves.
    """

    name: str
    value: float
    sd: float
    unit: str
    relative: bool = False
    real: float | None = None
    sim: float | None = None


@dataclass(frozen=True)
class FoundRival:
    """Another effect in the place of one: its probability, and by how many nats the found one is preferred."""

    id: str
    probability: float
    nats: float
    fix: str


@dataclass(frozen=True)
class FoundEffect:
    """One effect: the nats that the data lose without it, with `df` amplitudes, its probability and its rivals."""

    id: str
    domain: Domain
    motors: tuple[int, ...]
    values: tuple[FoundValue, ...]
    nats: float
    df: int
    probability: float
    share: float
    rivals: tuple[FoundRival, ...] = ()
    forms: Mapping[str, float] = field(default_factory=dict)
    """Probability of each possible cause; empty for an effect with a single cause."""


@dataclass(frozen=True)
class HeldOut:
    """Nats a sample by which predictions fall short of a free fit on held-out stretches, before and after effects."""

    before: float
    after: float
    sequence: tuple[tuple[str, float], ...] = ()


@dataclass(frozen=True, eq=False)
class AirframeAnswer:
    """Everything that two flights say of airframe, actuators and air.

    `unknown` is the text of what has no name, with its `unknown_share` of the evidence; empty where nothing is left.
    `nameless` is the probability that something without a name is there.
    """

    found: tuple[FoundEffect, ...]
    missing: tuple[Missing, ...]
    part: AirframePart
    tested: int
    turbulence: Turbulence | None = None
    jumps: tuple[Jump, ...] = ()
    glitches: tuple[Jump, ...] = ()
    unknown: str = ""
    unknown_share: float = 0.0
    nameless: float = 0.0
    heldout: HeldOut | None = None
    warnings: tuple[str, ...] = ()
    facts: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class NoAirframe:
    """Why nothing can be said of the airframe, and what would be needed."""

    reason: str
    need: str
