"""Candidates for the motors' term: fits without it and by each drive, and which of them hidden samples prefer."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mavcal.calib.errors import UndeterminedError
from mavcal.calib.mag.flight_fit import FlightEstimate, Knowledge, estimate
from mavcal.calib.mag.flight_input import FlightInput, prepared, unusable
from mavcal.calib.mag.flight_path import Turning
from mavcal.calib.mag.motor_drives import Drive
from mavcal.calib.mag.motor_hidden import SURE, Hidden, LogFit, by_gyroscope, by_log
from mavcal.calib.mag.result import MagContext
from mavcal.calib.recording import Array, Channel
from mavcal.calib.triad import TriadModel

LEAST_GAIN = 0.1  # of the residual of hidden samples: less is not worth a parameter
_TINY = 1e-12  # of a squared residual
_SIGNIFICANT = 4.0  # standard deviations of the term
LEAST_HEADING = math.radians(0.3)  # of the horizontal field: a smaller term is not worth a parameter
BY_GYROSCOPE, BY_LOG = "gyroscope", "log"
"""Attitudes by which hidden samples are predicted: the gyroscope's, and the log's own."""
_SOFT_IRON_SD = 0.05
"""Prior sd of the matrix about the one in force, a nuisance here."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """A fit of the motor term against one drive signal, with its prediction errors on held-out stretches."""

    drive: Drive | None
    found: FlightEstimate
    hidden: Hidden
    """With the attitude propagated by the gyroscope."""
    log: LogFit | None = None
    """With the log's attitude taken as the truth; None: there is none."""

    @property
    def kind(self) -> str:
        """Its name; ``none`` without a drive."""
        return "none" if self.drive is None else str(self.drive.kind)

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


def candidates_of(
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
        data = prepared(mag, turning, in_force, tried, window, context)
        reason = unusable(data)
        if reason:
            raise UndeterminedError(reason)
        fit = estimate(data.samples, data.turning, Knowledge(context.field, _SOFT_IRON_SD))
        found.append((tried, data, fit))
    return [_judged(drive, data, fit, gain_of(data, in_force or TriadModel()), context) for drive, data, fit in found]


def _judged(drive: Drive | None, data: FlightInput, fit: FlightEstimate, gain: Array, context: MagContext) -> Candidate:
    """The candidate with its predictions of hidden samples by either attitude."""
    alone = Candidate(drive, fit, by_gyroscope(data, fit))
    return dataclasses.replace(alone, log=by_log(data, drive, (gain @ alone.term).T, gain, context))


def gain_of(data: FlightInput, in_force: TriadModel) -> Array:
    """Matrix (3, 3) of the correction in force in body axes, which maps a field at the sensor."""
    return np.asarray(in_force.matrix @ data.sensor_from_body)


def _beats(better: Candidate, worse: Candidate, sure: float) -> bool:
    """Whether hidden blocks prefer `better` by `sure` standard errors; in logarithms, so that all weigh equally."""
    gains = np.log(np.maximum(worse.hidden.scores, _TINY)) - np.log(np.maximum(better.hidden.scores, _TINY))
    return float(gains.mean()) > sure * float(gains.std(ddof=1)) / math.sqrt(len(gains))


def chosen_of(candidates: Sequence[Candidate]) -> Candidate:
    """The simplest candidate that is as good as the best, among those that hidden samples support."""
    none = candidates[0]
    wanted = [c for c in candidates[1:] if improves_prediction(c, none)]
    if not wanted:
        return none
    best = min(wanted, key=lambda c: c.hidden.rms)
    return next(c for c in wanted if c is best or not _beats(best, c, 1.0))


def improves_prediction(candidate: Candidate, none: Candidate) -> bool:
    """Whether the term improves held-out prediction over all blocks, and in every part by either attitude."""
    enough = candidate.hidden.rms < (1.0 - LEAST_GAIN) * none.hidden.rms
    return enough and _beats(candidate, none, SURE) and _matters(candidate) and not _unhelped(candidate, none)


def _unhelped(candidate: Candidate, none: Candidate) -> list[str]:
    """The attitudes with which the term does not improve every part of the flight significantly."""
    return [who for who, gains, sds in gains_of(candidate, none) if not (gains > SURE * sds).all()]


def gains_of(candidate: Candidate, none: Candidate) -> list[tuple[str, Array, Array]]:
    """Gains of each attitude: decrease of the error of every part (S,), and its sd (S,)."""
    found = [(BY_GYROSCOPE, *candidate.hidden.gains_over(none.hidden))]
    if candidate.log is not None and none.log is not None:
        found.append((BY_LOG, *candidate.log.hidden.gains_over(none.log.hidden)))
    return found


def _matters(candidate: Candidate) -> bool:
    """Whether the term is significant and affects the heading."""
    drive = candidate.drive
    if drive is None:
        return False
    field = candidate.found.x[candidate.found.layout.field]
    horizontal = max(math.hypot(float(field[0]), float(field[1])), 1e-3 * float(np.linalg.norm(field)))
    effect = float((np.linalg.norm(candidate.term, axis=0) * drive.range).max())
    return effect > LEAST_HEADING * horizontal and _sds(candidate) > _SIGNIFICANT


def _sds(candidate: Candidate) -> float:
    """Standard deviations by which each number of the term differs from zero."""
    term = candidate.term.T.ravel()
    return math.sqrt(max(float(term @ np.linalg.solve(candidate.covariance, term)), 0.0) / len(term))


def unknown_share(candidate: Candidate) -> float:
    """Uncertainty of the term over the range of its drive, relative to the field."""
    if candidate.drive is None:
        return 0.0
    sd = np.sqrt(np.diag(candidate.covariance)).reshape(-1, 3)
    strength = float(np.linalg.norm(candidate.found.x[candidate.found.layout.field]))
    return float((sd.max(axis=1) * candidate.drive.range).max()) / strength
