"""The physical check: do the streams behave as if every change of a plan were in force?

Read-back proves that a number is stored, not that it is used. PX4 ignores small changes, ArduPilot a COMPASS_SCALE out
of its window (FLIGHT_CONTROLLERS 1.3, 1.4). Either may be overwritten in the background. So the streams are undone
under every combination of old and new values. Each combination is compared with quantities independent of the vehicle's
pose (:mod:`calib.firmware.proof.discrepancy`). A parameter whose effect is below the noise is reported as not
observable, never as verified; the report names the movement that would prove it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.firmware.compose.draft import Subject
from mavcal.calib.firmware.compose.fitted import contents, pair_fits
from mavcal.calib.firmware.plan import Change, Movement, ParameterVerdict, ProofVerdict, Value, Verification, WritePlan
from mavcal.calib.firmware.proof.check import (
    ALL_APPLIED,
    Corrections,
    StreamCheck,
    check_stream,
    out_of_range,
    strongest,
)
from mavcal.calib.firmware.proof.evidence import StillMean, StreamEvidence, gather
from mavcal.calib.firmware.proof.force import Force, force_of
from mavcal.calib.firmware.proof.level_check import level_checks
from mavcal.calib.firmware.proof.sensor_check import sensor_checks
from mavcal.calib.firmware.slots import CALIBRATED
from mavcal.calib.fit import FitResult
from mavcal.calib.recording import Array, Recording, Sensor

WORTH: Final = 5.0
"""Predicted standard deviations above which a movement is worth requesting."""
NEAR: Final = 0.97
"""Cosine up to which a pose counts as a face (14 deg)."""
FACES: Final = (
    ("level", "upright", (0.0, 0.0, -1.0)),
    ("back", "upside down", (0.0, 0.0, 1.0)),
    ("left", "on its left side", (0.0, 1.0, 0.0)),
    ("right", "on its right side", (0.0, -1.0, 0.0)),
    ("nose_down", "nose down", (-1.0, 0.0, 0.0)),
    ("nose_up", "nose up", (1.0, 0.0, 0.0)),
)
"""Poses by name and in words, with the direction of their specific force in the body (FRD)."""
TEMPERATURE_MARGIN: Final = 0.1
"""Margin of a requested temperature to the calibrated range, as a fraction of the range."""
NEAR_ENOUGH: Final = 0.12
"""Fraction of the calibrated range within which another temperature adds no information."""


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
    usable = contents([f for f in fits if not f.relative])
    pairs = {p.about: p for p in pair_fits(usable.corrections)}
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
    trims, level = level_checks(plan, usable.levels, force, before=before, after=after, then=then, now=now)
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
offset was seen there within 2 s. Judging by that would require the state of the estimator, which is not streamed."""


def _unknown(about: Subject, force: Force, now: StreamEvidence) -> str:
    """Reason why the stream of `about` cannot be undone with the expected values; empty if it can."""
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
        text = next((outside[about] for about in waiting if about in outside), "") or _no_evidence_reason(waiting, now)
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


def _no_evidence_reason(waiting: Sequence[Subject], now: StreamEvidence) -> str:
    streamed = [about for about in waiting if about in now.readings]
    which = ", ".join(map(str, streamed or waiting))
    if not streamed:
        return f"{which} was not streamed after the write"
    if not any(now.readings[about] or now.moving.get(about) for about in streamed):
        return f"the vehicle was not still long enough to read {which}"
    return f"{which} was moved between the captures, or its temperature was not streamed: there is nothing to compare"


def movement_for(verdicts: Sequence[ParameterVerdict], checks: Mapping[Subject, StreamCheck]) -> Movement | None:
    """Movement that would prove the open parameters; None: there is none, or none are open."""
    settled = (ProofVerdict.PROVED, ProofVerdict.CONTRADICTED)
    open_ones = {v.name for v in verdicts if v.acts_on_stream and v.verdict not in settled}
    seen = {name for check in checks.values() for name in check.names}
    faces: dict[str, None] = {}
    turn, temperature = False, None
    for about, check in checks.items():
        names = [n for n in check.names if n in open_ones]
        if not names:
            continue
        temperature = _wished_temperature(check, names) if temperature is None else temperature
        if check.capture.expected is None:
            continue
        if about.sensor == Sensor.ACCEL:
            _choose_faces(check, names, faces)
        elif about.sensor == Sensor.MAG:
            turn = turn or _worth_turning(check, names)
    return _in_words(tuple(faces), still=bool(open_ones - seen), turn=turn, temperature=temperature)


def _in_words(faces: tuple[str, ...], *, still: bool, turn: bool, temperature: float | None) -> Movement | None:
    words = {face: text for face, text, _ in FACES}
    wishes = ["hold the vehicle still for five seconds"] if still else []
    if turn:
        wishes.append("turn the vehicle slowly through all directions")
    if faces:
        wishes.append("hold it still " + ", then ".join(words[face] for face in faces))
    if temperature is not None:
        wishes.append(f"leave it alone until its sensors are at about {temperature:.0f} degC")
    if not wishes:
        return None
    text = "; ".join(wishes)
    return Movement(text[:1].upper() + text[1:], faces, turn, temperature)


def _wished_temperature(check: StreamCheck, names: Sequence[str]) -> float | None:
    """The end of the calibrated range farther from the readings; None if temperature would not help."""
    whole = check.corrections.model(ALL_APPLIED).polynomial
    if whole is None or not any(_thermal(check, name) for name in names):
        return None
    low, high = whole.t_min, whole.t_max
    read = [r.temperature for r in check.capture.after if r.temperature is not None]
    margin = TEMPERATURE_MARGIN * (high - low)
    ends = (low + margin, high - margin)
    apart = [min((abs(end - t) for t in read), default=high - low) for end in ends]
    best = max(range(2), key=lambda k: apart[k])
    return ends[best] if apart[best] > NEAR_ENOUGH * (high - low) else None


def _thermal(check: StreamCheck, name: str) -> bool:
    """Whether the effect of `name` depends on temperature."""
    with_it, without = (check.corrections.model(h).polynomial for h in (ALL_APPLIED, check.without(name)))
    if with_it is None or without is None:
        return with_it is not without
    heat = np.array([with_it.t_min, 0.5 * (with_it.t_min + with_it.t_max), with_it.t_max])
    return bool(np.ptp(with_it(heat) - without(heat), axis=0).max() > 0.0)


def _choose_faces(check: StreamCheck, names: Sequence[str], faces: dict[str, None]) -> None:
    """Add to `faces` a pose for each of `names`, unless one already in it shows the effect."""
    shown = [_face_of(reading) for reading in check.capture.after]
    readings = {label: _reading(check, np.array(force)) for label, _, force in FACES if label not in shown}
    for name in names:
        promise = {label: check.distance_in(name, (reading,)) for label, reading in readings.items()}
        if not promise or any(promise.get(label, 0.0) >= WORTH for label in faces):
            continue
        best = max(promise, key=lambda label: promise[label])
        if promise[best] >= WORTH:
            faces[best] = None


def _face_of(reading: StillMean) -> str | None:
    """The face that a reading shows; None: it is oblique."""
    direction = reading.mean / max(float(np.linalg.norm(reading.mean)), float(np.finfo(np.float64).tiny))
    label, _, force = max(FACES, key=lambda face: float(direction @ np.array(face[2])))
    return label if float(direction @ np.array(force)) > NEAR else None


def _worth_turning(check: StreamCheck, names: Sequence[str]) -> bool:
    corners = [np.array(c) for c in np.ndindex(3, 3, 3) if c != (1, 1, 1)]
    turn = tuple(_reading(check, (c - 1.0) / np.linalg.norm(c - 1.0)) for c in corners)
    return any(check.distance_in(name, turn) >= WORTH for name in names)


def _reading(check: StreamCheck, direction: Array) -> StillMean:
    """Stream of a true vector along `direction` in the body, as precise as now."""
    capture = check.capture
    now = (*capture.after, *capture.invariant)[0]
    model = check.corrections.model(ALL_APPLIED)
    expected = capture.expected
    assert expected is not None
    size = expected.magnitude or float(np.linalg.norm(now.mean))
    raw = model.invert(size * direction, now.temperature)
    # the true reading is the one to which the fitted model gives the known length
    corrected = expected.model.apply(raw, now.temperature)
    raw = expected.model.invert(corrected * size / np.linalg.norm(corrected), now.temperature)
    mean = model.apply(raw, now.temperature)
    return StillMean(now.t, mean, now.covariance, now.temperature, now.current, now.throttle)
