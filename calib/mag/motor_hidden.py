"""Held-out prediction errors with and without the motors' term, and whether the attitude is to blame.

Two attitudes rotate the Earth's field: that propagated by the gyroscope (:mod:`calib.mag.flight_fit`), and the log's
own, taken as the truth. Each has its own errors: the first drifts, the second depends on the very compasses. A term
that only one of them supports is an error of that attitude.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.mag.flight_fit import FlightEstimate, correlation_time
from mavcal.calib.mag.flight_input import FlightInput
from mavcal.calib.mag.flight_path import attitudes
from mavcal.calib.mag.motor_drives import Drive
from mavcal.calib.mag.result import MagContext
from mavcal.calib.triad import Array, TriadModel

BLOCK = 15.0
"""Length of a hidden block, s."""
STRETCHES = 3
"""Number of parts of a flight, each of consecutive blocks; the term must improve each part."""
SURE = 2.0
"""Standard deviations by which each part must improve."""
_FEWEST_BLOCKS, _MOST_BLOCKS = 5, 10
_CLIPPED = 5.0  # median lengths of a residual: what lies farther counts as this far
_RIDGE = 1e-3  # of the diagonal: keeps field and offset apart on a flight that hardly turns
_ROUGHEST = 0.15  # of the field, that a compass departs from the attitude's
_STEADY = 0.05  # of the field: a length that is no worse belongs to a sound compass
_BY_ATTITUDE = 5.0  # times the spread of the length that an attitude has to miss by
_ALL = 2.0  # of the field: no direction is wrong by more
_NORMAL = 1.4826  # sd of a normal variable over its median deviation


@dataclass(frozen=True, eq=False)
class Hidden:
    """Lengths (N,) of held-out residuals, with the number of the block of each (N,)."""

    lengths: Array
    block: NDArray[np.intp]

    @classmethod
    def of(cls, lengths: Array, block: NDArray[np.intp]) -> Hidden:
        """Residual lengths of all samples, clipped at :data:`_CLIPPED` times their median."""
        return cls(np.minimum(lengths, _CLIPPED * float(np.median(lengths))), block)

    @property
    def rms(self) -> float:
        """Over all hidden samples."""
        return math.sqrt(float((self.lengths**2).mean()))

    @property
    def scores(self) -> Array:
        """Mean square of every block (B,)."""
        return np.array([float((self.lengths[self.block == b] ** 2).mean()) for b in np.unique(self.block)])

    def gains_over(self, plain: Hidden) -> tuple[Array, Array]:
        """Mean gain over `plain` in every stretch (S,), and its standard deviation (S,)."""
        nearer = plain.lengths - self.lengths
        gains, sds = [], []
        for blocks in np.array_split(np.unique(self.block), STRETCHES):
            parts = [nearer[self.block == b] for b in blocks]
            count = sum(len(part) for part in parts)
            variances = [len(part) * float(part.var()) * correlation_time(part[:, None]) for part in parts]
            gains.append(float(np.concatenate(parts).mean()))
            sds.append(math.sqrt(sum(variances)) / count)
        return np.array(gains), np.array(sds)


@dataclass(frozen=True, eq=False)
class LogFit:
    """The log's attitude taken for the truth: ``corrected = field + offset + K drive``, by least squares."""

    hidden: Hidden
    """With the gyroscope's K."""
    term: Array
    """K by rows (p, 3), sensor's unit per unit of the drive, body axes, behind the correction in force."""
    term_sd: Array
    offset: Array
    rms: float
    """Rms residual length of all samples."""


def blocks_of(t: Array) -> NDArray[np.intp]:
    """The block of each of `t` (N,)."""
    count = int(np.clip((t[-1] - t[0]) / BLOCK, _FEWEST_BLOCKS, _MOST_BLOCKS))
    return np.asarray(np.minimum((count * (t - t[0]) / (t[-1] - t[0])).astype(np.intp), count - 1), dtype=np.intp)


def by_gyroscope(data: FlightInput, fit: FlightEstimate) -> Hidden:
    """Predictions of `fit` for each block that is hidden from it."""
    block = blocks_of(data.samples.t)
    lengths = np.zeros(len(block))
    for number in np.unique(block):
        rows = block == number
        lengths[rows] = np.linalg.norm(fit.outside(rows), axis=1)
    return Hidden.of(lengths, block)


def by_log(data: FlightInput, drive: Drive | None, term: Array, gain: Array, context: MagContext) -> LogFit | None:
    """Residuals of the `term` (p, 3) under the log's attitude, and the term fitted with that attitude.

    Both terms are behind the correction in force `gain` (3, 3). A known field is held; one that is not is fitted beside
    the offset. None: the log has no attitude.
    """
    attitude = data.turning.attitude
    if attitude is None:
        return None
    t = data.samples.t
    y = (data.samples.y - data.offset_in_force) @ gain.T
    turned = np.swapaxes(attitudes(attitude, t), 1, 2)
    slow = np.zeros((len(t), 0)) if drive is None else drive.columns(t)[:, : len(drive.numbers)]
    eyes = slow[:, None, :, None] * np.eye(3)[None, :, None, :]
    plain = np.broadcast_to(np.eye(3), (len(t), 3, 3))
    if context.field is not None:
        y = y - turned @ context.field.north_east_down
    else:
        plain = np.concatenate([plain, turned], axis=2)
    compensated = y - slow @ term
    block = blocks_of(t)
    lengths = np.zeros(len(t))
    for number in np.unique(block):
        rows = block == number
        x, _ = _least_squares(plain[~rows], compensated[~rows])
        lengths[rows] = np.linalg.norm(compensated[rows] - plain[rows] @ x, axis=1)
    design = np.concatenate([plain, eyes.reshape(len(t), 3, -1)], axis=2)
    x, inverse = _least_squares(design, y)
    left = y - design @ x
    variance = float((left**2).sum()) / max(left.size - len(x), 1) * correlation_time(left)
    first = plain.shape[2]
    sd = np.sqrt(variance * np.diag(inverse))
    return LogFit(
        hidden=Hidden.of(lengths, block),
        term=x[first:].reshape(-1, 3),
        term_sd=sd[first:].reshape(-1, 3),
        offset=x[:3],
        rms=math.sqrt(float((left**2).sum(axis=1).mean())),
    )


def _least_squares(design: Array, y: Array) -> tuple[Array, Array]:
    """Unknowns (P,) of rows (N, 3, P) and values (N, 3), and the inverse of the normal equations."""
    rows = design.reshape(-1, design.shape[2])
    normal = rows.T @ rows
    inverse = np.asarray(np.linalg.inv(normal + _RIDGE**2 * np.diag(np.diag(normal))), dtype=np.float64)
    return np.asarray(inverse @ (rows.T @ y.ravel())), inverse


def unusable_attitude(data: FlightInput, found: FlightEstimate, in_force: TriadModel, context: MagContext) -> str:
    """A sentence that blames the logged attitude instead of the compass; empty: the attitude is usable.

    The Earth's field has the same strength in any attitude, so a constant reading proves compass and correction.
    """
    strength = float(np.linalg.norm(found.x[found.layout.field]))
    steady = _steadiness(data, in_force)
    rough = float(np.median(np.linalg.norm(found.solved.residuals, axis=1))) / strength
    if data.turning.gyro is None:  # the estimate bends an attitude that nothing carries to the compass
        gain = in_force.matrix @ data.sensor_from_body
        trusting = by_log(data, None, np.zeros((0, 3)), gain, context)
        rough = rough if trusting is None else max(rough, trusting.rms / strength)
    if rough < _ROUGHEST or steady > _STEADY or rough < _BY_ATTITUDE * steady:
        return ""
    others = "--attitude log" if data.turning.attitude is None else "--attitude gyro"
    return (
        f"the attitude is unusable: the compass reads a field steady to {100.0 * steady:.2g} %, but the attitude would "
        f"turn it by {100.0 * min(rough, _ALL):.0f} % of it. Check the gyroscope's offset and the axes, or try the "
        f"other attitude ({others})"
    )


def _steadiness(data: FlightInput, in_force: TriadModel) -> float:
    """Spread of the length that the compass reads through the correction in force, relative; robust."""
    lengths = np.linalg.norm(in_force.apply(data.mag.values), axis=1)
    middle = float(np.median(lengths))
    return _NORMAL * float(np.median(np.abs(lengths - middle))) / middle if middle > 0.0 else math.inf
