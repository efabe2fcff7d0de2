"""The physical check: do the streams behave as if every change of a plan were in force?

Read-back proves that a number is stored, not that it is used: PX4 ignores small changes, ArduPilot a COMPASS_SCALE out
of its window (FLIGHT_CONTROLLERS 1.3, 1.4), and either may be overwritten in the background. So the streams are undone
under every combination of old and new values. Each combination is compared with what does not depend on how the vehicle
lies (:mod:`calib.firmware.proof.discrepancy`). A parameter whose effect is lost in the noise is said to be not
observable, never verified.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.firmware.compose.content import contents
from mavcal.calib.firmware.compose.draft import Subject
from mavcal.calib.firmware.compose.fitted import pair_fits
from mavcal.calib.firmware.plan import Change, ParameterVerdict, ProofVerdict, Value, Verification, WritePlan
from mavcal.calib.firmware.proof.check import (
    ALL_APPLIED,
    Corrections,
    StreamCheck,
    check_stream,
    out_of_range,
    strongest,
)
from mavcal.calib.firmware.proof.evidence import StreamEvidence, gather
from mavcal.calib.firmware.proof.force import Force, force_of
from mavcal.calib.firmware.proof.level_check import level_checks
from mavcal.calib.firmware.proof.movement import movement_for
from mavcal.calib.firmware.proof.sensor_check import sensor_checks
from mavcal.calib.firmware.slots import CALIBRATED
from mavcal.calib.fit import FitResult
from mavcal.calib.recording import Recording, Sensor


def verify(
    plan: WritePlan,
    fits: Sequence[FitResult],
    before: Recording | None,
    after: Recording,
    *,
    parameters: Mapping[str, Value] | None = None,
) -> Verification:
    """Judge every change of `plan` by the streams.

    Parameters
    ----------
    plan
        As it was written.
    fits
        The fits (of raw recordings) that it was composed from; without any, only the streams before and after are
        compared.
    before
        A few seconds of the streams as they were before the write, vehicle at rest. None: not captured; then only
        what changes the length of a vector at rest can be proved.
    after
        The streams afterwards, corrected by the vehicle and not undone; still spans in it are used, and for a
        magnetometer its turning too.
    parameters
        The vehicle's parameters; None: as they are in `after` (and in `before`, for what was not read again).

    A combination of old and new values that no vehicle can have is left out. A sensor whose stream nothing undoes (a
    parameter was not seen, a scale is zero) is not observable, and that says why.

    Raises
    ------
    FirmwareError
        If the autopilot is not known.
    InvalidInputError
        If the recordings hold no parameters and none are given.
    """
    known = dict(parameters) if parameters is not None else _parameters(before, after)
    force = force_of(plan.fingerprint.autopilot, known, plan.changes)
    now = gather(after)
    then = gather(before) if before is not None else StreamEvidence({}, {}, frozenset())
    told = contents([f for f in fits if not f.relative])
    pairs = {p.about: p for p in pair_fits(told.corrections)}
    acting: dict[Subject, tuple[str, ...]] = {}
    checks: dict[Subject, StreamCheck] = {}
    outside: dict[Subject, str] = {}
    restarted = plan.needs_reboot or (before is not None and after.span[0] < before.span[1])
    for about in dict.fromkeys((*pairs, *_subjects(plan), *now.readings)):
        names = () if about in now.raw else force.acting(about)
        unknown = "" if about in now.raw else _unknown(about, force, now)
        if unknown:
            own = (about.sensor, about.instance)
            names = names or tuple(c.name for c in plan.changes if (c.sensor, c.instance) == own)
            if names:
                acting[about], outside[about] = names, unknown
            pairs.pop(about, None)
            continue
        if not names:
            continue
        acting[about] = names
        check = check_stream(about, names, force, pairs.get(about), then, now, restarted=restarted)
        if check is not None:
            checks[about] = check
        elif beyond := out_of_range(about, force, pairs.get(about), now):
            outside[about] = beyond
    trims, level = level_checks(plan, told.levels, force, before=before, after=after, then=then, now=now)
    verdicts = tuple(
        trims.get(change.name) or _verdict(change, checks, acting, now, outside, force) for change in plan.changes
    )
    blind = [about for about in acting if not (now.readings.get(about) or now.moving.get(about))]
    unseen = tuple(c.name for c in plan.changes if any(c.name in acting[about] for about in blind))
    late = {name for about in outside for name in acting[about]}
    waited_for = tuple(v for v in verdicts if v.name not in late or v.name in unseen)
    sensors = (*sensor_checks(plan, pairs, now, force), *level)
    return Verification(verdicts, movement_for(waited_for, checks), sensors, unseen)


def _parameters(before: Recording | None, after: Recording) -> dict[str, Value]:
    known = {**(before.parameters.final() if before is not None else {}), **after.parameters.final()}
    if not known:
        raise InvalidInputError("the physical check needs the vehicle's parameters: read them before or after it")
    return known


_RAW: Final = (
    "the stream of this sensor is raw and does not depend on it; the corrected one is sent less a bias that the "
    "estimator learns within seconds, so it proves nothing; it was read back"
)
"""PX4's magnetometers: SCALED_IMU raw, HIGHRES_IMU less the estimator's bias (FLIGHT_CONTROLLERS 2.2). Half of a new
offset was seen there within 2 s; to judge by that, the state of the estimator had to be streamed too, and it is not."""


def _unknown(about: Subject, force: Force, now: StreamEvidence) -> str:
    """In words, why nothing undoes the stream of `about` as it should be by now; empty if something does."""
    readings = (*now.readings.get(about, ()), *now.moving.get(about, ()))
    why = Corrections(force, about).why_impossible(ALL_APPLIED, readings)
    return f"the stream of {about} cannot be undone ({why}); it was read back" if why else ""


def _subjects(plan: WritePlan) -> tuple[Subject, ...]:
    sensors = (Sensor.ACCEL, Sensor.GYRO, Sensor.MAG)
    return tuple(Subject(c.sensor, c.instance) for c in plan.changes if c.sensor in sensors)


def _verdict(
    change: Change,
    checks: Mapping[Subject, StreamCheck],
    acting: Mapping[Subject, tuple[str, ...]],
    now: StreamEvidence,
    outside: Mapping[Subject, str],
    force: Force,
) -> ParameterVerdict:
    name = change.name
    check = strongest(checks, name)
    if check is not None:
        verdict = check.judgement.verdicts[name]
        text = _text(verdict, check)
        return ParameterVerdict(name, verdict, check.effect(name), check.sd(name), check.unit, text)
    waiting = [about for about, names in acting.items() if name in names]
    if waiting:
        text = next((outside[about] for about in waiting if about in outside), "") or _why_nothing(waiting, now)
    elif now.raw:
        text = _RAW
    elif change.sensor in CALIBRATED and name in force.without_alternative(Subject(change.sensor, change.instance)):
        text = "its old value fits beside no other, so there is nothing to tell it from; it was read back"
    else:
        text = "no stream depends on it; it was read back"
    return ParameterVerdict(name, ProofVerdict.NOT_OBSERVABLE, 0.0, 0.0, "", text, acts_on_stream=bool(waiting))


def _text(verdict: ProofVerdict, check: StreamCheck) -> str:
    by = "the streams before and after" if check.equality else "the length of its vector at rest"
    scatter = "" if check.judgement.explained else "; they scatter more than noise and fit explain"
    if verdict == ProofVerdict.PROVED:
        return f"{by} agree with the new value and contradict the old one"
    if verdict == ProofVerdict.CONSISTENT and scatter:
        return f"{by} are nearer to the new value than to the old one{scatter}"
    if verdict == ProofVerdict.CONSISTENT:
        return f"{by} agree with the new value, but also with the old one beside other changes"
    if verdict == ProofVerdict.NOT_OBSERVABLE:
        return f"its effect is below 3 standard deviations of {by} in these attitudes{scatter}"
    return f"{by} behave as if the old value were still in force{scatter}"


def _why_nothing(waiting: Sequence[Subject], now: StreamEvidence) -> str:
    streamed = [about for about in waiting if about in now.readings]
    which = ", ".join(map(str, streamed or waiting))
    if not streamed:
        return f"{which} was not streamed after the write"
    if not any(now.readings[about] or now.moving.get(about) for about in streamed):
        return f"the vehicle was not still long enough to read {which}"
    return f"{which} was moved between the captures, or its temperature was not streamed: there is nothing to compare"
