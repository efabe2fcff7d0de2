"""Parts of a gap report that only the airframe has: domain, geometry, commands, predicted flight, traces."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Domain(StrEnum):
    """Part of the system that an effect belongs to."""

    SENSOR = "sensor"
    AIRFRAME = "airframe"
    ENVIRONMENT = "environment"  # a finding about the day: reported, never exported


class Quantity(StrEnum):
    """What a rollout predicts."""

    VELOCITY = "velocity"
    BODY_RATE = "body_rate"


@dataclass(frozen=True)
class Motor:
    """Position of a motor, in arms (body x forward, y right; the longest arm is 1), and its direction of rotation.

    `spin` is +1 where the reaction turns the vehicle clockwise seen from above (torque about +z): a propeller that
    turns counter-clockwise.
    """

    x: float
    y: float
    spin: int


@dataclass(frozen=True)
class Geometry:
    """The motors in the order of their outputs. `source` is ``parameters``, ``user`` or ``assumed``."""

    frame_class: str
    frame_type: str
    motors: tuple[Motor, ...]
    source: str


@dataclass(frozen=True)
class Commands:
    """Source of the motors' commands, and how good they are.

    `check_us` is the median difference from the logged outputs, us; None: nothing to check against. `masked` is the
    fraction of the flight that is left out because an output was at its limit.
    """

    source: str
    rate_hz: float
    check_us: float | None
    masked: float


@dataclass(frozen=True)
class RolloutStep:
    """Error of the predicted flight with this effect and the previous ones, in the unit of its rollout."""

    add: str
    error: float


@dataclass(frozen=True)
class Rollout:
    """Root mean square error of the predicted flight after `h_s` seconds from a measured start, on held-out data.

    `before`: the simulator as it is; `after`: with the effects; `floor`: with the measured force or torque instead of a
    model. `closed` is (before - after) / (before - floor) with its 95 % interval, None where it is not meaningful.
    `part` is what was held out: ``blocks`` or the name of a kind of manoeuvre.
    """

    h_s: float
    quantity: Quantity
    unit: str
    before: float
    after: float
    floor: float
    closed: float | None
    ci95: tuple[float, float] | None
    part: str = "blocks"
    sequence: tuple[RolloutStep, ...] = ()


@dataclass(frozen=True, eq=False)
class AirframeTrace:
    """Measured and modelled force (m/s2) or torque (rad/s2) of a flight; for plots, not part of the JSON.

    `t` (N,), s; the others (N, 3): `real` measured, `sim` what the simulator's airframe would have done at the same
    commands, `patched` the same with the effects; rows without a sample are nan.
    """

    kind: str
    unit: str
    t: Array
    real: Array
    sim: Array
    patched: Array


@dataclass(frozen=True, eq=False)
class AirframePart:
    """The part of a report about airframe and air, without the effects.

    `manoeuvres` would tell rivals apart; `centre_of_gravity` (x, y) in arms where it shifted; `traces` are for plots.
    """

    geometry: Geometry | None = None
    commands: Commands | None = None
    rollout: tuple[Rollout, ...] = ()
    wind: tuple[float, float] | None = None
    """Velocity of the air north and east, m/s; None: not known."""
    manoeuvres: tuple[str, ...] = ()
    traces: tuple[AirframeTrace, ...] = ()
    facts: Mapping[str, float] = field(default_factory=dict)
    probabilities: Mapping[str, float] = field(default_factory=dict)
    """Probability that each tested effect is present, including effects that are too doubtful to report."""
