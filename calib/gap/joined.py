"""One report of sensors, airframe and air: the posterior of the flights beside the contest of the sensors.

The airframe has priority. An effect that its force explains, or that both units show equally and only in flight, is not
a sensor's. An effect on one unit only remains the sensor's.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from scipy.stats import chi2

from mavcal.calib.airframe.answer import Domain
from mavcal.calib.airframe.diagnose import LIKELY
from mavcal.calib.airframe.found import AirframeAnswer, FoundEffect, FoundValue, NoAirframe
from mavcal.calib.gap.effects import by_id
from mavcal.calib.gap.effects.base import NoiseEffect
from mavcal.calib.gap.effects.traits import SensorTerm, Trait
from mavcal.calib.gap.problem import Trace
from mavcal.calib.gap.progress import GapStage
from mavcal.calib.gap.sampling_jitter import is_sampling_jitter
from mavcal.calib.gap.schema import (
    EffectEstimate,
    EffectEvidence,
    GapReport,
    GapVerdict,
    NotTestable,
    ParameterEstimate,
    Rival,
    SequenceStep,
    Shrink,
    Unknown,
)
from mavcal.calib.gap.unknown.verdict import NOT_LASTING
from mavcal.calib.gap.witness import as_simulated, in_both_flights, not_borne_out, refuted_at_rest
from mavcal.calib.recording import Recording, Sensor

_Z95: Final = 1.959964
"""Standard errors on either side of 95 % of a normal distribution. Source: its quantile."""
_INERTIAL: Final = frozenset({str(Sensor.ACCEL), str(Sensor.GYRO)})
_BY_ITSELF: Final = frozenset({Trait.THERMAL, Trait.WANDERING})
_SPOKEN_OF: Final = 0.05
"""Probability above which an unnamed effect becomes a warning. Source: the prior odds of any effect."""
_BEYOND_CHANCE: Final = 5.0
"""Standard errors beyond which a size is neither chance nor an error of the reference. Source: a custom of physics, one
in three million."""
_LEAST_P: Final = 1e-300
"""Smallest probability that is written. Source: below lie numbers that a double holds with fewer digits."""


def joined(
    report: GapReport,
    answer: AirframeAnswer | NoAirframe,
    real: Recording,
    sim: Recording | None = None,
    companion: Sequence[Trace] = (),
) -> GapReport:
    """The sensors' report with airframe and air.

    Parameters
    ----------
    report
        Report of the sensors; `not_testable` where nothing could be compared.
    answer
        Result for the airframe.
    real
        The recording that both describe.
    sim
        The simulator's recording, whose units may differ as much.
    companion
        Its sensors against their own trajectory, which may show the same effects.
    """
    refuted = refuted_at_rest(report, real, sim)
    shared = tuple(e for e in not_borne_out(report, real) if e not in refuted)
    late = tuple(e for e in report.effects if is_sampling_jitter(e, real))
    gone = (*refuted, *shared, *late)
    same = () if sim is None else tuple(e for e in as_simulated(report, real, sim) if e not in gone)
    both = tuple(e for e in in_both_flights(report, companion) if e not in (*gone, *same))
    sensors = tuple(e for e in report.effects if e not in (*gone, *same, *both))
    said = (*report.warnings, *map(_as_simulated, same), *map(_in_both, both), *map(_refuted, refuted))
    said = (*said, *map(_late, late))
    unlikely = (e for e in sensors if e.evidence.probability < LIKELY and not _stands_out(e, report))
    doubtful = tuple(e for e in unlikely if _moves(e) or not _compared(report))
    sensors = tuple(e for e in sensors if e not in doubtful)
    in_doubt = map(_doubtful, (e for e in doubtful if e.evidence.probability >= _SPOKEN_OF))
    if isinstance(answer, NoAirframe):
        untested = NotTestable("airframe", answer.reason, answer.need)
        report = replace(report, not_testable=(*report.not_testable, untested))
        return _of_sensors(report, sensors, (*said, *_shared(shared, "the untested airframe may cause it"), *in_doubt))
    shaken = any(e.id == "accel_vibration" for e in sensors)
    found = (*map(_estimate, answer.found), *(() if shaken else _turbulence(answer, shared)), *_jumps(answer, real))
    effects = _with_shares((*found, *sensors))
    unknown = _unknown(report, answer, sensors)
    warnings = (*said, *_shared(shared, "it counts as airframe or air"), *in_doubt)
    return replace(
        report,
        verdict=_verdict(report, effects, unknown, answer),
        effects=effects,
        where=_where(report, sensors),
        unknown=unknown,
        shrink=_shrink(report, answer),
        not_testable=(*report.not_testable, *(NotTestable(m.id, m.reason, m.need) for m in _once(answer))),
        multiple_testing=replace(report.multiple_testing, m=report.multiple_testing.m + answer.tested),
        warnings=(*warnings, *answer.warnings),
        airframe=answer.part,
    )


def _of_sensors(report: GapReport, sensors: tuple[EffectEstimate, ...], warnings: tuple[str, ...]) -> GapReport:
    """The report of a flight whose airframe cannot be judged, with the effects that are certainly a sensor's."""
    if len(sensors) == len(report.effects):
        return replace(report, warnings=warnings)
    unknown = _without_flight(report, sensors)
    named = GapVerdict.PARTLY_EXPLAINED if unknown.flag else report.verdict
    alone = GapVerdict.UNKNOWN if unknown.flag else GapVerdict.NOT_TESTABLE
    return replace(
        report,
        verdict=named if sensors else alone,
        effects=_with_shares(sensors),
        where=_where(report, sensors),
        unknown=unknown,
        shrink=None,  # that of the whole set says nothing of what is left
        warnings=warnings,
    )


def _once(answer: AirframeAnswer) -> Iterator[NotTestable]:
    seen: set[str] = set()
    for one in answer.missing:
        if one.id not in seen:
            seen.add(one.id)
            yield NotTestable(one.id, one.reason, one.need)


def _estimate(found: FoundEffect) -> EffectEstimate:
    rivals = tuple(
        Rival(r.id, max(0.0, min(1.0, 1.0 - r.nats / max(found.nats, 1e-9))), 2.0 * r.nats, r.fix) for r in found.rivals
    )
    evidence = EffectEvidence(
        two_delta_loglik=2.0 * found.nats,
        df=found.df,
        p_adj=max(float(chi2.sf(2.0 * found.nats, max(found.df, 1))), _LEAST_P),
        probability=found.probability,
        share=found.share,
    )
    return EffectEstimate(
        id=found.id,
        sensor=None,
        instances=found.motors,
        params=tuple(map(_parameter, found.values)),
        evidence=evidence,
        confusable_with=rivals,
        domain=found.domain,
        forms=found.forms,
    )


def _parameter(value: FoundValue) -> ParameterEstimate:
    low, high = value.value - _Z95 * value.sd, value.value + _Z95 * value.sd
    ratio = 1.0 + value.value if value.relative else None
    interval = (1.0 + low, 1.0 + high) if value.relative else None
    return ParameterEstimate(
        value.name, value.value, value.sd, (low, high), value.unit, value.real, value.sim, ratio, interval
    )


def _turbulence(answer: AirframeAnswer, shared: tuple[EffectEstimate, ...]) -> Iterator[EffectEstimate]:
    """Turbulence as an effect; noise common to all accelerometers lowers its threshold."""
    loud = answer.turbulence
    noisy = any(e.sensor == Sensor.ACCEL and isinstance(by_id().get(e.id), NoiseEffect) for e in shared)
    if loud is not None and (loud.of_air or (noisy and loud.louder)):
        sigma = math.sqrt(max(loud.real**2 - loud.sim**2, 0.0))
        value = FoundValue("sigma", sigma, 0.1 * sigma, "m/s2", relative=False, real=loud.real, sim=loud.sim)
        chance = 1.0 if loud.shared is not None else 0.9
        yield _estimate(FoundEffect("turbulence", Domain.ENVIRONMENT, (), (value,), 0.0, 1, chance, 0.0))


def _jumps(answer: AirframeAnswer, real: Recording) -> Iterator[EffectEstimate]:
    """The largest jumps of the estimator and of the GPS; without a GPS position either may be the cause."""
    unseen = not any(c.sensor == Sensor.POSITION for c in real.channels)
    rivals = (Rival("gps_glitch", 1.0, 0.0, "log position and velocity of the GPS"),) if unseen else ()
    for id_, found, unit in (("ekf_reset", answer.jumps, "m/s"), ("gps_glitch", answer.glitches, "m")):
        if found:
            worst = max(found, key=lambda j: j.size)
            values = (
                FoundValue("t", worst.t, 0.2, "s", relative=False),
                FoundValue("size", worst.size, 0.1, unit, relative=False),
            )
            told = _estimate(FoundEffect(id_, Domain.ENVIRONMENT, (), values, 0.0, 1, 1.0, 0.0))
            yield replace(told, confusable_with=rivals) if id_ == "ekf_reset" else told


def _with_shares(effects: tuple[EffectEstimate, ...]) -> tuple[EffectEstimate, ...]:
    """`effects` with each one's share of the total evidence."""
    total = math.fsum(e.evidence.two_delta_loglik for e in effects)
    if total <= 0.0:
        return effects
    return tuple(replace(e, evidence=replace(e.evidence, share=e.evidence.two_delta_loglik / total)) for e in effects)


def _unknown(report: GapReport, answer: AirframeAnswer, sensors: tuple[EffectEstimate, ...]) -> Unknown:
    """The nameless part of the flight, else that of the sensors."""
    if answer.unknown and answer.nameless >= LIKELY:
        return Unknown(flag=True, share=answer.unknown_share, shape=answer.unknown)
    return _without_flight(report, sensors)


def _without_flight(report: GapReport, sensors: tuple[EffectEstimate, ...]) -> Unknown:
    """The sensors' unknown part, unless it is on an inertial sensor without a remaining effect."""
    left = report.unknown
    right = _INERTIAL - {str(e.sensor) for e in sensors}
    passing = left.shape == NOT_LASTING and {w.channel.split(".")[0] for w in report.where} <= right
    spoken = {name for name in (*_INERTIAL, str(Sensor.MAG)) if name in left.shape}
    flown = passing or (bool(spoken) and spoken <= right)
    return replace(left, flag=False, share=0.0, shape="") if left.flag and flown else left


def _shared(effects: Sequence[EffectEstimate], cause: str) -> Iterator[str]:
    """One warning for all effects that are not a unit's own."""
    if names := ", ".join(dict.fromkeys(effect.id for effect in effects)):
        yield f"not a sensor's: {names}; all units show it alike in flight, and none at rest: {cause}"


def _refuted(effect: EffectEstimate) -> str:
    return f"{effect.id} of {_units(effect)} is no gap: the readings of gravity at rest contradict it"


def _units(effect: EffectEstimate) -> str:
    return f"unit{'s' if len(effect.instances) > 1 else ''} {', '.join(map(str, effect.instances))}"


def _as_simulated(effect: EffectEstimate) -> str:
    return f"{effect.id} is no gap: the simulator's units differ from each other by as much"


def _in_both(effect: EffectEstimate) -> str:
    return f"{effect.id} of {_units(effect)} is no gap: the simulator's flight shows it as well"


def _late(effect: EffectEstimate) -> str:
    hz = next(p.value for p in effect.params if p.name == "frequency_hz")
    return (
        f"{effect.id} of {_units(effect)} at {hz:.0f} Hz is no vibration: it grows with the rate of change of the "
        "reading, as jitter of the sampling does"
    )


def _moves(effect: EffectEstimate) -> bool:
    """Whether an effect follows the forces of the flight, which no sensor model contains.

    Thermal effects and wandering noise are independent of them. A bias of an inertial unit is compared with that of the
    simulator's units; an offset of a compass may be an attitude error.
    """
    known = by_id().get(effect.id)
    if known is None:
        return True
    biased = known.term is SensorTerm.BIAS and effect.sensor in _INERTIAL
    return not (_BY_ITSELF & known.traits or biased)


def _compared(report: GapReport) -> bool:
    """Whether every effect was compared with its rivals; otherwise its probability is too high."""
    return not {GapStage.SELECTION, GapStage.RIVALS} & set(report.left_out)


def _stands_out(effect: EffectEstimate, report: GapReport) -> bool:
    """Whether an effect is larger than the residual: it is then certain, whichever unit has it.

    Not if another effect may replace it, or if something nameless is on the sensor. Noise does not enter the mean of a
    series, so it must gain more than two nats per number. Drift noise never qualifies. A size within five standard
    errors may be an error of the reference, which they include.
    """
    replaced = any(rival.id != effect.id for rival in effect.confusable_with)
    if replaced or (report.unknown.flag and str(effect.sensor) in report.unknown.shape):
        return False
    own = [s for s in report.series if s.sensor == effect.sensor and set(s.instances) & set(effect.instances)]
    known = by_id().get(effect.id)
    if isinstance(known, NoiseEffect):
        numbers = sum(s.residual.size for s in own)
        return not known.drifts and 0 < 4 * numbers < effect.evidence.two_delta_loglik
    if not any(abs(p.value) > _BEYOND_CHANCE * p.se for p in effect.params):
        return False
    for one in own:
        left = np.nanmean((one.residual - one.modelled) ** 2)
        if any(name.startswith(effect.id) and np.nanmean(p**2) > left for name, p in one.parts.items()):
            return True
    return False


def _doubtful(effect: EffectEstimate) -> str:
    fix = next((f"; to decide: {r.fix}" for r in effect.confusable_with if r.fix), "")
    chance = effect.evidence.probability
    return f"{effect.id} of {_units(effect)} is not named: its probability is {chance:.2f}, {LIKELY:g} is needed{fix}"


def _where(report: GapReport, sensors: tuple[EffectEstimate, ...]) -> tuple:  # type: ignore[type-arg]
    right = _INERTIAL - {str(e.sensor) for e in sensors}
    return tuple(w for w in report.where if w.channel.split(".")[0] not in right)


def _verdict(
    report: GapReport, effects: tuple[EffectEstimate, ...], unknown: Unknown, answer: AirframeAnswer
) -> GapVerdict:
    named = [e for e in effects if e.domain is not Domain.ENVIRONMENT]
    if named:
        return GapVerdict.PARTLY_EXPLAINED if unknown.flag else GapVerdict.EXPLAINED
    if unknown.flag:
        return GapVerdict.UNKNOWN
    return GapVerdict.NO_GAP if answer.tested else report.verdict


def _shrink(report: GapReport, answer: AirframeAnswer) -> Shrink | None:
    """How far the predicted flight improves, where the airframe has the gap; else that of the sensors."""
    held = answer.heldout
    if held is None or held.before <= 0.0 or not any(f.domain is Domain.AIRFRAME for f in answer.found):
        return report.shrink
    sequence = tuple(SequenceStep(name, 1.0 - left / held.before) for name, left in held.sequence)
    closed = 1.0 - held.after / held.before
    return Shrink(
        before=held.before,
        after=held.after,
        floor=0.0,
        floor_source="a fit without a simulator",
        closed=closed,
        ci95=None,
        nested=False,
        sequence=sequence,
        rms=report.shrink.rms if report.shrink is not None else {},
    )
