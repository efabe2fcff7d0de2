"""Sentences of a gap report for readers who do not know the method."""

from __future__ import annotations

import math

from mavcal.calib.airframe.answer import Domain
from mavcal.calib.airframe.diagnose import LIKELY
from mavcal.calib.gap.effects import by_id
from mavcal.calib.gap.progress import GapStage
from mavcal.calib.gap.schema import (
    REFERENCE_NEED,
    USELESS_DEG,
    EffectEstimate,
    GapReport,
    GapVerdict,
    LocatedGap,
    Shrink,
)
from mavcal.calib.gap_report import airframe_effects
from mavcal.calib.gap_report.intervals import after_number

_ENDLESS = 1e300
NATS = "One nat a sample: a reading is 2.7 times less likely than noise alone would make it."
_FINEST = 7
"""Most decimals of a number with an error."""
_SENSORS = {"accel": "accelerometer", "gyro": "gyroscope", "mag": "magnetometer"}
_VERDICTS = {
    GapVerdict.EXPLAINED: "The real sensors differ from the simulated ones, and known effects explain the difference.",
    GapVerdict.PARTLY_EXPLAINED: (
        "Known effects explain part of the difference; the rest is of a kind that is not known."
    ),
    GapVerdict.UNKNOWN: "The real sensors differ from the simulated ones, and no known effect explains it.",
    GapVerdict.REFERENCE: "What differs is the reference, not a sensor.",
    GapVerdict.NO_GAP: "No difference beyond the noise was found.",
    GapVerdict.NOT_TESTABLE: "These recordings do not allow an answer.",
}
_FLIGHTS = {
    GapVerdict.EXPLAINED: (
        "The real vehicle flies differently from the simulated one, and known effects explain the difference."
    ),
    GapVerdict.UNKNOWN: "The real flight differs from the simulated one, and no known effect explains it.",
    GapVerdict.REFERENCE: "What differs in the sensors is the reference's; the vehicle itself flies differently.",
}
"""Verdicts whose wording changes if the airframe was compared."""
_BOTH = (
    "The real vehicle flies differently from the simulated one and its sensors read differently; known effects explain "
    "the difference."
)
_ONE_OF_SEVERAL = {
    Domain.SENSOR: "The real sensors differ from the simulated ones.",
    Domain.AIRFRAME: "The real vehicle flies differently from the simulated one.",
}
"""First sentence, by domain, where one of several effects explains the difference."""
_WHICH = "One of several known effects explains it; these recordings do not tell which."
_DAY_ONLY = "The vehicle and its sensors are as simulated as far as these flights show; only the day differed."
_AS_SIMULATED = "The vehicle flies as the simulated one, as far as these flights show."
_UNFINISHED = {
    GapVerdict.PARTLY_EXPLAINED: "Known effects explain part of the difference; there was no time to try them all.",
    GapVerdict.NOT_TESTABLE: "There was no time for an answer.",
}
"""Verdicts of a diagnosis that its limit ended."""


def verdict_sentence(report: GapReport, *, listed: bool = True) -> str:
    """The answer in one or two sentences, with the effects if `listed`."""
    said = _useless(report) if report.inputs.useless else _verdict(report)
    if set(report.left_out) - {GapStage.BLOCKS.value}:
        said = _UNFINISHED.get(report.verdict, said)
    if report.verdict is GapVerdict.REFERENCE and not report.effects and not report.inputs.useless:
        said = "No difference beyond the error of the reference was found."
    explained = report.verdict in {GapVerdict.EXPLAINED, GapVerdict.PARTLY_EXPLAINED}
    named = explained or report.inputs.useless or _domains(report) - {Domain.SENSOR}
    if listed and named and report.effects:
        sure = [e for e in report.effects if not e.evidence.doubtful]
        unsettled = [f"({chance(e.evidence.probability)}) {effect_phrase(e)}" for e in sure if _has_rivals(e)]
        likely = [effect_phrase(e) for e in sure if e.domain is not Domain.ENVIRONMENT and not _has_rivals(e)]
        of_day = [airframe_effects.phrase(e) for e in sure if e.domain is Domain.ENVIRONMENT]
        doubtful = [effect_phrase(e) for e in report.effects if e.evidence.doubtful]
        said += f" Found: {'; '.join(likely)}." if likely else ""
        said += f" Likely, or else one of the rivals below: {'; '.join(unsettled)}." if unsettled else ""
        said += f" Of the day, and not exported: {'; '.join(of_day)}." if of_day else ""
        said += f" In doubt, since something else is likelier: {'; '.join(doubtful)}." if doubtful else ""
    return f"{said}{_sensors_untested(report)}{_airframe_untested(report)}"


def _airframe_untested(report: GapReport) -> str:
    """Why the answer is not about the airframe of a flight; empty: it is, or there is no answer."""
    if report.verdict is GapVerdict.NOT_TESTABLE:
        return ""
    return "".join(f" The airframe was not compared: {n.reason}." for n in report.not_testable if n.id == "airframe")


def _has_rivals(effect: EffectEstimate) -> bool:
    """Whether an effect is the likeliest of several competing ones, and not certain."""
    return effect.evidence.probability < LIKELY and bool(effect.confusable_with or effect.domain is Domain.AIRFRAME)


def _domains(report: GapReport) -> set[Domain]:
    return {effect.domain for effect in report.effects}


def _verdict(report: GapReport) -> str:
    """The verdict, of what was compared: sensors, the flight, or both."""
    domains = _domains(report)
    if domains == {Domain.ENVIRONMENT} and report.verdict in {GapVerdict.EXPLAINED, GapVerdict.NO_GAP}:
        return _DAY_ONLY
    if domains >= {Domain.AIRFRAME, Domain.SENSOR} and report.verdict is GapVerdict.EXPLAINED:
        return _BOTH
    lasting = [e for e in report.effects if e.domain is not Domain.ENVIRONMENT]
    if (
        report.verdict is GapVerdict.EXPLAINED
        and len({e.domain for e in lasting}) == 1
        and all(map(_has_rivals, lasting))
    ):
        return f"{_ONE_OF_SEVERAL[lasting[0].domain]} {_WHICH}"
    nameless = report.verdict is GapVerdict.UNKNOWN and not any(f"on {s}" in report.unknown.shape for s in _SENSORS)
    of_flight = Domain.AIRFRAME in domains or (_flown(report) and nameless)
    return _FLIGHTS.get(report.verdict, _VERDICTS[report.verdict]) if of_flight else _VERDICTS[report.verdict]


def _only_flight(report: GapReport) -> bool:
    """Whether only the flights were compared, which needs no reference attitude, and no sensor."""
    return report.inputs.useless and (_flown(report) or bool(_domains(report) - {Domain.SENSOR}))


def _flown(report: GapReport) -> bool:
    """Whether two flights were compared."""
    return report.airframe is not None and bool(report.airframe.probabilities)


def _sensors_untested(report: GapReport) -> str:
    """Why the answer is about the flight alone; empty otherwise."""
    if not _only_flight(report):
        return ""
    return f" No sensor was compared: the reference's {_why_useless(report)}. For the sensors, give {REFERENCE_NEED}."


def _why_useless(report: GapReport) -> str:
    sigma = report.inputs.att_sigma_deg
    if not math.isfinite(sigma):
        return "trajectory contradicts the inertial unit all the time"
    return f"attitude is known to {sigma:.1f} degrees only, {USELESS_DEG:g} are needed"


def _useless(report: GapReport) -> str:
    """States that no sensor was judged by the reference, what would improve it, and what is reported nevertheless."""
    if _only_flight(report):
        as_simulated = report.verdict is GapVerdict.NO_GAP and not report.effects
        return _AS_SIMULATED if as_simulated else _verdict(report)
    said = (
        f"The reference is of no use: its {_why_useless(report)}. No sensor was compared with it. "
        f"To make it better, give {REFERENCE_NEED}."
    )
    if not report.tested:
        return said
    if not report.effects and not report.unknown.flag:
        return f"{said} Compared with each other, the units of the vehicle show no difference beyond the noise."
    return f"{said} What follows is only what units of the vehicle show against each other."


def not_compared(report: GapReport) -> str:
    """Sentence on recorded sensors that were not compared; empty: all were."""
    lost = dict.fromkeys(n.id for n in report.not_testable if n.id in _SENSORS)
    if not lost or report.verdict is GapVerdict.NOT_TESTABLE or report.inputs.useless:  # the verdict says it
        return ""
    return f"Not compared, at least in part: {', '.join(_SENSORS[name] for name in lost)}; the reasons are below."


def effect_phrase(effect: EffectEstimate) -> str:
    """``a constant offset of accelerometer 1 (accel_bias)``; of airframe and air what was found, with its size."""
    if effect.domain is Domain.ENVIRONMENT:
        return f"{airframe_effects.phrase(effect)}: a finding about the day, not exported"
    if effect.domain is Domain.AIRFRAME:
        return airframe_effects.phrase(effect)
    known = by_id().get(effect.id)
    if known is None:  # of a report that another version wrote
        return f"{effect.id.replace('_', ' ')}, {sensor_name(effect)} ({effect.id})"
    return f"{known.plain}{'' if known.shared else f', {sensor_name(effect)}'} ({effect.id})"


def held_out(effect: EffectEstimate) -> str:
    """Whether the effect was confirmed in held-out data."""
    held = effect.gates.heldout_blocks
    return "not held out" if held is None else f"{'holds' if held else 'does not hold'} on held-out data"


def sim_patch(effect: EffectEstimate) -> str:
    """Parameters of the simulator that make the effect; empty: it has none. Tables of a file are left to the export."""
    numbers = {n: v for n, v in effect.sim_patch.items() if isinstance(v, int | float)}
    return ", ".join(f"{name} {value:.6g}" for name, value in numbers.items() if value)


def sensor_name(effect: EffectEstimate) -> str:
    """``accelerometer 1``, ``magnetometers 1, 2, 3``; the domain where no sensor is wrong."""
    if effect.sensor is None:
        return effect.domain.value
    name = _SENSORS.get(effect.sensor.value, effect.sensor.value)
    numbers = ", ".join(map(str, effect.instances))
    return f"{name}{'s' if len(effect.instances) > 1 else ''} {numbers}"


def number(value: float | None) -> str:
    """A number with four digits; unknown or infinite ones in words."""
    if value is None or value != value:
        return "not known"
    return f"{value:.4g}" if abs(value) < _ENDLESS else "unbounded"


def with_error(value: float, se: float | None, unit: str) -> str:
    """A number and its standard error with the same decimals, two digits of the error."""
    if se is None or not 0.0 < se < _ENDLESS:
        return f"{number(value)} +- {quantity(se, unit)}"
    decimals = max(0, 1 - math.floor(math.log10(se)))
    if decimals > _FINEST:
        return f"{number(value)} +- {quantity(se, unit)}"
    return f"{value:.{decimals}f} +- {quantity(float(f'{se:.{decimals}f}'), unit)}"


def chance(probability: float) -> str:
    """A probability in whole percent."""
    if probability > 0.995:
        return "over 99 %"
    return "under 1 %" if probability < 0.005 else f"{100.0 * probability:.0f} %"


def closed_sentence(shrink: Shrink | None) -> str:
    """How far the gap shrinks."""
    if shrink is None:
        return (
            "How far the gap shrinks was not measured: the recording is too short to hold parts of it back, or some of "
            "what was found is no sensor's."
        )
    if shrink.closed is None:
        return (
            f"Nothing measurable to close: {number(shrink.before)} nats a sample before, {number(shrink.after)} after. "
            f"{NATS}"
        )
    if shrink.known is None and shrink.ci95 is not None:
        low, high = shrink.ci95
        return (
            f"How far the gap shrinks is not known: the 95 % interval of the share is {low:.1f} to {high:.1f}. "
            "The parts of the recording that were held out disagree; a longer recording says more."
        )
    interval = "" if shrink.ci95 is None else f" (95 % interval {shrink.ci95[0]:.3f} to {shrink.ci95[1]:.3f})"
    return (
        f"On data that were held out, adding the effects closes {100.0 * shrink.closed:.1f} % of the gap{interval}: "
        f"from {number(shrink.before)} to {number(shrink.after)} nats a sample, the floor being {number(shrink.floor)} "
        f"({shrink.floor_source.replace('_', ' ')}). {NATS}"
    )


def regime(found: LocatedGap) -> str:
    """Condition of a located gap: ``temperature 20..24 degC``."""
    if found.regime.kind == "all":
        return "whole recording"
    low, high = (0.0 if abs(edge) < 1e-9 else edge for edge in found.regime.bin)
    if f"{low:.3g}" == f"{high:.3g}":
        return f"{found.regime.kind} {low:.3g}{after_number(found.regime.unit)}"
    return f"{found.regime.kind} {low:.3g}..{high:.3g}{after_number(found.regime.unit)}"


def quantity(value: float | None, unit: str) -> str:
    """A number with its unit, where it has one."""
    return f"{number(value)}{after_number(unit)}"


def interval(low: float, high: float) -> str:
    """``0.1 to 0.3``; in words where a parameter has no bounds of its own."""
    if not (abs(low) < _ENDLESS and abs(high) < _ENDLESS):
        return "not determined by itself"
    return f"{number(low)} to {number(high)}"
