"""The joint multi-position calibration of an inertial unit: from two channels to two fits (METHODS 3.3)."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mavcal.calib import STANDARD_GRAVITY
from mavcal.calib.errors import require_positive
from mavcal.calib.fit import AXES, FitResult
from mavcal.calib.geometry import sphere_of
from mavcal.calib.imu.integrate import Moves
from mavcal.calib.imu.poses import LEAST_POSES, Poses, find_poses, measure
from mavcal.calib.imu.problem import ImuProblem, ImuSolution, linearise, reduced, solve, turns_of
from mavcal.calib.imu.result import Form, RecordingFacts, imu_refused, imu_results
from mavcal.calib.imu.start import closure, rate_factor, rough_gyro, with_turn_noise
from mavcal.calib.imu.unknowns import DIAGONAL, UNKNOWNS, Coordinates, ImuPrior
from mavcal.calib.imu.weighting import Weighed, weigh
from mavcal.calib.recording import Array, Channel
from mavcal.calib.stats.norm_fit import NEUTRAL, UNDETERMINED, NormProblem
from mavcal.calib.stats.norm_fit import solve as solve_norm
from mavcal.calib.stats.quantisation import with_apparent_quantum
from mavcal.calib.stats.still_limits import HELD, HOLD_S, MANY_MORE, SHORTER, too_short
from mavcal.calib.stats.windows import finite_rows, without_spikes

_LEAST_SAMPLES = 200
_LEAST_IN_POSE = 8
_LARGEST = 1e12  # of any unit
_GAP = 5.0  # usual steps; a movement with a longer hole in it is not integrated
_CLIPPED = 3  # samples at the very end of an axis' range that are one too many
_LEARNT = 1.0 / 3.0  # of the usual size of a misalignment: one that is not known so well stays open
_NO_SWAY_DEG = 10.0  # between two poses, which hands that sway do not reach
_SCALE_SD = 0.1  # of a gyroscope's nominal scale, before the data


def fit_imu(
    accel: Channel,
    gyro: Channel,
    *,
    gravity: float = STANDARD_GRAVITY,
    cross_sd: float = 0.01,
    form: Form = "symmetric",
    spans: Array | None = None,
    min_still: float = HOLD_S,
    temperature: float | None = None,
    relative: bool = False,
) -> tuple[FitResult, FitResult]:
    """Offset and matrix of an accelerometer and a gyroscope from still poses and the movements between them.

    Both are fitted as one maximum-likelihood problem. The means of the poses lie on the accelerometer's ellipsoid. The
    gyroscope carries each direction of gravity to the next one; its mean at rest is its offset. Both sensors come out
    in one frame, that of the accelerometer; no pose shows how that is mounted in the vehicle.

    Parameters
    ----------
    accel, gyro : Channel
        Samples of the same time, both in SI units or both in counts; counts yield their scale as well.
    gravity
        Length of the corrected accelerometer, m/s2.
    cross_sd
        Usual size of misalignments, one sd in rad. A misalignment that the data do not know three times better is
        undetermined and held at zero. Its usual size is then part of the others' uncertainty.
    form
        Canonical form of the accelerometer's matrix; ``upper`` keeps the sensor's x axis (imu_tk).
    spans : shape (P, 2) or None
        Spans known to be still, s; None: they are found.
    min_still
        Least time that a pose was held, s, where the spans are found.
    temperature
        Mean of the sensor, degC; None: not known.
    relative
        The calibration in force was not known.

    Returns
    -------
    FitResult, FitResult
        Accelerometer and gyroscope, with the marginals of one joint covariance. Earth's rate is inside the gyroscope's
        offset. Refused where the poses do not determine them.

    Raises
    ------
    InvalidInputError
        If time goes back, or gravity or `cross_sd` is not positive.
    """
    _check(accel, gyro, gravity, cross_sd)
    facts = RecordingFacts(accel, gyro, gravity, form, temperature, relative)
    accel, gyro = (c.take(finite_rows(c.values)) for c in (accel, gyro))
    accel, gyro = (with_apparent_quantum(c.take(without_spikes(c.values))) for c in (accel, gyro))
    reason = _unusable(accel, gyro)
    if reason:
        return imu_refused(facts, reason)
    known = gravity if accel.unit == "m/s2" else None
    found = spans is None
    if spans is None:
        spans = find_poses(accel, gyro, known, min_still)
    spans = _filled(accel, gyro, np.asarray(spans, dtype=np.float64).reshape(-1, 2))
    if len(spans) < LEAST_POSES:
        return imu_refused(
            facts,
            f"{len(spans)} still poses in {accel.t[-1] - accel.t[0]:.0f} s: hold nine or more different ones"
            + (_held_for_less(accel, gyro, known, len(spans), min_still) if found else ""),
        )
    poses = measure(accel, gyro, spans)
    reason = _not_gravity(poses, known)
    if reason:
        return imu_refused(facts, reason)
    begun = _begin(accel, gyro, poses, known, cross_sd)
    if isinstance(begun, str):
        return imu_refused(facts, begun)
    return _finished(facts, poses, begun, cross_sd)


def _held_for_less(accel: Channel, gyro: Channel, gravity: float | None, count: int, needed: float) -> str:
    """End of a refusal, where more than the `count` poses found were held for less than `needed` s; or empty."""
    for part in SHORTER:
        spans = find_poses(accel, gyro, gravity, part * needed)
        if len(spans) >= MANY_MORE * (count + 1):
            held = np.diff(spans, axis=1)[:, 0] + part * needed * HELD.window / HOLD_S
            return too_short(held.tolist(), needed, part * needed)
    return ""


@dataclass(frozen=True, eq=False)
class _Begun:
    """The problem with its start, in radii and in rates: `gyro_scale` times the gyroscope's unit."""

    problem: ImuProblem
    x: Array
    directions: Array
    prior: ImuPrior
    radius: float
    gyro_scale: float
    left_out: int
    misread: float | None
    """Factor on the gyroscope's numbers where their unit or range is wrong; None: it is right."""


def _begin(accel: Channel, gyro: Channel, poses: Poses, gravity: float | None, cross_sd: float) -> _Begun | str:
    """The problem and where its solution starts, or why there is none."""
    centre, radius = (np.zeros(3), gravity) if gravity is not None else sphere_of(poses.means)
    prior = np.zeros(9)
    prior[6:] = 1.0 / cross_sd**2
    covariances = poses.covariances / radius**2 + (1e-9) ** 2 * np.eye(3)
    alone = solve_norm(NormProblem(poses.means / radius, covariances, radius, centre / radius, 1.0, prior), weak=True)
    if alone is None:
        return "the poses do not lie on one sphere: check the unit, and that every pose was still"
    precision = 1.0 / poses.rate_variances
    rest = (precision * poses.rates).sum(axis=0) / precision.sum(axis=0)
    between = np.column_stack([poses.spans[:-1, 1], poses.spans[1:, 0]])
    usable = _integrable(gyro, between)
    rough = rough_gyro(accel, gyro, between[usable], rest, alone.parameters[:3] * radius)
    in_si = gyro.unit == "rad/s"
    if rough is None and not in_si:
        return f"the movements do not tell the scale of a gyroscope in {gyro.unit}: turn it about every axis"

    def stated(scale: float) -> ImuProblem:
        moves = Moves.of(gyro.t, gyro.values * scale, between[usable], rest * scale)
        return ImuProblem(
            means=poses.means / radius,
            covariances=covariances,
            moves=moves,
            before=np.flatnonzero(usable),
            wander=poses.wander,
            density=poses.gyro_noise * scale**2 * moves.mean_step,
            turn_covariances=np.zeros((len(moves), 3, 3)),
            rest=rest * scale,
            rest_covariance=np.diag(scale**2 / precision.sum(axis=0)),
        )

    def start(matrix: Array, scale: float) -> Array:
        return np.concatenate([alone.parameters, matrix.ravel(), rest * scale])

    scale = 1.0 if in_si or rough is None else float(np.cbrt(abs(np.linalg.det(rough))))
    problem, misread = stated(scale), None
    if in_si and rough is not None and len(problem.moves):
        misread = rate_factor(problem, start(np.eye(3), scale), rough)
    if misread is not None:
        scale, problem = misread, stated(misread)
    starts = ([np.eye(3)] if in_si else []) + ([rough / scale] if rough is not None else [])
    xs = [start(G, scale) for G in starts]
    x = min(xs, key=lambda x: closure(problem, x)) if len(problem.moves) else xs[0]
    problem = with_turn_noise(problem, x)
    left_out = len(between) - int(usable.sum())
    return _Begun(problem, x, alone.directions, _prior(centre / radius, cross_sd), radius, scale, left_out, misread)


def _finished(facts: RecordingFacts, poses: Poses, begun: _Begun, cross_sd: float) -> tuple[FitResult, FitResult]:
    """Both fits: solved and weighted, with undetermined unknowns held and named."""
    begin = linearise(begun.problem, begun.x, begun.directions, turns_of(begun.problem, begun.x))
    open_at_start = Coordinates(_unknown(reduced(begin)[0], begun.prior, cross_sd, student_factor=1.0))
    first = solve(begun.problem, begun.x, begun.directions, prior=begun.prior, coordinates=open_at_start)
    if first is None:
        return imu_refused(
            facts, "the movements do not lead from one pose to the next by any model of the gyroscope: check the units"
        )
    weighed = weigh(with_turn_noise(begun.problem, first.x), first, begun.prior, open_at_start)
    miss = float(np.degrees(np.sqrt(weighed.problem.extra[1])))
    if miss > _NO_SWAY_DEG:
        return imu_refused(
            facts,
            f"the movements miss the next pose by {miss:.0f} deg each, which is no sway: check the gyroscope's unit, "
            "range, and the order and signs of its axes, and that every turn is in the recording",
        )
    unknown = _unknown(weighed.solution.information, begun.prior, cross_sd, weighed.student_factor)
    neutral = weighed.solution.x.copy()
    neutral[unknown] = begun.prior.centre[unknown]
    solution = solve(weighed.problem, neutral, weighed.solution.directions, coordinates=Coordinates(unknown))
    if solution is None:
        return imu_refused(facts, "the joint fit did not converge: hold more poses, and each of them longer")
    covariance = _covariance(weighed, solution, unknown, begun.prior)
    return imu_results(
        facts,
        poses,
        dataclasses.replace(weighed, solution=solution),
        covariance,
        unknown,
        radius=begun.radius,
        gyro_scale=begun.gyro_scale,
        moves_left_out=begun.left_out + weighed.moves_out,
        misread=begun.misread,
    )


def _prior(centre: Array, cross_sd: float) -> ImuPrior:
    """What is known of any inertial unit: offsets within a radius, scales within their size, small misalignments."""
    sd = np.concatenate([np.ones(6), np.full(12, cross_sd), np.full(3, np.inf)])
    sd[DIAGONAL] = _SCALE_SD
    return ImuPrior(
        np.concatenate([centre, NEUTRAL[3:], np.eye(3).ravel(), np.zeros(3)]),
        1.0 / sd**2,
    )


def _unknown(information: Array, prior: ImuPrior, cross_sd: float, student_factor: float) -> NDArray[np.intp]:
    """Indices of the unknowns that the data leave undetermined; `student_factor` multiplies variances."""
    sd = np.sqrt(np.diag(np.linalg.inv(information + np.diag(prior.information))) * student_factor)
    limit = np.concatenate([np.full(6, UNDETERMINED), np.full(12, _LEARNT * cross_sd), np.full(3, np.inf)])
    limit[DIAGONAL] = UNDETERMINED
    return np.flatnonzero(sd > limit)


def _covariance(weighed: Weighed, solution: ImuSolution, unknown: NDArray[np.intp], prior: ImuPrior) -> Array:
    """Covariance (21, 21) of the unknowns; what is held passes its usual size on to the others.

    With ``F`` the information, fitting x1 with x2 held errs by ``-H x2``, ``H = F11^-1 F12``.
    """
    rest = np.setdiff1d(np.arange(UNKNOWNS), unknown)
    F = solution.information
    scale = np.sqrt(np.diag(F)[rest])
    inverse = np.linalg.inv(F[np.ix_(rest, rest)] / np.outer(scale, scale)) / np.outer(scale, scale)
    H = inverse @ F[np.ix_(rest, unknown)]
    covariance = np.zeros((UNKNOWNS, UNKNOWNS))
    covariance[np.ix_(rest, rest)] = inverse * weighed.student_factor + (H / prior.information[unknown]) @ H.T
    return covariance


def _integrable(gyro: Channel, spans: Array) -> NDArray[np.bool_]:
    """Mask of the `spans` (K, 2) over which the gyroscope has neither a gap nor a reading at the end of its range."""
    step = float(np.median(np.diff(gyro.t)))
    highest, lowest = gyro.values.max(axis=0), gyro.values.min(axis=0)
    usable = np.zeros(len(spans), dtype=np.bool_)
    for k, (start, end) in enumerate(spans):
        i, j = np.searchsorted(gyro.t, (start, end))
        inside = slice(max(int(i) - 1, 0), int(j) + 1)
        clipped = ((gyro.values[inside] == highest) | (gyro.values[inside] == lowest)).sum(axis=0).max(initial=0)
        usable[k] = np.diff(gyro.t[inside]).max(initial=np.inf if j - i < 2 else 0.0) <= _GAP * step
        usable[k] &= clipped < _CLIPPED
    return usable


def _filled(accel: Channel, gyro: Channel, spans: Array) -> Array:
    """The spans that hold enough samples of both sensors."""
    counts = [np.diff(np.searchsorted(c.t, spans.ravel()).reshape(-1, 2), axis=1)[:, 0] for c in (accel, gyro)]
    return spans[np.minimum(*counts) >= _LEAST_IN_POSE]


def _unusable(accel: Channel, gyro: Channel) -> str:
    """Why nothing can be fitted to these samples; empty if something may."""
    for channel in (accel, gyro):
        if len(channel) < _LEAST_SAMPLES:
            return f"{len(channel)} finite samples of the {channel.sensor}: {_LEAST_SAMPLES} are needed"
        still = [AXES[i] for i in range(3) if np.ptp(channel.values[:, i]) == 0.0]
        if still:
            return f"the {channel.sensor} reads one constant value on {', '.join(still)}: stuck or not connected"
        largest = float(np.abs(channel.values).max())
        if largest > _LARGEST:
            return f"the {channel.sensor} reads up to {largest:.3g} {channel.unit}: that is no measurement"
        if not np.median(np.diff(channel.t)) > 0.0:
            return f"the time of the {channel.sensor} stands still: give every sample its time, or --rate"
    overlap = min(accel.t[-1], gyro.t[-1]) - max(accel.t[0], gyro.t[0])
    if overlap < 5.0:
        return f"accelerometer and gyroscope were recorded together for {max(overlap, 0.0):.1f} s only"
    return ""


def _not_gravity(poses: Poses, gravity: float | None) -> str:
    """Why the means cannot be those of gravity; empty if they can."""
    centre = np.zeros(3) if gravity is not None else sphere_of(poses.means)[0]
    lengths = np.linalg.norm(poses.means - centre, axis=1)
    if gravity is not None and not (0.5 * gravity < lengths.min() and lengths.max() < 2.0 * gravity):
        return (
            f"readings of {lengths.min():.3g} to {lengths.max():.3g} m/s2 at rest are not gravity ({gravity:.3g}): "
            "check the unit (counts, g), or the sensor is broken"
        )
    spread = float(np.ptp(poses.means, axis=0).max())
    if spread < 0.2 * float(np.median(lengths)):
        return f"the {len(poses)} poses are nearly one and the same: hold each side down once, and oblique ones"
    return ""


def _check(accel: Channel, gyro: Channel, gravity: float, cross_sd: float) -> None:
    require_positive(gravity)
    require_positive(cross_sd, "the sd of misalignments")
    accel.require_ordered()
    gyro.require_ordered()
