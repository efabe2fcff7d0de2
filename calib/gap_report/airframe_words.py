"""Sentences of a report on the airframe beside its effects: source of the commands, and gain of the prediction."""

from __future__ import annotations

import math
from collections.abc import Sequence

from mavcal.calib.airframe.answer import AirframePart, Commands, Domain, Geometry, Quantity, Rollout
from mavcal.calib.gap.schema import EffectEstimate, GapReport

_MAIN = {Quantity.VELOCITY: 1.0, Quantity.BODY_RATE: 0.2}
"""Horizon, s, of the prediction error that the text states; the picture shows all of them. Chosen, not measured: long
enough to matter in flight."""
_NAMES = {Quantity.VELOCITY: "velocity", Quantity.BODY_RATE: "body rate"}
_GROUPS = {
    Domain.AIRFRAME: "Airframe",
    Domain.SENSOR: "Sensors",
    Domain.ENVIRONMENT: "The air and the events of the day",
}

_COMMANDS = {
    "rcou": "the logged outputs (RCOU)",
    "rate_mixer": "rebuilt from RATE and MOTB",
    "actuator_motors": "actuator_motors as logged",
    "controls": "rebuilt from the logged controls",
    "table": "the columns motor_1 and on",
}
"""Words for each source of the commands (:class:`calib.airframe.answer.Commands`)."""


def effects_of(report: GapReport, *domains: Domain) -> tuple[EffectEstimate, ...]:
    """The effects of these domains."""
    return tuple(e for e in report.effects if e.domain in domains)


def groups(report: GapReport) -> Sequence[tuple[str, Sequence[EffectEstimate]]]:
    """Effects by domain, each with a heading: airframe, sensors, then the day's environment."""
    found = ((heading, effects_of(report, domain)) for domain, heading in _GROUPS.items())
    return [(heading, effects) for heading, effects in found if effects]


def commands_sentence(commands: Commands) -> str:
    """Sentence on the source, rate and quality of the motors' commands."""
    whence = _COMMANDS.get(commands.source, commands.source)
    said = f"Commands of the motors: {whence} at {commands.rate_hz:.4g} Hz"
    check = commands.check_us
    said += "; nothing to check them against" if check is None else f"; {check:.2g} us from the logged outputs (median)"
    if commands.masked > 0.0:
        said += f"; {100.0 * commands.masked:.2g} % of the flight is left out, where an output was at its limit"
    return f"{said}."


def geometry_sentence(geometry: Geometry) -> str:
    """Sentence on the frame used and its source."""
    whence = {
        "parameters": "as its parameters say",
        "user": "as stated with --frame",
        "assumed": "assumed: state --frame",
    }
    name = f"{geometry.frame_class} {geometry.frame_type}".strip()
    return f"Frame: {name}, {len(geometry.motors)} motors, {whence.get(geometry.source, geometry.source)}."


def quantity_name(rollout: Rollout) -> str:
    """``velocity after 1 s``."""
    return f"{_NAMES[rollout.quantity]} after {rollout.h_s:g} s"


def closed_words(rollout: Rollout) -> str:
    """``94 % closed (91 to 96 %)``; in words if the number is meaningless, empty without effects."""
    if not rollout.sequence and rollout.closed is None:
        return ""
    if rollout.closed is None or not math.isfinite(rollout.closed):
        return "the part that is closed is not known"
    said = f"{100.0 * rollout.closed:.0f} % closed"
    return (
        said if rollout.ci95 is None else f"{said} ({100.0 * rollout.ci95[0]:.0f} to {100.0 * rollout.ci95[1]:.0f} %)"
    )


def error_words(rollout: Rollout) -> str:
    """``0.82 m/s, 0.14 with the effects, floor 0.10``; without effects only the first and the last."""
    changed = f", {sized(rollout, rollout.after)} with the effects" if rollout.sequence else ""
    return f"{sized(rollout, rollout.before)} {rollout.unit}{changed}, floor {sized(rollout, rollout.floor)}"


def sized(rollout: Rollout, error: float) -> str:
    """An error with as many decimals as the largest one needs for three digits."""
    if not (math.isfinite(error) and rollout.before > 0.0):
        return "not known"
    return f"{error:.{max(0, 2 - math.floor(math.log10(rollout.before)))}f}"


def rollout_sentence(part: AirframePart) -> str:
    """How far the effects improve the prediction of flight that was held out; empty where it was not predicted."""
    main = [r for r in part.rollout if math.isclose(r.h_s, _MAIN[r.quantity])]
    shown = main or list(part.rollout[:1])
    if not shown:
        return ""
    return f"Error of the predicted flight, on data that were held out. {'. '.join(map(predicted, shown))}."


def predicted(rollout: Rollout) -> str:
    """``Velocity after 1 s: 0.82 m/s, 0.14 with the effects, floor 0.10; 94 % closed (91 to 96 %)``."""
    return "; ".join(filter(None, (
        f"{quantity_name(rollout).capitalize()}: {error_words(rollout)}", closed_words(rollout), part_name(rollout),
    )))  # fmt: skip


def part_name(rollout: Rollout) -> str:
    """Held-out data in words, such as ``doublets held out``; empty for blocks of the flight, the usual case."""
    return "" if rollout.part == "blocks" else f"{rollout.part.replace('_', ' ')} held out"
