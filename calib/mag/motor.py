"""Field of the motors at a compass from an ordinary flight, against current, throttle or motor outputs.

Each drive signal is fitted together with all other unknowns of a flight (:mod:`calib.mag.flight`: offset, attitude,
gyroscope, delay), so that none of these is mistaken for it. Before a term is proposed, models with and without it
(:mod:`calib.mag.motor_candidates`) are compared on held-out parts of the flight (:mod:`calib.mag.motor_hidden`). The
term must improve every part, with the gyroscope's attitude and with the log's.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Unpack

import numpy as np

from mavcal.calib.errors import UndeterminedError
from mavcal.calib.fit import FitResult, parameter_names
from mavcal.calib.mag.flight_input import FlightInput, prepared, unusable
from mavcal.calib.mag.flight_path import Turning
from mavcal.calib.mag.flight_problem import OFFSET
from mavcal.calib.mag.motor_candidates import (
    BY_GYROSCOPE,
    LEAST_GAIN,
    LEAST_HEADING,
    Candidate,
    candidates_of,
    chosen_of,
    gain_of,
    gains_of,
    improves_prediction,
    unknown_share,
)
from mavcal.calib.mag.motor_drives import METHOD, UNIT, Drive, DriveKind
from mavcal.calib.mag.motor_hidden import STRETCHES, SURE, unusable_attitude
from mavcal.calib.mag.result import CompassFit, MagContext, MagFacts, compass_result
from mavcal.calib.recording import Array, Channel
from mavcal.calib.stats.residuals import residual_statistics
from mavcal.calib.triad import TriadModel

MOVEMENT = "record from before the motors start, then hover, climb and descend, so that the current changes"
_LEAST_TIME = 40.0  # s: hidden stretches of some length, and enough left to fit
_UNKNOWN = 0.05  # of the field over the range of the drive: a term that is no better known is not determined
_LOG_ROUGH = 0.3  # of the field, with an attitude that says nothing to a compass
_NEVER_CALIBRATED = 0.5  # of the field: offset beside a calibration in force that has none
_ROUGHEST = 0.3  # of the field, left of the fit without motors: nothing beside it is told
_DISAGREES = 4.0  # sd between what the gyroscope and what the logged attitude make of the motors
_MOVES = {DriveKind.CURRENT: 3.0, DriveKind.THROTTLE: 0.2, DriveKind.MOTORS: 0.2}
"""Least range of a drive signal: A for a current, 0..1 for throttle and motor outputs."""


def fit_motor(
    mag: Channel,
    turning: Turning,
    drives: Sequence[Drive],
    *,
    in_force: TriadModel | None = None,
    window: float = 0.0,
    **facts: Unpack[MagFacts],
) -> FitResult:
    """The motors' field at one compass, and whether to compensate it.

    Parameters
    ----------
    mag
        Of the bare sensor, in its own axes, without any compensation.
    turning
        As for :func:`calib.mag.flight.fit_flight`.
    drives
        Possible drive signals, the simplest first.
    in_force
        The correction in force, sensor axes to body; the term is given behind it. None: none.
    window
        Time over which the compass averages, s.
    **facts
        :class:`calib.mag.result.MagContext`.

    Returns
    -------
    FitResult
        `model` is the correction in force, held fixed. ``native`` has the term: ``corrected = model(measured) -
        interference * drive``; ``proposed`` says whether hidden data want it. Refused where the drive hardly changes.

    Raises
    ------
    InvalidInputError
        If the clocks go back, or units or shapes do not fit.
    """
    context = MagContext(**facts)
    plain = prepared(mag, turning, in_force, None, window, context)
    reason = unusable(plain)
    if not reason and not drives:
        reason = "neither current nor throttle nor motor outputs that change are in the recording"
    lasts = plain.samples.t[-1] - plain.samples.t[0] if len(plain.samples.t) else 0.0
    if not reason and lasts < _LEAST_TIME:
        reason = f"{lasts:.0f} s of flight are too few to hide stretches of: {_LEAST_TIME:.0f} s are needed"
    if reason:
        return _refusal(context, len(mag), f"{reason}; {MOVEMENT}")
    try:
        candidates = candidates_of(mag, turning, drives, in_force, window, context)
    except UndeterminedError as error:
        return _refusal(context, len(mag), f"{error}; {MOVEMENT}")
    return _verdict(candidates, plain, in_force or TriadModel(), context, len(mag))


def _refusal(context: MagContext, count: int, message: str, **quality: Any) -> FitResult:
    return context.made(METHOD, count).refused(message, (), quality=quality)


def _verdict(
    candidates: list[Candidate], data: FlightInput, in_force: TriadModel, context: MagContext, count: int
) -> FitResult:
    none, chosen = candidates[0], chosen_of(candidates)
    quality = _quality(candidates, chosen, context)
    lost = unusable_attitude(data, none.found, in_force, context)
    if lost and chosen is none:
        return _refusal(context, count, lost, **quality)
    left = quality["residual_rms"] / float(np.linalg.norm(none.found.x[none.found.layout.field]))
    if chosen is none and left > _ROUGHEST:
        return _refusal(
            context,
            count,
            f"compass and attitude do not agree even without the motors ({left:.0%} of the field is left): nothing can "
            "be told of the motors before that is mended; check the compass's mounting and axes, its parameters, and "
            "that it reads the Earth's field (mavcal inspect)",
            **quality,
        )
    if chosen is none and min(unknown_share(c) for c in candidates[1:]) > _UNKNOWN:
        return _refusal(context, count, f"{_why_unknown(candidates[1:])}: {MOVEMENT}", **quality)
    best = chosen if chosen is not none else min(candidates[1:], key=lambda c: c.hidden.rms)
    native = _native(candidates, chosen, data, in_force, context)
    return compass_result(
        CompassFit(
            METHOD,
            in_force,
            np.zeros((len(parameter_names()),) * 2),
            n_samples=count,
            n_used=chosen.found.used,
            message=_message(none, chosen, best, native, context.unit),
            residual_rms=quality["residual_rms"],
            condition_number=quality["condition_number"],
            quality=quality,
            native=native,
            warnings=_warnings(native, chosen, none, context),
        ),
        context,
    )


def _why_unknown(candidates: Sequence[Candidate]) -> str:
    """Reason why the motors' field is not determined: their drive hardly changes, or other things change with it."""
    best = min(candidates, key=unknown_share)
    assert best.drive is not None
    moved, least = float(best.drive.range.max()), _MOVES[best.drive.kind]
    if moved < least:
        return "the drive of the motors hardly changes, so their field cannot be told from the offset"
    unit = " A" if best.drive.kind == DriveKind.CURRENT else ""
    return (
        f"the field of the motors cannot be told from offset and turns: {best.kind} moved by {moved:.2g}{unit}, and "
        f"what it does is known to {unknown_share(best):.0%} of the field only"
    )


def _quality(candidates: Sequence[Candidate], chosen: Candidate, context: MagContext) -> dict[str, Any]:
    found = chosen.found
    weights = found.flight.weights
    kept = weights > 0.0
    standard = found.solved.residuals[kept] / found.noise[kept, None]
    free = found.prior.sd > 0.0
    covariance = found.solved.covariance[np.ix_(free, free)]
    unit = np.sqrt(np.diag(covariance))
    field = found.x[found.layout.field]
    horizontal = max(math.hypot(float(field[0]), float(field[1])), 1e-9)
    drive = chosen.drive
    variance = 0.0
    if drive is not None:
        peaks = np.repeat(drive.range, 3)
        spread = chosen.covariance * np.outer(peaks, peaks)
        whole = spread.reshape(len(drive.range), 3, len(drive.range), 3).sum(axis=(0, 2))
        variance = float(np.linalg.eigvalsh(whole)[-1])
    return {
        **residual_statistics(standard, 3 * len(standard) - found.layout.size, None),
        "residual_rms": math.sqrt(
            float((weights[kept, None] * found.solved.residuals[kept] ** 2).sum()) / float(weights.sum())
        ),
        "condition_number": float(np.linalg.cond(covariance / np.outer(unit, unit))),
        "variance_inflation": found.inflation,
        "n_outliers": len(weights) - found.used,
        "heading_sd_deg": math.degrees(math.sqrt(max(variance, 0.0)) / horizontal),
        "heading_dip_deg": math.degrees(math.atan2(float(field[2]), horizontal)),
        "held_out_rms": {c.kind: c.hidden.rms for c in candidates},
        "held_out_blocks": len(chosen.hidden.scores),
        "radius": float(np.linalg.norm(field)),
    }


def _native(
    candidates: Sequence[Candidate], chosen: Candidate, data: FlightInput, in_force: TriadModel, context: MagContext
) -> dict[str, Any]:
    none = candidates[0]
    gain = gain_of(data, in_force)
    offset = chosen.found.x[OFFSET] - data.offset_in_force
    strength = float(np.linalg.norm(chosen.found.x[chosen.found.layout.field]))
    drive = chosen.drive
    return {
        "proposed": drive is not None,
        "drive": None if drive is None else str(drive.kind),
        "held_out_rms_before": none.hidden.rms,
        "held_out_rms_after": chosen.hidden.rms,
        **(_term(chosen, none, gain, context) if drive is not None else {}),
        "candidates": {c.kind: _term(c, none, gain, context) for c in candidates[1:]},
        "attitude_trusted": _with_logged_attitude(candidates),
        "offset_beside": (gain @ offset).tolist(),
        "offset_beside_sd": np.sqrt(np.diag(gain @ chosen.found.solved.covariance[OFFSET, OFFSET] @ gain.T)).tolist(),
        "never_calibrated": bool(
            float(np.linalg.norm(offset)) > _NEVER_CALIBRATED * strength
            and not np.any(np.abs(data.offset_in_force) > 1e-3 * strength)
        ),
    }


def _with_logged_attitude(candidates: Sequence[Candidate]) -> dict[str, Any] | None:
    """Fit with the log's attitude and heading as the truth, for comparison only.

    Its heading came from a compass: a correction at arming or in flight then looks like the motors' field.
    """
    none, first = candidates[0].log, candidates[1]
    if none is None or first.log is None or first.drive is None:
        return None
    return {
        "drive": str(first.drive.kind),
        "interference": _one_or_all(first.log.term),
        "interference_sd": _one_or_all(first.log.term_sd),
        "offset": first.log.offset.tolist(),
        "rms_before": none.rms,
        "rms_after": first.log.rms,
    }


def _one_or_all(rows: Array) -> list[Any]:
    """The only row, or all of them."""
    return list((rows[0] if len(rows) == 1 else rows).tolist())


def _term(candidate: Candidate, none: Candidate, gain: Array, context: MagContext) -> dict[str, Any]:
    """The term after the correction in force: the motors' field, and its compensation."""
    drive = candidate.drive
    if drive is None:
        return {}
    count = len(drive.numbers)
    every = np.kron(np.eye(count), gain)
    sd = np.sqrt(np.diag(every @ candidate.covariance @ every.T)).reshape(-1, 3)
    term = (gain @ candidate.term).T
    log = candidate.log
    return {
        "proposed": improves_prediction(candidate, none),
        "interference": _one_or_all(term),
        "interference_sd": _one_or_all(sd),
        "compensation": _one_or_all(-term),
        "unit": f"{context.unit}/{UNIT[drive.kind]}",
        "motors": list(drive.numbers) if drive.kind == DriveKind.MOTORS else None,
        "squared": list(drive.squares) if any(drive.squares) else None,
        "range": drive.range.tolist() if count > 1 else float(drive.range[0]),
        "held_out_rms": candidate.hidden.rms,
        "by_log": None
        if log is None
        else {"interference": _one_or_all(log.term), "interference_sd": _one_or_all(log.term_sd)},
        "gains": {who: {"gain": gains.tolist(), "sd": sds.tolist()} for who, gains, sds in gains_of(candidate, none)},
    }


def _message(none: Candidate, chosen: Candidate, best: Candidate, native: Mapping[str, Any], unit: str) -> str:
    if chosen.drive is None:
        text = f"no compensation is proposed: {_why_not(best, none, unit)}"
    else:
        text = (
            f"compensation against {chosen.kind} is proposed: residual of hidden parts of the flight "
            f"{none.hidden.rms:.3g} -> {chosen.hidden.rms:.3g} {unit} by the gyroscope"
        )
        if none.log is not None and chosen.log is not None:
            text += f", {none.log.hidden.rms:.3g} -> {chosen.log.hidden.rms:.3g} {unit} by the log's attitude"
    text += f". The motors add {_terms_text(native['candidates'][best.kind])}"
    if native["never_calibrated"]:
        listed = ", ".join(f"{v:.1f}" for v in native["offset_beside"])
        text += f". This compass was never calibrated: its offset is ({listed}) {unit}"
    return text


def _why_not(best: Candidate, none: Candidate, unit: str) -> str:
    """Text on the conditions that the best drive does not meet."""
    for who, gains, sds in gains_of(best, none):
        if (gains > SURE * sds).all():
            continue
        listed = ", ".join(f"{g:.2g} +- {s:.1g}" for g, s in zip(gains, sds, strict=True))
        by = "the gyroscope" if who == BY_GYROSCOPE else "the log's attitude"
        return (
            f"with {best.kind} the {STRETCHES} hidden parts of the flight come nearer by {listed} {unit} by {by}, and "
            f"every part must gain {SURE:.0f} times its uncertainty"
        )
    return (
        f"with {best.kind} hidden parts of the flight come from {none.hidden.rms:.3g} to {best.hidden.rms:.3g} {unit}; "
        f"{100.0 * LEAST_GAIN:.0f} % and a heading of {math.degrees(LEAST_HEADING):.1f} deg are worth a parameter"
    )


def _warnings(native: Mapping[str, Any], chosen: Candidate, none: Candidate, context: MagContext) -> tuple[str, ...]:
    warnings = []
    strength = float(np.linalg.norm(chosen.found.x[chosen.found.layout.field]))
    if native["never_calibrated"]:
        warnings.append("never calibrated: its offset is fitted beside, not written; calibrate it (mag-flight) first")
    elif float(np.linalg.norm(native["offset_beside"])) > 0.1 * strength:
        listed = ", ".join(f"{v:.1f}" for v in native["offset_beside"])
        warnings.append(f"the offset in force is wrong by ({listed}) {context.unit}: fit mag-flight too")
    if none.log is not None and none.log.rms > _LOG_ROUGH * strength:
        warnings.append(
            f"by the log's attitude the field is off by {none.log.rms / strength:.0%} of it: that attitude is unusable "
            "for a compass. Leave it out with --attitude gyro"
        )
    warnings += _disagreement(native, context.unit)
    for kind, candidate in native["candidates"].items():
        if kind != native["drive"] and native["proposed"]:
            warnings.append(f"against {kind} instead, the motors add {_terms_text(candidate)}")
    if chosen.drive is not None and chosen.drive.kind == DriveKind.MOTORS:
        warnings.append("motor by motor: what a firmware can store of it is said with the export")
    return tuple(warnings)


def _terms_text(term_of_drive: Mapping[str, Any]) -> str:
    """The motors' field with its sd, by the gyroscope and by the log's attitude."""
    text = _listed(term_of_drive["interference"], term_of_drive["interference_sd"], term_of_drive)
    if term_of_drive["by_log"] is None:
        return text
    log = _listed(term_of_drive["by_log"]["interference"], term_of_drive["by_log"]["interference_sd"], term_of_drive)
    return f"{text} by the gyroscope, {log} by the log's attitude"


def _listed(term: Sequence[Any], sd: Sequence[Any], term_of_drive: Mapping[str, Any]) -> str:
    motors, unit = term_of_drive["motors"], term_of_drive["unit"]
    if motors is None or len(motors) == 1:
        return f"{_vector(term, sd)} {unit}"
    squared = term_of_drive["squared"] or [False] * len(motors)
    each = (
        f"motor {n}{' squared' if square else ''} {_vector(t, s)}"
        for n, square, t, s in zip(motors, squared, term, sd, strict=True)
    )
    return f"{', '.join(each)} {unit}"


def _disagreement(native: Mapping[str, Any], unit: str) -> list[str]:
    """A warning where the logged attitude gives another motor term than the gyroscope."""
    trusted = native["attitude_trusted"]
    if trusted is None:
        return []
    ours = native["candidates"][trusted["drive"]]
    theirs, found, sd = trusted["interference"], ours["interference"], ours["interference_sd"]
    if float((np.abs(np.subtract(theirs, found)) / sd).max()) <= _DISAGREES:
        return []
    return [
        f"the two attitudes disagree on {trusted['drive']}: the log's finds "
        f"{_vector(theirs, trusted['interference_sd'])}, the gyroscope's {_vector(found, sd)} {ours['unit']}. "
        "The log's heading came from a compass, and its corrections pass for the motors' field"
    ]


def _vector(values: Sequence[float], sd: Sequence[float]) -> str:
    return f"({', '.join(f'{v:.3g} +- {s:.1g}' for v, s in zip(values, sd, strict=True))})"
