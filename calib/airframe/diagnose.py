"""From two flights to an answer: commands, grid, fits, one posterior over effects, and prediction errors."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.airframe.air import GLITCHED_S, Jump, glitches, jumps, outside, turbulence
from mavcal.calib.airframe.answer import AirframePart, AirframeTrace, Commands, Domain
from mavcal.calib.airframe.commands import commands_of
from mavcal.calib.airframe.density import ID as DENSITY
from mavcal.calib.airframe.density import Densities, Density, densities, density_of
from mavcal.calib.airframe.effects import ODDS, AirframeEffect, catalogue, nameless, of_density
from mavcal.calib.airframe.findings import (
    EVEN_ODDS,
    doubtful,
    effects_of,
    latent,
    lost_without,
    needed_manoeuvres,
    probabilities,
    with_rivals,
)
from mavcal.calib.airframe.fit import SAG_SPAN, FlightLikelihood, expanded
from mavcal.calib.airframe.flown import EstimatorError, FlownFlight, Unflown, flown, needed_log
from mavcal.calib.airframe.found import AirframeAnswer, FoundEffect, NoAirframe
from mavcal.calib.airframe.geometry import geometry_of
from mavcal.calib.airframe.ground import ID as GROUND
from mavcal.calib.airframe.ground import ground_gap
from mavcal.calib.airframe.heldout import Parted, alone, held_out
from mavcal.calib.airframe.low import NearGround, near_ground
from mavcal.calib.airframe.nameless import GROUPS
from mavcal.calib.airframe.pair import PairEvidence, Side, by_itself, shown_by
from mavcal.calib.airframe.physics import AXES, Airframe, Kind
from mavcal.calib.airframe.searched import with_limit, with_load
from mavcal.calib.airframe.testable import TORQUE_HZ, Missing, missing, unusable
from mavcal.calib.inference.search import Answer, search
from mavcal.calib.recording import Recording

Array = NDArray[np.float64]

_FULL: Final = 99.0
"""Percentile of a flight's voltage taken as that of a full battery. Chosen, not measured: it is reached before
take-off."""
LIKELY: Final = 0.9
"""Probability from which an effect is reported. Chosen, not measured: a name makes its owner replace a part,
a warning only another flight."""
_SPIN_LOW: Final = 0.1875
"""Where a motor starts, in spans of its command, with ArduPilot's defaults: MOT_SPIN_MIN 0.15, MOT_SPIN_MAX 0.95."""
_TRACE_HZ: Final = 25.0
_MORE_ROUNDS: Final = 4


@dataclass(frozen=True, eq=False)
class _Flight:
    """One recording, prepared for the fit."""

    flight: FlownFlight
    parameters: dict[str, float]
    jumps: tuple[Jump, ...]
    glitches: tuple[Jump, ...]
    near: NearGround | None
    air: Density | None


def airframe_gap(
    real: Recording,
    sim: Recording,
    *,
    without: Collection[str] = (),
    frame: str | None = None,
    ended: Callable[[], bool] = lambda: False,
    estimator: Callable[[Recording], EstimatorError | None] = lambda _: None,
) -> AirframeAnswer | NoAirframe:
    """Differences of the real vehicle's airframe, actuators and air from the simulated ones.

    Parameters
    ----------
    real, sim
        Flights of the vehicle and of its simulator; they need not fly the same trajectory.
    without
        Ids of effects that are left out of the catalogue.
    frame
        A frame of :data:`calib.airframe.geometry.NAMED` for recordings that do not say theirs.
    ended
        Whether time is up; the best answer so far is then returned.
    estimator
        Error of a recording's own velocity and attitude; None where nothing better is known.
    """
    made = []
    for which, recording in (("real", real), ("simulated", sim)):
        one = _ready(recording, frame, estimator(recording))
        if isinstance(one, NoAirframe):
            return replace(one, reason=f"{which} recording: {one.reason}")
        made.append(one)
    ours, theirs = made
    if len(ours.flight.geometry.motors) != len(theirs.flight.geometry.motors):
        counts = " and ".join(str(len(m.flight.geometry.motors)) for m in made)
        return NoAirframe(f"the vehicles have {counts} motors", "a simulator of the same frame")
    return _diagnosed(ours, theirs, frozenset(without), ended)


def airframe_alone(
    real: Recording, *, frame: str | None = None, estimator: EstimatorError | None = None
) -> AirframePart | NoAirframe:
    """Airframe parameters from one flight without a simulator, and their prediction errors.

    `before` has only the thrust that balances gravity at the hover command. Errors are those of held-out stretches.
    `estimator`: error of the recording's own velocity and attitude, where it is known.
    """
    one = _ready(real, frame, estimator)
    if isinstance(one, NoAirframe):
        return one
    torque = min(one.flight.command_hz, one.flight.inertial_hz) >= TORQUE_HZ
    volts = _full(one) if one.flight.has_voltage else None
    side, _ = _best_kind(one, volts, torque=torque)
    if reason := unusable(side.likelihood):
        return NoAirframe(reason, "a flight within the motors' limits")
    theta, place = side.fit.theta, side.fit.layout.place
    return AirframePart(
        geometry=one.flight.geometry,
        commands=_commands(one.flight),
        rollout=alone(side),
        wind=(float(theta[place["wind_north"]]), float(theta[place["wind_east"]])),
        manoeuvres=("the same flight in the simulator: without one, no gap is told",),
        facts=_facts(side),
    )


def _commands(flight: FlownFlight) -> Commands:
    told = flight.commands
    return Commands(told.source, round(told.rate_hz, 1), told.check_us, float(flight.limited.mean()))


def _ready(recording: Recording, frame: str | None, estimator: EstimatorError | None) -> _Flight | NoAirframe:
    parameters = {name: float(value) for name, value in recording.parameters.final().items()}
    geometry = geometry_of(parameters, frame)
    if geometry is None:
        return NoAirframe(
            "no multicopter frame is told that has a model here",
            "FRAME_CLASS and FRAME_TYPE of a quad, hexa or octa, CA_ROTORn_*, or --frame",
        )
    commands = commands_of(recording, geometry)
    if commands is None or commands.rate_hz <= 0.0:
        return NoAirframe("no commands of the motors are logged", needed_log(recording))
    found = flown(recording, geometry, commands)
    if isinstance(found, Unflown):
        return NoAirframe(found.reason, found.need)
    probe = Airframe(found, Kind(), None, torque=False)
    jumped = jumps(found, probe.body_from_local)
    wrong = glitches(recording, float(found.t[0]), float(found.t[-1]))
    kept = replace(found, usable=found.usable & outside(found, jumped) & outside(found, wrong, GLITCHED_S))
    kept = kept if estimator is None else estimator.taken_off(kept)
    if kept.usable.mean() < 0.5:
        return NoAirframe(f"only {100 * kept.usable.mean():.0f} % of the flight can be judged", needed_log(recording))
    air = density_of(recording, float(kept.t[0]), float(kept.t[-1]))
    return _Flight(kept, parameters, jumped, wrong, near_ground(recording, kept), air)


_OF_SITL: Final = (Kind(yaw_by_command=True), Kind(yaw_by_command=True, drag_turns=False))
"""ArduPilot's simulator, the present one and that of 2023."""


def _kinds(sim: _Flight) -> tuple[Kind, ...]:
    """Force models that the simulator may use; its own flight decides between several."""
    if sim.flight.ardupilot and any(name.startswith("SIM_") for name in sim.parameters):
        return _OF_SITL
    if any(name.startswith("SIH_") for name in sim.parameters):
        return (Kind(drag_by_rotor=False, yaw_by_command=False),)
    return (Kind(), Kind(drag_by_rotor=False), *_OF_SITL)


def _likelihood(one: _Flight, kind: Kind, volts: float | None, *, torque: bool) -> FlightLikelihood:
    low = one.parameters.get("MOT_SPIN_MIN", 0.0)
    span = one.parameters.get("MOT_SPIN_MAX", 1.0) - low
    spin_low = low / span if span > 0.0 else _SPIN_LOW
    airframe = Airframe(one.flight, kind, volts, spin_low=spin_low, torque=torque)
    return FlightLikelihood(airframe, one.flight.usable, torque=torque)


def _full(one: _Flight) -> float:
    """Voltage of a full battery, V, at which thrust is stated: a sagging battery must not look like weaker thrust."""
    return float(np.percentile(one.flight.voltage, _FULL))


def _diagnosed(
    real: _Flight, sim: _Flight, without: frozenset[str], ended: Callable[[], bool]
) -> AirframeAnswer | NoAirframe:
    torque = all(min(f.flight.command_hz, f.flight.inertial_hz) >= TORQUE_HZ for f in (real, sim))
    known = sim.flight.has_voltage and real.flight.has_voltage
    volts = _full(sim) if known else None
    theirs, kind = _best_kind(sim, volts, torque=torque)
    likelihood = _likelihood(real, kind, volts, torque=torque)
    theta = by_itself(likelihood)
    loaded = with_load(likelihood, theta)
    if loaded.airframe.loaded_at is not None:  # a step that is not fitted would pass for noise of its own spectrum
        theta = by_itself(loaded, theta, _MORE_ROUNDS, load=True)
    ours = Side(loaded, expanded(loaded, theta, loaded.possible))
    for which, side in (("real", ours), ("simulated", theirs)):
        if reason := unusable(side.likelihood):
            return NoAirframe(f"{which} recording: {reason}", "a flight within the motors' limits")
    untestable = missing(ours.likelihood, theirs.likelihood, (ours.wind, theirs.wind))
    air = densities(real.air, sim.air, sim.parameters)
    alike = air if isinstance(air, Missing) else air.alike
    if alike is not None:
        untestable = (*untestable, alike)
    effects = _testable(theirs, kind, untestable, without, air if isinstance(air, Densities) else None)
    slewed = with_limit(ours, theirs, effects) if any(e.slew for e in effects) and not ended() else None
    effects = tuple(e for e in effects if slewed is not None or not e.slew)
    evidence = PairEvidence(ours, theirs, effects, None if slewed is None else slewed[0])
    answer = search(evidence, ended=ended)
    limit = None if slewed is None else slewed[1]
    assert isinstance(answer.evidence, PairEvidence)
    near = (real.near, answer.evidence.side_of(answer.best.model)), (sim.near, answer.evidence.sim)
    ground = None if GROUND in without else ground_gap(*near, ODDS)
    if isinstance(ground, Missing):
        return _answer(answer, real, sim, (*untestable, ground), limit, (), own=ours, held=not ended())
    beside = () if ground is None else (ground.told(),)
    return _answer(answer, real, sim, untestable, limit, beside, own=ours, held=not ended())


def _best_kind(sim: _Flight, volts: float | None, *, torque: bool) -> tuple[Side, Kind]:
    """The simulated flight with the kind that fits it best; each fit starts at the best point of the first."""
    kinds = _kinds(sim)
    first = _likelihood(sim, kinds[0], volts, torque=torque)
    best = by_itself(first)
    found = [(0.0, best, first, kinds[0])]
    spectra = first.spectra(best)
    for kind in kinds[1:]:
        other = _likelihood(sim, kind, volts, torque=torque)
        theta = by_itself(other, best, rounds=_MORE_ROUNDS)
        found.append((other.loglik(theta, spectra) - first.loglik(best, spectra), theta, other, kind))
    _, theta, likelihood, kind = max(found, key=lambda f: f[0])
    return Side(likelihood, expanded(likelihood, theta, likelihood.possible)), kind


def _testable(
    sim: Side, kind: Kind, untestable: Sequence[Missing], without: frozenset[str], air: Densities | None
) -> tuple[AirframeEffect, ...]:
    gone = {m.id for m in untestable if m.wholly} | without
    still = {axis for m in untestable for axis in m.axes}
    layout = sim.fit.layout
    gains = [sim.fit.value(f"gain_{axis}") for axis in AXES]
    named = catalogue(layout, kind, gains)
    if air is not None and air.alike is None:
        named = (*named, of_density(air, rotors_damp=kind.rotors_damp))
    torque = sim.likelihood.torque
    kept = [e for e in named if e.id not in gone and (torque or not e.torque) and not e.axes & still]
    free = (e for e in nameless(layout) if torque or not e.torque)
    return (*kept, *(e for e in free if e.domain is Domain.ENVIRONMENT or not shown_by(sim, e)))


def _answer(
    answer: Answer,
    real: _Flight,
    sim: _Flight,
    untestable: tuple[Missing, ...],
    slew: float | None,
    beside: tuple[FoundEffect, ...],
    *,
    own: Side,
    held: bool,
) -> AirframeAnswer:
    evidence = answer.evidence
    assert isinstance(evidence, PairEvidence)
    side = evidence.side_of(answer.best.model)
    untested = {m.id for m in untestable if not m.axes}
    tested = [e for e in evidence.effects if e.id not in untested]
    found = effects_of(answer, evidence, tested, slew, least=LIKELY, beside=beside)
    found = with_rivals(found, _beside_thrust(found, real, sim, side, untestable))
    parted = held_out(answer, evidence, found) if held else Parted((), None)
    loud = turbulence(real.flight, side.fit.residual[:, :3], sim.flight, evidence.sim.fit.residual[:, :3])
    unknown, share, chance = _unnamed(answer, found, gusty=loud.of_air)
    theta, _ = evidence.parameters(answer.best.model, answer.best.posterior)
    layout = side.fit.layout
    part = AirframePart(
        geometry=real.flight.geometry,
        commands=_commands(real.flight),
        rollout=parted.rollouts,
        wind=(float(theta[layout.place["wind_north"]]), float(theta[layout.place["wind_east"]])),
        manoeuvres=needed_manoeuvres(found, untestable),
        traces=_traces(side, evidence, answer),
        facts=_facts(own),
        probabilities=probabilities(answer, tested, beside),
    )
    return AirframeAnswer(
        found=found,
        missing=untestable,
        part=part,
        tested=len(answer.blocks) + len(beside),
        turbulence=loud if real.flight.estimated == sim.flight.estimated else None,  # GPS velocity is rougher
        jumps=tuple(jump for jump in real.jumps if jump.sudden),
        glitches=real.glitches,
        unknown=unknown,
        unknown_share=share,
        nameless=chance,
        heldout=parted.nats,
        warnings=(
            *doubtful(answer, tested, least=EVEN_ODDS, most=LIKELY, beside=beside),
            *latent(answer, evidence.effects, untestable, least=EVEN_ODDS),
        ),
    )


def _beside_thrust(
    found: Sequence[FoundEffect], real: _Flight, sim: _Flight, side: Side, untestable: Sequence[Missing]
) -> tuple[str, ...]:
    """Untested effects that may explain a thrust difference that was found entirely."""
    thrust = next((f.values[0] for f in found if f.id == "thrust_scale"), None)
    if thrust is None:
        return ()
    gone = {m.id for m in untestable}
    airframe = side.likelihood.airframe
    unseen = airframe.full_voltage is None
    sags = "battery_sag" in gone and (unseen or max(airframe.voltage_span, airframe.voltage_off) >= SAG_SPAN)
    air = densities(real.air, sim.air, sim.parameters)
    thin = isinstance(air, Densities) and air.alike is not None and air.explains(thrust.value, thrust.sd)
    weak = "motor_weak" in gone and thrust.value < 0.0
    rivals = {"battery_sag": sags, DENSITY: thin, "motor_weak": weak}
    return tuple(id_ for id_, possible in rivals.items() if possible)


def _unnamed(answer: Answer, found: Sequence[FoundEffect], *, gusty: bool) -> tuple[str, float, float]:
    """Text of the nameless effects, their share of the evidence, and their probability."""
    of_air = {g.id for g in GROUPS if g.of_air or (gusty and g.of_gusts)}
    if any(f.id == GROUND for f in found):
        of_air.add("height_force")  # the same force, seen from above
    texts = {g.id: g.text for g in GROUPS}
    ids = [b.name for b in answer.blocks if b.nameless and b.name not in of_air]
    chance = answer.probability(*ids)
    inside = [name for name in answer.best.model if name in texts and name not in of_air]
    if chance < LIKELY or not inside:
        return "", 0.0, chance
    lost = {name: _lost(answer, name) for name in inside}
    total = sum(lost.values()) + math.fsum(f.nats for f in found)
    return (
        "; ".join(texts[n] for n in sorted(inside, key=lambda n: -lost[n])),
        sum(lost.values()) / max(total, 1e-9),
        chance,
    )


def _lost(answer: Answer, name: str) -> float:
    """Nats that the best model loses without a block."""
    without = [v.log_weight for v in answer.kept if name not in v.model]
    least = lost_without(answer, [name])
    return least if not without else max(min(least, answer.best.log_weight - max(without)), 0.0)


def _facts(side: Side) -> dict[str, float]:
    """Parameters of the real airframe, for display."""
    of_turns = ("gain_x", "gain_y", "gain_z", "damping_x", "damping_y")
    names = ("k", "expo", "c1", "cz", "c2_x", "c2_y", *(of_turns if side.likelihood.torque else ()))
    return {name: float(f"{side.fit.value(name):.4g}") for name in names}


def _traces(side: Side, evidence: PairEvidence, answer: Answer) -> tuple[AirframeTrace, ...]:
    airframe = side.likelihood.airframe
    theta, before = evidence.parameters(answer.best.model, answer.best.posterior)
    before = np.where(evidence.sim.own, theta, before)
    step = max(round(airframe.flight.fs / _TRACE_HZ), 1)
    measured, patched = airframe.measured, airframe.predicted(theta)
    plain = evidence.real.likelihood.airframe.predicted(before)
    kinds = (("force", "m/s2"), ("torque", "rad/s2"))
    rows = slice(None, None, step)
    return tuple(
        AirframeTrace(kind, unit, airframe.flight.t[rows], measured[k][rows], plain[k][rows], patched[k][rows])
        for k, (kind, unit) in enumerate(kinds)
        if k == 0 or side.likelihood.torque
    )
