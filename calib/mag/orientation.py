"""Mounting of a magnetometer: which rotation makes its field agree with the accelerometer.

For any heading, the dip fixes the angle between field and vertical. With g the unit vector down and m the unit field,
both in the body, ``g . R m = sin(dip)`` holds only for the true rotation R, if the vehicle was tilted to all sides.
Right-angle mountings are tried by name. Others are fitted by their angles, and distinguished from mirrored axes, which
are not a mounting (:mod:`calib.mag.free_rotation`).
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mavcal.calib import STANDARD_GRAVITY
from mavcal.calib.errors import InvalidInputError, UndeterminedError
from mavcal.calib.mag.coverage import sections
from mavcal.calib.mag.free_rotation import (
    Array,
    Euler,
    angle_between,
    best_mirrors,
    best_rotations,
    euler_angles,
    mirror_words,
    turn,
)

QUIET = 0.1
"""Departure of |accel| from gravity, relative, up to which it shows the vertical."""

FEWEST = 20
"""Least number of samples near 1 g."""

MARGIN = 4.0
"""Mean square by which the second best rotation must be worse (ArduPilot asks for 2)."""

ASKEW = math.radians(5.0)
"""Angle to the nearest right-angle mounting within which that one is assumed: brackets are no more accurate."""

_LIKELIHOOD = 10.0  # logarithm of the ratio of likelihoods that is asked for besides: 1 to 22 000
_EXPLAINS = 0.25  # rms of g . R m - sin(dip), a sine: beyond about 15 degrees nothing is explained
_KEPT = 0.9  # of the samples, the best: jolts and magnets passed by are in the rest
_LEAST = 0.01  # rms below which rotations are not told apart: half a degree
_STILL = 0.02  # rad/s
_JOLT = 0.5  # departure of a sine that is no misalignment any more
_ROUNDS = 3
_OPEN_CONDITION = 1e6
_ACCEL_SD = math.radians(0.3)  # of the vertical: what the accelerometer's offsets (.05 m/s2) and cross terms leave
_CERTAIN = 10.0  # an angle that is no right one is believed if it is known to this part of itself
_OPEN = math.radians(5.0)  # sd of a misalignment beyond which it counts as not determined


class MountingVerdict(StrEnum):
    """Verdict on the mounting."""

    AS_STATED = "as_stated"  # no rotation is needed
    ROTATED = "rotated"  # one other rotation explains the data, the stated one does not
    BY_ANGLES = "by_angles"  # a rotation by other angles than right ones explains the data
    MIRRORED = "mirrored"  # no rotation explains the data, a mirror image does: driver or sensor are at fault
    AMBIGUOUS = "ambiguous"  # several rotations explain the data: tilt more
    UNEXPLAINED = "unexplained"  # no rotation does


@dataclass(frozen=True, eq=False)
class Mounting:
    """A rotation ``body_from_sensor`` with its name (``roll_180_yaw_90``; ``none``) and angles in degrees.

    Rotations are about z (yaw), then y (pitch), then x (roll): ``R = Rz(yaw) Ry(pitch) Rx(roll)``.
    """

    name: str
    roll: int
    pitch: int
    yaw: int
    matrix: Array

    @property
    def words(self) -> str:
        """Its name in a sentence."""
        return self.name.replace("_", " ")


@dataclass(frozen=True, eq=False)
class FittedRotation:
    """The best-fitting rotation by any angles, from the assumed body frame to the body."""

    matrix: Array  # (3, 3)
    covariance: Array
    """(3, 3), rad^2, of small turns of the body about x, y, z."""

    @property
    def euler(self) -> Euler:
        """Its angles with their standard deviations."""
        return euler_angles(self.matrix, self.covariance)

    @property
    def sd(self) -> float:
        """Standard deviation of the whole angle, rad."""
        return math.sqrt(float(np.trace(self.covariance)))


@dataclass(frozen=True, eq=False)
class OrientationResult:
    """The verdict with its evidence."""

    verdict: MountingVerdict
    best: Mounting
    message: str
    rms: dict[str, float]
    """Rms of ``g . R m - sin(dip)`` by name of the rotation, best first."""
    log_likelihood_margin: float
    """Logarithm of the ratio of likelihoods of the best and the second best."""
    n_used: int
    misalignment_deg: tuple[float, float, float] | None
    """Residual small rotation about body x, y, z after `best`; None: the tilt does not determine it."""
    misalignment_sd_deg: tuple[float, float, float] | None
    lag: float | None
    """Delay of the magnetometer against the accelerometer, s; None: no gyro, or no rotation."""
    fitted: FittedRotation | None
    """None: the tilt does not determine it."""
    sine: float
    """Sine of the dip, as given or as it is with the best rotation."""


def rotation_matrix(roll: float, pitch: float, yaw: float) -> Array:
    """``Rz(yaw) Ry(pitch) Rx(roll)`` of angles in degrees.

    >>> rotation_matrix(0, 0, 90) @ [1, 0, 0]
    array([0., 1., 0.])
    """
    (cr, sr), (cp, sp), (cy, sy) = ((math.cos(math.radians(a)), math.sin(math.radians(a))) for a in (roll, pitch, yaw))
    matrix = np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )
    return np.asarray(np.where(np.abs(matrix) < 1e-15, 0.0, matrix))


def _right_angles() -> tuple[Mounting, ...]:
    found: dict[bytes, Mounting] = {}
    turns = (0, 90, 180, 270)
    # Simplest name first: a rotation about one axis before one about two, yaw before roll before pitch.
    for roll, pitch, yaw in sorted(
        itertools.product(turns, turns, turns), key=lambda a: (sum(x != 0 for x in a), a[1] != 0, a[0] != 0, a)
    ):
        matrix = rotation_matrix(roll, pitch, yaw)
        parts = [f"{n}_{a}" for n, a in (("roll", roll), ("pitch", pitch), ("yaw", yaw)) if a]
        found.setdefault(
            np.rint(matrix).astype(np.int8).tobytes(),
            Mounting("_".join(parts) or "none", roll, pitch, yaw, np.rint(matrix)),
        )
    return tuple(found.values())


RIGHT_ANGLES = _right_angles()
"""The 24 rotations by right angles; the first is none."""


def interpolated(t: ArrayLike, other_t: ArrayLike, other: ArrayLike) -> Array:
    """Values (N, 3) of `other` (M, 3) at the times `t` (N,), linear between its own times `other_t` (M,)."""
    times, other_times = np.asarray(t, dtype=np.float64), np.asarray(other_t, dtype=np.float64)
    return np.stack([np.interp(times, other_times, c) for c in np.asarray(other, dtype=np.float64).T], axis=1)


def find_orientation(
    mag: ArrayLike,
    accel: ArrayLike,
    *,
    gyro: ArrayLike | None = None,
    inclination: float | None = None,
    stated: ArrayLike | None = None,
) -> OrientationResult:
    """Find the missing rotation between magnetometer and body.

    Parameters
    ----------
    mag : shape (N, 3)
        Corrected field in the assumed body frame, any unit.
    accel : shape (N, 3)
        Corrected specific force in the body frame at the same times, m/s2; samples that are not within 10 % of gravity
        are left out.
    gyro : shape (N, 3) or None
        Rates at the same times, rad/s: with them a time lag between magnetometer and accelerometer is not taken for a
        misalignment (50 ms at 60 deg/s are 3 degrees).
    inclination
        Dip of the field, rad. None: it is estimated for every rotation, which takes more tilt to tell them apart.
    stated : shape (3, 3) or None
        The stated mounting, body from sensor: with it a mirrored axis is named as the sensor has it.

    Raises
    ------
    InvalidInputError
        If shapes do not match or numbers are not finite.
    UndeterminedError
        If fewer than 20 samples are near 1 g.
    """
    field, down, used = _unit_vectors(mag, accel)
    turning = None if gyro is None else _rates(gyro, used)
    if turning is not None and float(np.sqrt(np.mean(turning**2))) < _STILL:
        turning = None  # at rest a lag has no effect and cannot be told
    sine = None if inclination is None else math.sin(inclination)
    squares = np.array([_mean_square(down, field @ c.matrix.T, sine) for c in RIGHT_ANGLES])
    order = np.argsort(squares, kind="stable")
    best, second = RIGHT_ANGLES[order[0]], squares[order[1]]
    least = max(squares[order[0]], _LEAST**2)
    effective = len({*zip(sections(field).tolist(), sections(down).tolist(), strict=True)})
    margin = 0.5 * effective * (second / least - 1.0)
    rms = {RIGHT_ANGLES[i].name: math.sqrt(squares[i]) for i in order}
    samples = _Samples(down, field, turning, sine, effective)
    verdict, message = _verdict(order, squares, margin)
    small = _misalignment(samples, best.matrix)
    fitted, freely, reason = _by_any_angles(samples, squares, stated)
    if freely is not None:
        verdict, message = freely, reason
    matrix = fitted.matrix if fitted is not None and verdict == MountingVerdict.BY_ANGLES else best.matrix
    stated_sine = sine if sine is not None else float(np.median(np.einsum("ni,ij,nj->n", down, matrix, field)))
    if verdict == MountingVerdict.ROTATED and sine is None:
        message += "; the place is not known, and a compass with a mirrored axis would look the same"
    return OrientationResult(
        verdict,
        best,
        message,
        rms,
        margin,
        len(field),
        None if small is None else _degrees(small.turn),
        None if small is None else _degrees(np.sqrt(np.diag(small.covariance))),
        None if small is None else small.lag,
        fitted,
        stated_sine,
    )


@dataclass(frozen=True, eq=False)
class _Samples:
    down: Array
    field: Array
    turning: Array | None
    sine: float | None
    effective: int

    def mean_square(self, matrix: Array) -> float:
        return _mean_square(self.down, self.field @ matrix.T, self.sine)

    def margin(self, better: float, worse: float) -> float:
        """Logarithm of the ratio of likelihoods of two mean squares."""
        return 0.5 * self.effective * (worse / max(better, _LEAST**2) - 1.0)

    def clearly(self, better: float, worse: float) -> bool:
        return worse >= MARGIN * max(better, _LEAST**2) and self.margin(better, worse) >= _LIKELIHOOD

    def kept(self, matrix: Array) -> tuple[Array, Array]:
        """The nine tenths of the samples that `matrix` explains best."""
        vertical = np.einsum("ni,ij,nj->n", self.down, matrix, self.field)
        error = np.abs(vertical - (float(np.median(vertical)) if self.sine is None else self.sine))
        best = error <= np.quantile(error, _KEPT)
        return self.down[best], self.field[best]


def _by_any_angles(
    samples: _Samples, squares: Array, stated: ArrayLike | None
) -> tuple[FittedRotation | None, MountingVerdict | None, str]:
    """The rotation by any angles, and what it says beyond the right-angle ones (None: nothing)."""
    starts = np.array([c.matrix for c in RIGHT_ANGLES])
    rotations = best_rotations(samples.down, samples.field, samples.sine, starts)
    rotations = best_rotations(*samples.kept(rotations[0]), samples.sine, np.array(rotations))
    square = samples.mean_square(rotations[0])
    mirrors = best_mirrors(samples.down, samples.field, samples.sine, starts)
    if mirrors and (mirrored := _mirrored(samples, mirrors[0], square, stated)):
        return None, MountingVerdict.MIRRORED, mirrored
    if math.sqrt(square) > _EXPLAINS:
        return (
            None,
            MountingVerdict.UNEXPLAINED,
            (
                f"no mounting explains the compass: the best rotation leaves {math.sqrt(square):.2f} of the field "
                "against the vertical; calibrate the accelerometer first, and look for steel and currents"
            ),
        )
    small = _misalignment(samples, rotations[0])
    if small is None:
        return None, None, ""
    fitted = FittedRotation(turn(small.turn) @ rotations[0], small.covariance + _ACCEL_SD**2 * np.eye(3))
    askew, nearest = min((angle_between(c.matrix, fitted.matrix), k) for k, c in enumerate(RIGHT_ANGLES))
    if askew <= max(ASKEW, _CERTAIN * fitted.sd):
        return fitted, None, ""
    if any(not samples.clearly(square, samples.mean_square(other)) for other in rotations[1:]):
        return (
            fitted,
            MountingVerdict.AMBIGUOUS,
            ("several mountings explain the compass alike: tilt the vehicle to more sides"),
        )
    if not samples.clearly(square, float(squares.min())):
        return fitted, None, ""
    return (
        fitted,
        MountingVerdict.BY_ANGLES,
        (
            f"mounted turned by {fitted.euler}, {math.degrees(askew):.0f} deg from the nearest right-angle mounting "
            f"({RIGHT_ANGLES[nearest].name})"
        ),
    )


def _mirrored(samples: _Samples, mirror: Array, square: float, stated: ArrayLike | None) -> str:
    """Text if a reflection explains the field and no rotation (mean square `square`) does; else empty."""
    reflected = samples.mean_square(mirror)
    if math.sqrt(reflected) > _EXPLAINS or not samples.clearly(reflected, square):
        return ""
    body = np.eye(3) if stated is None else np.asarray(stated, dtype=np.float64)
    return (
        f"{mirror_words(body.T @ mirror @ body)}, which no mounting does (the best rotation leaves "
        f"{math.sqrt(square):.2f} of the field against the vertical, the mirror image {math.sqrt(reflected):.3f}): the "
        "driver or the sensor is at fault. Power-cycle the vehicle and calibrate again; replace the compass if it stays"
    )


def _degrees(angles: Array) -> tuple[float, float, float]:
    x, y, z = np.degrees(angles).tolist()
    return x, y, z


def _unit_vectors(mag: ArrayLike, accel: ArrayLike) -> tuple[Array, Array, NDArray[np.bool_]]:
    field, force = np.asarray(mag, dtype=np.float64), np.asarray(accel, dtype=np.float64)
    if field.ndim != 2 or field.shape[1:] != (3,) or field.shape != force.shape:
        raise InvalidInputError(f"magnetometer {field.shape} and accelerometer {force.shape} must both be (N, 3)")
    if not (np.isfinite(field).all() and np.isfinite(force).all()):
        raise InvalidInputError("magnetometer and accelerometer must be finite: drop the other rows first")
    length, strength = np.linalg.norm(force, axis=1), np.linalg.norm(field, axis=1)
    used = (np.abs(length / STANDARD_GRAVITY - 1.0) <= QUIET) & (strength > 0.0)
    if np.count_nonzero(used) < FEWEST:
        raise UndeterminedError(
            f"{np.count_nonzero(used)} of {len(field)} samples show the vertical: {FEWEST} are needed",
            remedy="turn the vehicle more slowly, so that the accelerometer reads gravity alone",
        )
    return field[used] / strength[used, None], -force[used] / length[used, None], used


def _rates(gyro: ArrayLike, used: NDArray[np.bool_]) -> Array:
    rates = np.asarray(gyro, dtype=np.float64)
    if rates.shape != (len(used), 3) or not np.isfinite(rates).all():
        raise InvalidInputError(f"the gyro {rates.shape} must be finite and match the {len(used)} other samples")
    return rates[used]


def _mean_square(down: Array, field: Array, sine: float | None) -> float:
    """Mean square of ``g . m - sin(dip)`` over the best nine tenths of the samples."""
    vertical = np.einsum("ij,ij->i", down, field)
    error = vertical - (float(np.median(vertical)) if sine is None else sine)
    squares = np.sort(error**2)
    return float(squares[: max(1, int(_KEPT * len(squares)))].mean())


def _verdict(order: NDArray[np.intp], squares: Array, margin: float) -> tuple[MountingVerdict, str]:
    first, second = RIGHT_ANGLES[order[0]], RIGHT_ANGLES[order[1]]
    rms = math.sqrt(squares[order[0]])
    if rms > _EXPLAINS:
        return MountingVerdict.UNEXPLAINED, (
            f"no right-angle mounting explains the compass: the best ({first.words}) leaves {rms:.2f} of the field "
            "against the vertical; check the accelerometer's calibration and the mounting angle"
        )
    if squares[order[1]] < MARGIN * max(squares[order[0]], _LEAST**2) or margin < _LIKELIHOOD:
        return MountingVerdict.AMBIGUOUS, (
            f"the mountings {first.words} and {second.words} explain the compass alike: tilt the vehicle to more sides"
        )
    if order[0] == 0:
        return (
            MountingVerdict.AS_STATED,
            f"the stated mounting explains the compass, the next best ({second.words}) does not",
        )
    stated = math.sqrt(squares[0])
    return MountingVerdict.ROTATED, (
        f"mounting {first.words} explains the compass (rms {rms:.3f}), the stated one does not (rms {stated:.2f})"
    )


@dataclass(frozen=True, eq=False)
class _Small:
    """A small rotation (rotation vector, rad) with its covariance, and the time lag, s."""

    turn: Array
    covariance: Array
    lag: float | None


def _misalignment(samples: _Samples, matrix: Array) -> _Small | None:
    """Small rotation phi and lag tau left after `matrix`: ``g . (m + phi x m - tau w x m) = sin(dip)``, Gauss-Newton.

    A field in the body turns by ``-w x m``; m is tau late. The sine is a further unknown where the dip is not given.
    None: the samples do not determine it.
    """
    down, field, turning, sine = samples.down, samples.field @ matrix.T, samples.turning, samples.sine
    found = np.zeros(4)
    turned = field
    for _ in range(_ROUNDS):
        rows, right = _linear_system(down, turned, turning, sine)
        normal = rows.T @ rows / len(rows)
        if np.linalg.cond(normal) > _OPEN_CONDITION:
            return None
        solution = np.linalg.solve(normal, rows.T @ right / len(rows))
        found[:3] += solution[:3]
        if turning is not None:
            found[3] += solution[3]
        angles = found[:3] if turning is None else found[:3] - found[3] * turning
        once = np.cross(angles, field)
        turned = field + once + 0.5 * np.cross(angles, once)
    effective = samples.effective
    variance = float(np.mean((right - rows @ solution) ** 2)) * effective / max(effective - len(solution), 1)
    covariance = np.linalg.inv(normal)[:3, :3] * variance / effective
    if np.sqrt(np.diag(covariance)).max() > _OPEN:
        return None
    return _Small(found[:3], covariance, None if turning is None else float(found[3]))


def _linear_system(down: Array, field: Array, turning: Array | None, sine: float | None) -> tuple[Array, Array]:
    columns = [np.cross(field, down)]
    if turning is not None:
        columns.append(-np.einsum("ij,ij->i", down, np.cross(turning, field))[:, None])
    if sine is None:
        columns.append(-np.ones((len(field), 1)))
    right = (0.0 if sine is None else sine) - np.einsum("ij,ij->i", down, field)
    close = np.abs(right - np.median(right)) <= _JOLT
    return np.hstack(columns)[close], right[close]
