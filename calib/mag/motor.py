"""The field of the motors at a compass, from an ordinary flight: against current, throttle, or every output.

Each way of driving it is fitted together with everything else that a flight leaves unknown (:mod:`calib.mag.flight`:
offset, attitude, gyroscope, delay), so that none of these is taken for it. What is proposed must predict parts of the
flight that the fit did not see: the compass is hidden for a stretch of time, the gyroscope carries the attitude through
it, and the term must bring the hidden samples nearer.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Unpack

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.errors import UndeterminedError
from mavcal.calib.fit import FitResult, parameter_names
from mavcal.calib.mag.flight_fit import FlightEstimate, Knowledge, estimate
from mavcal.calib.mag.flight_input import FlightInput, given, unusable
from mavcal.calib.mag.flight_path import Turning, attitudes
from mavcal.calib.mag.flight_problem import OFFSET
from mavcal.calib.mag.motor_drives import METHOD, UNIT, Drive, DriveKind
from mavcal.calib.mag.result import MagContext, MagFacts
from mavcal.calib.recording import Channel
from mavcal.calib.stats.residuals import residual_statistics
from mavcal.calib.triad import TriadModel

Array = NDArray[np.float64]

MOVEMENT = "record from before the motors start, then hover, climb and descend, so that the current changes"
_BLOCK = 15.0  # s of a hidden stretch
_FEWEST_BLOCKS, _MOST_BLOCKS = 5, 10
_CLIPPED = 5.0  # median lengths of a residual: what lies farther counts as this far
_SURE = 2.0  # standard errors by which hidden stretches must improve
_LEAST_GAIN = 0.1  # of the residual of hidden stretches: less is not worth a parameter
_LEAST_TIME = 40.0  # s: hidden stretches of some length, and enough left to fit
_TINY = 1e-12  # of a squared residual
_SIGNIFICANT = 4.0  # standard deviations of the term
_LEAST_HEADING = math.radians(0.3)  # of the horizontal field: a smaller term is not worth a parameter
_UNKNOWN = 0.05  # of the field over the range of the drive: a term that is no better known is not determined
_DISAGREES = 4.0  # sd between what the gyroscope and what the logged attitude make of the motors
_NEVER_CALIBRATED = 0.5  # of the field: offset beside a calibration in force that has none
_SOFT_IRON_SD = 0.05
"""Prior of the matrix beside the one in force: a nuisance here."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """One way of driving the term: the fit, and what it predicts of the hidden stretches."""

    drive: Drive | None
    found: FlightEstimate
    scores: Array
    """(B,), mean of the clipped squared lengths of the residuals in each hidden stretch."""
    hidden_rms: float
    counts: Array
    """(B,), samples of each stretch."""

    @property
    def kind(self) -> str:
        """Its name; ``none`` without a drive."""
        return "none" if self.drive is None else str(self.drive.kind)

    @property
    def score(self) -> float:
        """Over all hidden samples."""
        return float(self.scores @ self.counts / self.counts.sum())

    @property
    def term(self) -> Array:
        """K (3, p), sensor's unit per unit of the drive, body axes, before the correction in force."""
        count = 0 if self.drive is None else len(self.drive.numbers)
        return np.asarray(self.found.x[self.found.layout.motor][: 3 * count].reshape(-1, 3).T)

    @property
    def covariance(self) -> Array:
        """Covariance of the term (3 p, 3 p), drive by drive."""
        size = self.term.size
        motor = self.found.layout.motor
        return np.asarray(self.found.solved.covariance[motor, motor][:size, :size])


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
        What may drive it, the simplest first.
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
    plain = given(mag, turning, in_force, None, window, context)
    reason = unusable(plain)
    if not reason and not drives:
        reason = "neither current nor throttle nor motor outputs that change are in the recording"
    lasts = plain.samples.t[-1] - plain.samples.t[0] if len(plain.samples.t) else 0.0
    if not reason and lasts < _LEAST_TIME:
        reason = f"{lasts:.0f} s of flight are too few to hide stretches of: {_LEAST_TIME:.0f} s are needed"
    if reason:
        return _refusal(context, len(mag), f"{reason}; {MOVEMENT}")
    try:
        candidates = _candidates(mag, turning, drives, in_force, window, context)
    except UndeterminedError as error:
        return _refusal(context, len(mag), f"{error}; {MOVEMENT}")
    return _verdict(candidates, plain, in_force or TriadModel(), context, len(mag))


def _refusal(context: MagContext, count: int, message: str, **quality: Any) -> FitResult:
    return context.made(METHOD, count).refused(message, (), quality=quality)


def _candidates(
    mag: Channel,
    turning: Turning,
    drives: Sequence[Drive],
    in_force: TriadModel | None,
    window: float,
    context: MagContext,
) -> list[Candidate]:
    """The fit without a term, then one a drive, all of the same samples."""
    known = np.ones(len(mag), dtype=bool)
    for drive in drives:
        known &= np.isfinite(drive.columns(mag.t)).all(axis=1)
    mag = mag.take(known)
    found = []
    every: tuple[Drive | None, ...] = (None, *drives)
    for tried in every:
        data = given(mag, turning, in_force, tried, window, context)
        reason = unusable(data)
        if reason:
            raise UndeterminedError(reason)
        fit = estimate(data.samples, data.turning, Knowledge(context.field, _SOFT_IRON_SD))
        found.append((tried, data, fit))
    return [_judged(drive, data, fit) for drive, data, fit in found]


def _judged(drive: Drive | None, data: FlightInput, fit: FlightEstimate) -> Candidate:
    """What the fit with `drive` predicts of each hidden stretch."""
    t = data.samples.t
    count = int(np.clip((t[-1] - t[0]) / _BLOCK, _FEWEST_BLOCKS, _MOST_BLOCKS))
    block = np.minimum((count * (t - t[0]) / (t[-1] - t[0])).astype(int), count - 1)
    scores, counts, lengths = [], [], []
    for number in range(count):
        rows = block == number
        if not rows.any():
            continue
        length = np.linalg.norm(fit.outside(rows), axis=1)
        lengths.append(length)
        counts.append(len(length))
    limit = _CLIPPED * float(np.median(np.concatenate(lengths)))
    scores = [float((np.minimum(length, limit) ** 2).mean()) for length in lengths]
    whole = math.sqrt(float((np.minimum(np.concatenate(lengths), limit) ** 2).mean()))
    return Candidate(drive, fit, np.array(scores), whole, np.array(counts, dtype=np.float64))


def _beats(better: Candidate, worse: Candidate, sure: float) -> bool:
    """Whether hidden stretches prefer `better` by `sure` standard errors; by logarithms, so that each counts alike."""
    gains = np.log(np.maximum(worse.scores, _TINY)) - np.log(np.maximum(better.scores, _TINY))
    return float(gains.mean()) > sure * float(gains.std(ddof=1)) / math.sqrt(len(gains))


def _chosen(candidates: Sequence[Candidate]) -> Candidate:
    """The simplest of those that are as good as the best, of those that hidden stretches want at all."""
    none = candidates[0]
    enough = (1.0 - _LEAST_GAIN) * none.hidden_rms
    wanted = [c for c in candidates[1:] if c.hidden_rms < enough and _beats(c, none, _SURE) and _matters(c)]
    if not wanted:
        return none
    best = min(wanted, key=lambda c: c.score)
    return next(c for c in wanted if c is best or not _beats(best, c, 1.0))


def _matters(candidate: Candidate) -> bool:
    """Whether the term is more than its uncertainty, and turns a heading."""
    drive = candidate.drive
    if drive is None:
        return False
    field = candidate.found.x[candidate.found.layout.field]
    horizontal = max(math.hypot(float(field[0]), float(field[1])), 1e-3 * float(np.linalg.norm(field)))
    effect = float((np.linalg.norm(candidate.term, axis=0) * drive.range).max())
    return effect > _LEAST_HEADING * horizontal and _sds(candidate) > _SIGNIFICANT


def _sds(candidate: Candidate) -> float:
    """By how many standard deviations the term differs from nothing, per number of it."""
    term = candidate.term.T.ravel()
    return math.sqrt(max(float(term @ np.linalg.solve(candidate.covariance, term)), 0.0) / len(term))


def _unknown(candidate: Candidate) -> float:
    """How uncertain the term is over the range of its drive, relative to the field."""
    if candidate.drive is None:
        return 0.0
    sd = np.sqrt(np.diag(candidate.covariance)).reshape(-1, 3)
    strength = float(np.linalg.norm(candidate.found.x[candidate.found.layout.field]))
    return float((sd.max(axis=1) * candidate.drive.range).max()) / strength


def _verdict(
    candidates: list[Candidate], data: FlightInput, in_force: TriadModel, context: MagContext, count: int
) -> FitResult:
    none, chosen = candidates[0], _chosen(candidates)
    quality = _quality(candidates, chosen, context)
    if chosen is none and min(_unknown(c) for c in candidates[1:]) > _UNKNOWN:
        return _refusal(
            context,
            count,
            f"the drive of the motors hardly changes, so their field is not told from the offset: {MOVEMENT}",
            **quality,
        )
    best = chosen if chosen is not none else min(candidates[1:], key=lambda c: c.score)
    native = _native(candidates, chosen, data, in_force, context)
    return context.made(METHOD, count).fitted(
        in_force,
        np.zeros((len(parameter_names()),) * 2),
        message=_message(none, chosen, best, native, context),
        n_used=chosen.found.used,
        residual_rms=quality["residual_rms"],
        condition_number=quality["condition_number"],
        warnings=_warnings(native, chosen, context),
        quality=quality,
        native=native,
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
        "held_out_rms": {c.kind: c.hidden_rms for c in candidates},
        "held_out_blocks": len(chosen.scores),
    }


def _native(
    candidates: Sequence[Candidate], chosen: Candidate, data: FlightInput, in_force: TriadModel, context: MagContext
) -> dict[str, Any]:
    none = candidates[0]
    turn = data.sensor_from_body.T
    gain = in_force.matrix @ turn.T
    offset = chosen.found.x[OFFSET] - data.offset_in_force
    strength = float(np.linalg.norm(chosen.found.x[chosen.found.layout.field]))
    drive = chosen.drive
    return {
        "proposed": drive is not None,
        "drive": None if drive is None else str(drive.kind),
        "held_out_rms_before": none.hidden_rms,
        "held_out_rms_after": chosen.hidden_rms,
        **(_told(chosen, gain, context) if drive is not None else {}),
        "candidates": {c.kind: _told(c, gain, context) for c in candidates[1:]},
        "attitude_trusted": _trusting(candidates, data, gain, context),
        "offset_beside": (gain @ offset).tolist(),
        "offset_beside_sd": np.sqrt(np.diag(gain @ chosen.found.solved.covariance[OFFSET, OFFSET] @ gain.T)).tolist(),
        "never_calibrated": bool(
            float(np.linalg.norm(offset)) > _NEVER_CALIBRATED * strength
            and not np.any(np.abs(data.offset_in_force) > 1e-3 * strength)
        ),
    }


def _trusting(
    candidates: Sequence[Candidate], data: FlightInput, gain: Array, context: MagContext
) -> dict[str, Any] | None:
    """What least squares find that take the log's attitude, heading included, for the truth; to compare, not to use.

    Its heading came from a compass: where it is corrected at arming or in the air, that step is taken for the motors'.
    """
    attitude, field, drive = data.turning.attitude, context.field, candidates[1].drive
    if attitude is None or field is None or drive is None:
        return None
    t = data.samples.t
    c = (data.samples.y - data.offset_in_force) @ gain.T
    misses = c - np.einsum("nji,j->ni", attitudes(attitude, t), field.north_east_down)
    slow = drive.columns(t)[:, : len(drive.numbers)]
    known = np.isfinite(slow).all(axis=1)
    rows = np.column_stack([np.ones(int(known.sum())), slow[known]])
    found, *_ = np.linalg.lstsq(rows, misses[known], rcond=None)
    after = misses[known] - rows @ found
    before = misses[known] - misses[known].mean(axis=0)
    return {
        "drive": str(drive.kind),
        "interference": (found[1] if len(found) == 2 else found[1:]).tolist(),
        "offset": found[0].tolist(),
        "rms_before": math.sqrt(float((before**2).sum(axis=1).mean())),
        "rms_after": math.sqrt(float((after**2).sum(axis=1).mean())),
    }


def _told(candidate: Candidate, gain: Array, context: MagContext) -> dict[str, Any]:
    """The term behind the correction in force: what the motors add, and what would take it away."""
    drive = candidate.drive
    if drive is None:
        return {}
    count = len(drive.numbers)
    every = np.kron(np.eye(count), gain)
    sd = np.sqrt(np.diag(every @ candidate.covariance @ every.T)).reshape(-1, 3)
    term = (gain @ candidate.term).T
    told: Mapping[str, Any] = {
        "interference": term.tolist() if count > 1 else term[0].tolist(),
        "interference_sd": sd.tolist() if count > 1 else sd[0].tolist(),
        "compensation": (-term).tolist() if count > 1 else (-term[0]).tolist(),
        "unit": f"{context.unit}/{UNIT[drive.kind]}",
        "motors": list(drive.numbers) if drive.kind == DriveKind.MOTORS else None,
        "range": drive.range.tolist() if count > 1 else float(drive.range[0]),
        "held_out_rms": candidate.hidden_rms,
    }
    return dict(told)


def _message(
    none: Candidate, chosen: Candidate, best: Candidate, native: Mapping[str, Any], context: MagContext
) -> str:
    unit = context.unit
    if chosen.drive is None:
        text = (
            f"no compensation proposed: none of {', '.join(native['candidates'])} predicts hidden parts of the flight "
            f"better by more than chance and 0.3 degrees (residual {none.hidden_rms:.3g} {unit} without, "
            f"{best.hidden_rms:.3g} with {best.kind})"
        )
    else:
        text = (
            f"compensation against {chosen.kind}: residual of hidden parts of the flight {none.hidden_rms:.3g} -> "
            f"{chosen.hidden_rms:.3g} {unit}"
        )
        if len(chosen.drive.numbers) == 1:
            text += f"; the motors add {_vector(native['interference'], native['interference_sd'])} {native['unit']}"
    if native["never_calibrated"]:
        listed = ", ".join(f"{v:.1f}" for v in native["offset_beside"])
        text += f"; this compass was never calibrated: its offset is ({listed}) {unit}"
    return text


def _warnings(native: Mapping[str, Any], chosen: Candidate, context: MagContext) -> tuple[str, ...]:
    warnings = []
    if native["never_calibrated"]:
        warnings.append("never calibrated: its offset is fitted beside, not written; calibrate it (mag-flight) first")
    elif float(np.linalg.norm(native["offset_beside"])) > 0.1 * float(
        np.linalg.norm(chosen.found.x[chosen.found.layout.field])
    ):
        listed = ", ".join(f"{v:.1f}" for v in native["offset_beside"])
        warnings.append(f"the offset in force is wrong by ({listed}) {context.unit}: fit mag-flight too")
    warnings += _disagreement(native, context.unit)
    if chosen.drive is not None and chosen.drive.kind == DriveKind.MOTORS:
        warnings.append("motor by motor: what a firmware can store of it is said with the export")
    return tuple(warnings)


def _disagreement(native: Mapping[str, Any], unit: str) -> list[str]:
    """Where the logged attitude, taken for the truth, tells of other motors than the gyroscope does."""
    trusted = native["attitude_trusted"]
    if trusted is None:
        return []
    ours = native["candidates"][trusted["drive"]]
    theirs, found, sd = trusted["interference"], ours["interference"], ours["interference_sd"]
    if float((np.abs(np.subtract(theirs, found)) / sd).max()) <= _DISAGREES:
        return []
    return [
        f"whoever takes the log's attitude for the truth finds {_vector(theirs)} {ours['unit']} "
        f"({trusted['rms_before']:.2f} -> {trusted['rms_after']:.2f} {unit}), where the gyroscope allows "
        f"{_vector(found, sd)}: the attitude's heading came from a compass, and what corrects it is taken for the "
        "motors' field; native.attitude_trusted has it in full"
    ]


def _vector(values: Sequence[float], sd: Sequence[float] | None = None) -> str:
    if sd is None:
        return f"({', '.join(f'{v:.3g}' for v in values)})"
    return f"({', '.join(f'{v:.3g} +- {s:.1g}' for v, s in zip(values, sd, strict=True))})"


def with_candidate(fit: FitResult, kind: str) -> FitResult:
    """The same fit, proposing the candidate `kind` instead: firmwares store one kind for all compasses."""
    told = fit.native["candidates"][kind]
    return dataclasses.replace(fit, native={**fit.native, **told, "drive": kind, "proposed": True})
