"""Cases: two flights of one vehicle, in what they differ and how much, all drawn from one seed."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any

import numpy as np

from mavcal.calib.blind.airframe.air import air_over_time
from mavcal.calib.blind.airframe.changes import driven, hovers
from mavcal.calib.blind.airframe.draw import COMMON, FOREIGN, Size, draw_vehicle
from mavcal.calib.blind.airframe.effects import KINDS, MASS, MASSES
from mavcal.calib.blind.airframe.flight import LOOP_HZ, Errors, Flown, fly
from mavcal.calib.blind.airframe.logs import (
    Columns,
    Logging,
    columns_of,
    draw_errors,
    draw_logging,
    draw_units,
    recording_of,
)
from mavcal.calib.blind.airframe.mission import draw_mission, with_low_hover
from mavcal.calib.blind.airframe.pilot import Tuning, tuned
from mavcal.calib.blind.airframe.sides import Entry, Kind, Pair, Rng, Side
from mavcal.calib.blind.airframe.sih import CALM, SIH_KINDS, SOFT, draw_sih, draw_sih_units
from mavcal.calib.blind.airframe.strange import STRANGE
from mavcal.calib.blind.airframe.surroundings import ENVIRONMENT, SENSORS, differs, draw_weather
from mavcal.calib.blind.airframe.thinned import THINNINGS
from mavcal.calib.recording import Recording

UPRIGHT = math.cos(math.radians(75.0))
"""Cosine of the lean that no mission asks for: who passes it has lost control."""
HOVERS = (0.12, 0.82)
"""Commands between which both vehicles must hover, so that they can climb and sink."""
TRIES = 4
"""Flights of one side before its case is given up."""
FIRST = ("inertia", "thrust")
"""Groups that are put in before others, so that what those change is measured on the final vehicle."""
BY_ID: Mapping[str, Kind] = {kind.id: kind for kind in (*KINDS, *ENVIRONMENT)}


class AirTier(StrEnum):
    """What a case tries."""

    NULL = "A0"
    SINGLE = "A1"
    SIH = "A2"
    MIXED = "A3"
    LEFT_OUT = "A4"
    FOREIGN = "A5"
    UNKNOWN = "A6"
    LOGGING = "A7"


@dataclass(frozen=True, eq=False)
class AirCase:
    """One case.

    Parameters
    ----------
    id
        Random digits that say nothing.
    tier, seed
        They make the case again.
    real, sim
        The two logs as columns.
    frame
        Layout of the motors, such as ``quad-x``: a table cannot say it.
    without
        Effect ids that the catalogue must do without.
    label
        What was put in: never given to the diagnosis.
    """

    id: str
    tier: AirTier
    seed: int
    real: Columns
    sim: Columns
    frame: str
    without: tuple[str, ...]
    label: Mapping[str, Any]

    def recordings(self) -> tuple[Recording, Recording]:
        """The two logs in memory, with the frame as parameters."""
        return recording_of(self.real, self.frame, "real"), recording_of(self.sim, self.frame, "sim")


@dataclass(frozen=True)
class Draft:
    """A case before it is flown."""

    pair: Pair
    tuning: Tuning
    logging: Logging
    without: tuple[str, ...] = ()
    thinning: str | None = None


def make_air_case(tier: AirTier, seed: int) -> AirCase:
    """The case of that tier and seed; the same digits every time."""
    rng, draft, label = drafted(tier, seed)
    real, sim = (log_of(side, draft, rng)[0] for side in (draft.pair.real, draft.pair.sim))
    if draft.thinning is not None:
        real = THINNINGS[draft.thinning].thin(real, rng)
    frame = draft.pair.real.vehicle.frame
    return AirCase(str(label["id"]), tier, seed, real, sim, frame, draft.without, label)


def make_air_label(tier: AirTier, seed: int) -> dict[str, Any]:
    """Only what was put in: for the seal."""
    return drafted(tier, seed)[2]


def log_of(side: Side, draft: Draft, rng: Rng) -> tuple[Columns, Flown]:
    """Fly one side: another mission and other air and noise each; its log, and its truth.

    A flight that loses control is flown again on another mission, as an owner would not send its log.
    """
    for _ in range(TRIES):
        flown, errors = _flown(side, draft, rng)
        upright = float((1.0 - 2.0 * (flown.attitude[:, 1:3] ** 2).sum(axis=1)).min())
        if flown.grounded[-1] and upright > UPRIGHT:
            return columns_of(flown, side.vehicle, side.units, errors, draft.logging, rng), flown
    where, lean = -flown.place[-1, 2], math.degrees(math.acos(max(-1.0, upright)))
    raise AssertionError(f"no flight: it ends {where:.1f} m above the ground, and leaned {lean:.0f} degrees")


def _flown(side: Side, draft: Draft, rng: Rng) -> tuple[Flown, Errors]:
    mission = draw_mission(rng)
    if side.low:
        mission = with_low_hover(mission)
    count = round(mission.longest * LOOP_HZ) + 1
    t = np.arange(count) / LOOP_HZ
    air = air_over_time(side.weather, t, rng)
    errors = draw_errors(rng, count, draft.logging, side.units[0])
    for slip in side.slips:
        errors = replace(errors, velocity=errors.velocity + slip.error(t))
    return fly(side.vehicle, draft.tuning, mission, air, errors, side.events(count, rng)), errors


def drafted(tier: AirTier, seed: int) -> tuple[Rng, Draft, dict[str, Any]]:
    """A case before it is flown: the generator of its numbers, what is flown, and the label."""
    rng = np.random.default_rng([seed, int(tier.value[1:]), ord("A")])
    draft = _drawn(tier, rng)
    name = hashlib.sha256(f"mavcal {tier} {seed} {rng.integers(2**62)}".encode()).hexdigest()[:16]
    return rng, draft, _label(name, tier, seed, draft)


def _drawn(tier: AirTier, rng: Rng) -> Draft:
    match tier:
        case AirTier.NULL:
            return _with(rng, [], wind=8.0, turbulence=1.0)
        case AirTier.SINGLE:
            kind = _pick(rng, (*KINDS, *ENVIRONMENT))
            return _with(rng, [MASS if kind.id == MASS.id and rng.random() < MASSES else kind])
        case AirTier.SIH:
            return _of_sih(rng, _pick(rng, SIH_KINDS))
        case AirTier.MIXED:
            return _with(rng, _several(rng))
        case AirTier.LEFT_OUT:
            kind = _pick(rng, KINDS)
            return replace(_with(rng, [kind]), without=(kind.id,))
        case AirTier.FOREIGN:
            size = FOREIGN[int(rng.integers(len(FOREIGN)))]
            return _with(rng, [_pick(rng, KINDS)], size=size, electric=bool(rng.random() < 0.5))
        case AirTier.UNKNOWN:
            return _with(rng, [_pick(rng, STRANGE)])
        case AirTier.LOGGING:
            name = str(rng.choice(list(THINNINGS)))
            hidden = THINNINGS[name].hides
            return replace(_with(rng, [BY_ID[str(rng.choice(hidden))]]), thinning=name)


def _pick(rng: Rng, kinds: Sequence[Kind]) -> Kind:
    return kinds[int(rng.integers(len(kinds)))]


def _several(rng: Rng) -> list[Kind]:
    """Two to four kinds of different groups; in a third of the cases a sensor's error beside what it looks like."""
    if rng.random() < 1.0 / 3.0:
        like = str(rng.choice(list(SENSORS)))
        chosen = [BY_ID[like], SENSORS[like]]
        count = int(rng.choice([2, 3]))
    else:
        chosen, count = [], int(rng.choice([2, 3, 4]))
    while len(chosen) < count:
        kind = _pick(rng, (*KINDS, *ENVIRONMENT))
        if kind.group not in {other.group for other in chosen}:
            chosen.append(kind)
    return chosen


def _with(
    rng: Rng,
    kinds: Sequence[Kind],
    *,
    size: Size = COMMON,
    electric: bool = False,
    wind: float = 5.0,
    turbulence: float = 0.7,
) -> Draft:
    """The kinds at drawn sizes on a drawn vehicle; another vehicle where one of the two cannot fly."""
    for _ in range(100):
        vehicle = draw_vehicle(rng, size)
        if electric and "thrust_expo" not in {kind.id for kind in kinds}:
            vehicle = driven(vehicle, back_emf=rng.uniform(0.45, 0.8))
        units = draw_units(rng)
        real, sim = (Side(vehicle, draw_weather(rng, wind, turbulence), units) for _ in range(2))
        pair = Pair(real, sim)
        for kind in sorted(kinds, key=lambda one: one.group not in FIRST):
            pair = kind.put(rng, pair)
        if len(kinds) > 1:
            pair = replace(pair, entries=tuple(_inexact(entry, pair.entries) for entry in pair.entries))
        if draft := _draft(rng, pair):
            return draft
    raise AssertionError(f"no vehicle of this size flies with {[kind.id for kind in kinds]}")


def _of_sih(rng: Rng, kind: Kind) -> Draft:
    """A setting of PX4's simulator, which knows no weather."""
    for _ in range(100):
        side = Side(draw_sih(rng), CALM, draw_sih_units(rng))
        if draft := _draft(rng, kind.put(rng, Pair(side, side))):
            (x, y, z), yaw = draft.tuning.rate, draft.tuning.yaw
            return replace(draft, tuning=replace(draft.tuning, rate=(x, y, SOFT * z), yaw=SOFT * yaw))
    raise AssertionError(f"no vehicle flies with {kind.id}")


def _draft(rng: Rng, pair: Pair) -> Draft | None:
    """Pilot and logging of a pair; None where one of the two cannot fly."""
    both = [pair.real.vehicle, pair.sim.vehicle]
    if not all(HOVERS[0] <= hovers(one) <= HOVERS[1] for one in both):
        return None
    belief = float(np.clip(pair.sim.vehicle.drive.expo + rng.uniform(-0.1, 0.1), 0.0, 0.9))
    tuning = tuned(both, belief, rng.uniform(-0.05, 0.05), compensates=bool(rng.random() < 0.7))
    return Draft(pair, tuning, draw_logging(rng))


def _inexact(entry: Entry, all_of_them: Sequence[Entry]) -> Entry:
    """Without exact numbers where another effect of the case may be counted into them.

    Density is a part of every force, and damping in 1/s of drag, inflow and inertia.
    """
    thin = "air_density" in {other.id for other in all_of_them} and entry.id != "air_density"
    return replace(entry, exact=()) if thin or entry.id == "angular_damping" else entry


def _label(name: str, tier: AirTier, seed: int, draft: Draft) -> dict[str, Any]:
    entries = [entry.as_json() for entry in draft.pair.entries]
    real, sim = draft.pair.real, draft.pair.sim
    return {
        "id": name,
        "tier": tier.value,
        "seed": seed,
        "frame": real.vehicle.frame,
        "log_hz": draft.logging.hz,
        "effects": [e for e in entries if not e["id"].startswith("unknown_")],
        "unknown": [e for e in entries if e["id"].startswith("unknown_")],
        "air": {
            side: [round(w.north, 6), round(w.east, 6), round(w.turbulence, 6)]
            for side, w in (("real", real.weather), ("sim", sim.weather))
        },
        "differs": list(differs(draft.pair)),
        "thinning": draft.thinning,
        "without": list(draft.without),
    }
