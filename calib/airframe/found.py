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

    `real` and `sim` are the values of the flights in SI units, None where they are not meaningful alone.
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
    """A rival of a found effect: its probability, and the nats by which the found one is preferred."""

    id: str
    probability: float
    nats: float
    fix: str


@dataclass(frozen=True)
class FoundEffect:
    """One effect with `df` amplitudes: the nats lost without it, its probability and its rivals."""

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
    """Loss of predictions against a free fit on held-out stretches, nats per sample, without and with the effects."""

    before: float
    after: float
    sequence: tuple[tuple[str, float], ...] = ()


@dataclass(frozen=True, eq=False)
class AirframeAnswer:
    """Result of the comparison of two flights for airframe, actuators and air.

    `unknown` describes the nameless effects, with their `unknown_share` of the evidence; empty: none. `nameless` is the
    probability of a nameless effect.
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
    """Why the airframe cannot be judged, and what would be needed."""

    reason: str
    need: str
