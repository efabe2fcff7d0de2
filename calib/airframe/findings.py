"""Effects for the report from the posterior: ratios, intervals and rivals."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.airframe.answer import Domain
from mavcal.calib.airframe.density import ID as DENSITY
from mavcal.calib.airframe.density import altitude_of
from mavcal.calib.airframe.effects import FORMS, Act, AirframeEffect
from mavcal.calib.airframe.found import FoundEffect, FoundRival, FoundValue
from mavcal.calib.airframe.nameless import GROUPS
from mavcal.calib.airframe.pair import PairEvidence
from mavcal.calib.airframe.physics import PRODUCTS
from mavcal.calib.airframe.testable import Missing
from mavcal.calib.airframe.words import BESIDE_STANDARD, FIXES, STANDARD_FLIGHT
from mavcal.calib.inference.search import Answer

Array = NDArray[np.float64]

TRIM: Final = 0.04
"""Relative error of a motor's loss or a shift of the centre of mass: both follow from trims through the slope of the
thrust curve. Measured: 1.4 and 3 % on two simulated flights, 0 to 8 % with foreign physics."""
RIVAL: Final = 0.01
"""Least probability of a listed rival. Source: GAP 6, the truth is in the set in 99 of 100."""
EVEN_ODDS: Final = 0.5
"""Probability above which an unnamed effect becomes a warning. Above it, the likeliest of several competing effects is
reported. Source: even odds."""
_UNITS: Final = {
    "k": "m/s2", "c1": "1/s", "c2_x": "1/m", "cz": "1/s", "ch": "1/m", "tau": "s", "fall": "s", "delay": "s",
    "expo": "1", "sag": "1", "cg_x": "arms", "cg_y": "arms", "wind_north": "m/s", "wind_east": "m/s",
    "gain_x": "rad/s2", "gain_y": "rad/s2", "gain_z": "rad/s2", "damping_x": "1/s", "damping_y": "1/s",
    "damping_z": "1/s",
    "torque_x": "rad/s2", "torque_y": "rad/s2", "torque_z": "rad/s2", **{f"product_{pair}": "1" for pair in PRODUCTS},
}  # fmt: skip
_RELATIVE: Final = frozenset(
    {
        "thrust_scale",
        "rotor_drag",
        "body_drag",
        "inertia",
        "yaw_coefficient",
        "angular_damping",
        "motor_weak",
        "payload_step",
        DENSITY,
    }
)


def effects_of(
    answer: Answer,
    evidence: PairEvidence,
    tested: Sequence[AirframeEffect],
    slew: float | None,
    *,
    least: float,
    beside: Sequence[FoundEffect] = (),
) -> tuple[FoundEffect, ...]:
    """Every effect of `tested` with a probability of `least` or more, in the order of evidence.

    If the others reach `least` only together, the likeliest of them is reported with its rivals. `beside` are effects
    that were judged on other rows of the flight.
    """
    by_block = {e.block: e for e in evidence.effects}
    ids = _by_name(tested)
    told = _likely(answer, ids, least)
    slow = [g.id for g in GROUPS if g.of_air]
    found = [f for f in beside if f.probability >= least]
    for (id_, motor), forms in ids.items():
        chance = answer.probability(*(f.block for f in forms))
        inside = [f for f in forms if f.block in answer.best.model]
        if (id_, motor) not in told or not inside:
            continue
        nats = lost_without(answer, [f.block for f in forms])
        values = tuple(v for f in inside for v in _values(answer, evidence, f, slew))
        rivals = _rivals(answer, by_block, forms, id_)
        motors = () if motor is None else (motor,)
        df = sum(max(len(f.names), 1) for f in inside)
        causes = {FORMS[f.block]: answer.probability(f.block) / chance for f in forms if f.block in FORMS}
        found.append(FoundEffect(id_, inside[0].domain, motors, values, nats, df, chance, 0.0, rivals, causes))
    for block in slow:
        chance = answer.probability(block)
        if block in answer.best.model and chance >= least:
            mean, _ = answer.amplitudes(block)
            size = FoundValue("size", float(np.sqrt((mean**2).sum())), 0.0, "m/s2")
            nats = lost_without(answer, [block])
            found.append(FoundEffect("gust", by_block[block].domain, (), (size,), nats, len(mean), chance, 0.0))
    total = math.fsum(f.nats for f in found) or 1.0
    return tuple(sorted((replace(f, share=f.nats / total) for f in found), key=lambda f: -f.nats))


_Named = Mapping[tuple[str, int | None], list[AirframeEffect]]
"""Forms of each effect by its name and motor."""


def _by_name(effects: Sequence[AirframeEffect]) -> _Named:
    ids: dict[tuple[str, int | None], list[AirframeEffect]] = {}
    for effect in effects:
        if not effect.nameless:
            ids.setdefault((effect.id, effect.motor), []).append(effect)
    return ids


def _likely(answer: Answer, ids: _Named, least: float) -> set[tuple[str, int | None]]:
    """Effects with a probability of `least` or more, and the likeliest of the others if these reach it together."""
    chances = {name: answer.probability(*(f.block for f in forms)) for name, forms in ids.items()}
    likely = {name for name, chance in chances.items() if chance >= least}
    rest = {name: chances[name] for name, forms in ids.items() if name not in likely and _of_airframe(forms[0])}
    if rest and answer.probability(*(f.block for name in rest for f in ids[name])) >= least:
        first = max(rest, key=lambda name: rest[name])
        if rest[first] > EVEN_ODDS:
            likely.add(first)
    return likely


def _of_airframe(effect: AirframeEffect) -> bool:
    return effect.domain is Domain.AIRFRAME or effect.id == DENSITY


def with_rivals(found: Sequence[FoundEffect], ids: Sequence[str]) -> tuple[FoundEffect, ...]:
    """`found`, its thrust scale with untestable effects `ids` as rivals, each as likely as the thrust itself."""
    rivals = tuple(FoundRival(id_, 0.5, 0.0, FIXES[id_]) for id_ in ids)
    return tuple(replace(f, rivals=(*f.rivals, *rivals)) if f.id == "thrust_scale" else f for f in found)


def probabilities(
    answer: Answer, effects: Sequence[AirframeEffect], beside: Sequence[FoundEffect] = ()
) -> dict[str, float]:
    """Probability of each effect by id, highest first; for an effect of single motors, that any motor has it."""
    blocks: dict[str, list[str]] = {}
    for effect in effects:
        if not effect.nameless:
            blocks.setdefault(effect.id, []).append(effect.block)
    found = {id_: answer.probability(*names) for id_, names in blocks.items()}
    found |= {effect.id: effect.probability for effect in beside}
    return {id_: round(chance, 4) for id_, chance in sorted(found.items(), key=lambda one: -one[1])}


def doubtful(
    answer: Answer, effects: Sequence[AirframeEffect], *, least: float, most: float, beside: Sequence[FoundEffect] = ()
) -> tuple[str, ...]:
    """Sentences on effects with a probability from `least` to `most`: too likely to omit, too doubtful to name."""
    ids = _by_name([e for e in effects if _of_airframe(e)])
    told = _likely(answer, ids, most)
    left = {name: forms for name, forms in ids.items() if name not in told}
    chances = [(id_, motor, answer.probability(*(f.block for f in forms))) for (id_, motor), forms in left.items()]
    chances += [(f.id, None, f.probability) for f in beside]
    found = []
    for id_, motor, chance in chances:
        if least <= chance < most:
            which = "" if motor is None else f" of motor {motor}"
            fly = FIXES.get(id_, STANDARD_FLIGHT)
            found.append(f"{id_}{which} has a probability of {100 * chance:.0f} %, too little to name it; fly {fly}")
    return tuple(found)


def latent(
    answer: Answer, effects: Sequence[AirframeEffect], untestable: Sequence[Missing], *, least: float
) -> tuple[str, ...]:
    """Sentences on effects with a probability of `least` or more that these flights cannot show well enough to name."""
    found = {}
    for missing in untestable:
        chance = answer.probability(*(e.block for e in effects if e.id == missing.id))
        if missing.latent and chance >= least:
            found[missing.id] = (
                f"{missing.id} has a probability of {100 * chance:.0f} %, but is not named: {missing.reason}; "
                f"fly {missing.need}"
            )
    return tuple(found.values())


def lost_without(answer: Answer, blocks: Sequence[str]) -> float:
    """Log evidence, nats, that the best model loses without these blocks, the others unchanged."""
    without = answer.best.model - frozenset(blocks)
    return max(answer.best.posterior.log_evidence - answer.evidence.posterior(without).log_evidence, 0.0)


def _rivals(
    answer: Answer, by_block: dict[str, AirframeEffect], forms: Sequence[AirframeEffect], id_: str
) -> tuple[FoundRival, ...]:
    """Rivals: effects in kept models without this one."""
    own = {f.block for f in forms}
    with_it = max((v.log_weight for v in answer.kept if v.model & own), default=-math.inf)
    found: dict[str, tuple[float, float]] = {}
    for weight, one in zip(answer.weights, answer.kept, strict=True):
        if one.model & own:
            continue
        for block in one.model - answer.best.model:
            effect = by_block[block]
            name = "unknown" if effect.nameless else effect.id
            if name == id_ and effect.motor is None:
                continue
            before, nats = found.get(name, (0.0, math.inf))
            found[name] = before + weight, min(nats, with_it - one.log_weight)
    rivals = (
        FoundRival(name, chance, nats, FIXES.get(name, STANDARD_FLIGHT)) for name, (chance, nats) in found.items()
    )
    return tuple(sorted((r for r in rivals if r.probability >= RIVAL), key=lambda r: -r.probability))


def _values(
    answer: Answer, evidence: PairEvidence, effect: AirframeEffect, slew: float | None
) -> tuple[FoundValue, ...]:
    if effect.slew:
        return (FoundValue("slew", slew or 0.0, 0.05 * (slew or 0.0), "1/s", relative=False, real=slew),)
    mean, covariance = answer.amplitudes(effect.block)
    sd = np.sqrt(np.diag(covariance))
    if effect.id == "cg_offset":
        sd = np.hypot(sd, TRIM * np.abs(mean))
    real, sim = evidence.parameters(answer.best.model, answer.best.posterior)
    place = evidence.sim.fit.layout.place
    if effect.motor is not None:
        value, error = _thrust_left(evidence, effect, float(mean[0]), float(sd[0]))
        motor = FoundValue("motor", float(effect.motor), 0.0, "1", relative=False)
        return FoundValue("s", value, error, "1", relative=True), motor
    if effect.id == "payload_step":
        at = evidence.side_of(answer.best.model).likelihood.airframe.loaded_at or 0.0
        return FoundValue("s", float(mean[0]), float(sd[0]), "1", relative=True), FoundValue("t", at, 0.5, "s")
    if effect.id == DENSITY and effect.sides is not None:
        return _density(effect.sides, float(mean[0]), float(sd[0]))
    if effect.block.startswith("inertia_"):
        axes = effect.block.removeprefix("inertia_")
        return tuple(FoundValue(a, float(mean[0]), float(sd[0]), "1", relative=True) for a in axes)
    relative = effect.id in _RELATIVE and effect.changes[0].act is not Act.PLUS
    made = []
    for k, (name, base) in enumerate(zip(effect.names, effect.base, strict=True)):
        unit = "1" if relative else _UNITS[base]
        sides = tuple(float(theta[place[base]]) + _beside(theta, place, base) for theta in (real, sim))
        made.append(FoundValue(name, float(mean[k]), float(sd[k]), unit, relative, real=sides[0], sim=sides[1]))
    return tuple(made)


def _density(sides: tuple[float, float], value: float, sd: float) -> tuple[FoundValue, ...]:
    """Density ratio, and the altitude at which a simulator's standard atmosphere has the real density."""
    low, high, at = (altitude_of(sides[1] * (1.0 + value + step)) for step in (-sd, sd, 0.0))
    ratio = FoundValue("s", value, sd, "1", relative=True, real=sides[0], sim=sides[1])
    return ratio, FoundValue("altitude", at, 0.5 * abs(high - low), "m", sim=altitude_of(sides[1]))


def _beside(theta: Array, place: Mapping[str, int], base: str) -> float:
    """Value, s, to add to `fall`, which is relative to the lag of a rising command; 0 for other parameters."""
    return float(theta[place["tau"]]) if base == "fall" else 0.0


def _thrust_left(evidence: PairEvidence, effect: AirframeEffect, value: float, sd: float) -> tuple[float, float]:
    """Relative thrust of a weak motor at the hover command, and its error."""
    if effect.block.startswith("motor_weak"):
        return value, float(np.hypot(sd, TRIM * value))
    airframe = evidence.real.likelihood.airframe
    flight = airframe.flight
    x = float(np.median(flight.c[flight.usable]))
    expo = evidence.real.fit.value("expo")

    def thrust(pulse: float) -> float:
        told = max(x * (1.0 + pulse) + pulse * airframe.spin_low, 0.0)
        return told * (1.0 - expo) + expo * told**2

    left = thrust(value) / thrust(0.0) - 1.0
    step = 1e-4
    slope = (thrust(value + step) - thrust(value - step)) / (2.0 * step * thrust(0.0))
    return left, float(np.hypot(slope * sd, TRIM * left))


def needed_manoeuvres(found: Sequence[FoundEffect], untestable: Sequence[Missing]) -> tuple[str, ...]:
    """Manoeuvres that tell rivals apart, or make untested effects testable."""
    wanted = [rival.fix for effect in found for rival in effect.rivals]
    if any(m.id in FIXES and m.id not in BESIDE_STANDARD for m in untestable):
        wanted.append(f"the standard flight: {STANDARD_FLIGHT}")
    return tuple(dict.fromkeys(wanted))
