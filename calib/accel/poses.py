"""The accelerometer from gravity: poses in any direction, and one axis vertical.

A still accelerometer tells the length of gravity alone, ``|C (m - b)| = g``: nine numbers, with C symmetric (METHODS 0,
3.3). Nobody holds a vehicle square by hand, so no direction is assumed here; :mod:`calib.accel.six_face` fits six faces
on a fixture.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import scipy

from mavcal.calib import STANDARD_GRAVITY
from mavcal.calib.errors import InvalidInputError, require_positive
from mavcal.calib.fit import AXES, OFFSETS, FitBuilder, FitResult
from mavcal.calib.recording import Array, Channel, Sensor
from mavcal.calib.stats.norm_fit import (
    NEUTRAL,
    PAIRS,
    UNDETERMINED,
    NormProblem,
    NormSolution,
    model_of,
    solve,
    unlearnt,
    weighted_along,
    with_neutral,
    without_crosses,
)
from mavcal.calib.stats.quantisation import mean_of
from mavcal.calib.stats.residuals import residual_statistics
from mavcal.calib.stats.stillness import PoseMean
from mavcal.calib.stats.windows import finite_rows
from mavcal.calib.triad import TriadModel, tilt_sd_deg

POSES_METHOD = "accel-multi"
ONE_AXIS_METHOD = "accel-one-axis"

_ALL_SIDES = "hold it still on each of its six sides in turn, and in three oblique poses"
_OBLIQUE = "hold it still in three oblique poses or more, between its six sides"
_ONE_AXIS = "lay it down with one axis vertical to a degree, and leave it alone for some seconds"
_MISFIT = 0.001  # p-value below which the poses contradict each other
_FACES = (  # what the accelerometer feels, and how the vehicle is then held
    ("nose up", "nose down"),
    ("on its left side", "on its right side"),
    ("on its back", "level"),
)


def fit_poses(
    poses: Sequence[PoseMean],
    *,
    gravity: float = STANDARD_GRAVITY,
    cross_sd: float | None = 0.01,
    form: Literal["symmetric", "upper"] = "symmetric",
    instance: int = 0,
    unit: str = "m/s2",
    relative: bool = False,
) -> FitResult:
    """Offset and matrix of an accelerometer from the means of still poses, by ``|C (m - b)| = g``.

    Maximum likelihood on the pose means. Each residual is the distance from the ellipsoid in sensor units, weighted by
    the variance of its mean along the normal. A Gaussian prior holds the cross terms where the poses do not determine
    them.

    Parameters
    ----------
    poses
        Six faces or so and at least three oblique ones make a residual test possible.
    gravity : float
        Length of the corrected vector.
    cross_sd : float or None
        Prior standard deviation of the three off-diagonal entries of the symmetric matrix. 0: they are held at
        zero. None: no prior, nine well-spread poses or more are needed.
    form
        Canonical form of the matrix; the data do not tell them apart.
    instance, unit, relative
        Passed on to the result; with another unit than m/s2 the poses' own radius sets the scale.

    Returns
    -------
    FitResult
        ``quality`` holds chi2, dof, p_value and the residual of every pose. Where the poses contradict each other
        (p < 0.001) the covariance is inflated to their scatter and a warning names the worst one. Offsets and scales
        that the poses do not determine are named, with the movement that would.
    """
    check_assumed(gravity, cross_sd)
    n_samples = sum(pose.n for pose in poses)
    made = FitBuilder(POSES_METHOD, Sensor.ACCEL, instance, unit, n_samples, relative, movement=_ALL_SIDES)
    if len(poses) < 4:
        return made.refused(f"{len(poses)} still poses are not enough: hold six different ones, each side down once")
    nonsense = _nonsense(poses, gravity if unit == "m/s2" else None)
    if nonsense:
        return made.refused(nonsense)
    problem = NormProblem.of(poses, in_si=unit == "m/s2", gravity=gravity, cross_sd=cross_sd)
    weak = solve(problem, weak=True)
    if weak is not None:
        problem = weighted_along(problem, poses, weak)
        weak = solve(problem, weak=True)
    if weak is None:
        return made.refused("the poses do not lie on one sphere: check the unit, and that every pose was still")
    sd = np.sqrt(np.diag(weak.covariance))
    unknown = [i for i in range(6) if sd[i] > UNDETERMINED]
    names = _names(unknown)
    movement = missing_faces(weak.directions)
    if len({i % 3 for i in unknown}) == 3:
        return made.refused(f"these {len(poses)} poses determine no axis: {movement}", names, movement)
    solution = weak if unknown else solve(problem, weak=False)
    if solution is None:
        return made.refused("the fit of the poses did not converge: hold more poses, and each of them longer")
    crosses = unlearnt(problem, weak, cross_sd)
    return _result(made, problem, poses, solution, _Open(unknown, crosses, movement, form))


def fit_one_axis(
    accel: Channel, *, gravity: float = STANDARD_GRAVITY, fixture_sd: float = 0.0, relative: bool = False
) -> FitResult:
    """Offset of an accelerometer with one axis vertical: the mean, less gravity on that axis (METHODS S1).

    Parameters
    ----------
    accel
        Samples at rest; the axis that reads more than 0.9 g is taken as vertical, either way up.
    gravity : float
        In the unit of the samples.
    fixture_sd : float
        How far from vertical the axis may be, degrees (one standard deviation); it is part of the covariance.
    relative : bool
        The calibration in force was not known.

    Returns
    -------
    FitResult
        The matrix is held at one: a scale error reads as offset here.
    """
    made = FitBuilder.of(ONE_AXIS_METHOD, accel, relative=relative, movement=_ONE_AXIS)
    accel = accel.take(finite_rows(accel.values))

    if len(accel) < 16:
        return made.refused(f"{len(accel)} finite samples of the accelerometer: 16 are needed", OFFSETS)
    estimate = mean_of(accel)
    vertical = np.abs(estimate.mean) > 0.9 * gravity
    if vertical.sum() != 1:
        found = "no axis reads" if not vertical.any() else f"{int(vertical.sum())} axes read"
        return made.refused(
            f"{found} more than 0.9 g ({_listed(estimate.mean)}): hold one axis vertical and keep still", OFFSETS
        )
    if np.nanmax(estimate.sd, initial=0.0) > 0.05 * gravity:
        return made.refused(
            f"the samples scatter by {np.nanmax(estimate.sd):.3g} {accel.unit}: it moved, keep it still", OFFSETS
        )
    down = np.where(vertical, np.sign(estimate.mean), 0.0)
    tilt = np.radians(fixture_sd)
    covariance = np.zeros((12, 12))
    covariance[:3, :3] = estimate.covariance + (tilt * gravity) ** 2 * np.diag(1.0 - vertical)
    residual = accel.values - estimate.mean
    noisy = residual[:, ~np.array(estimate.constant)] if not all(estimate.constant) else residual
    model = TriadModel(offset=estimate.mean - gravity * down)
    axis = AXES[int(vertical.argmax())]
    exact = f"the axis was taken as exactly vertical: one degree of tilt is {gravity * np.sin(np.pi / 180):.3g}"
    return made.fitted(
        model,
        covariance,
        message=f"offset with {axis} vertical; a scale error is inside it",
        n_used=len(accel),
        residual_rms=float(np.sqrt((residual**2).mean())),
        condition_number=1.0,
        warnings=() if fixture_sd else (exact,),
        quality={
            **residual_statistics(noisy, noisy.size - noisy.shape[1], None),
            "n_effective": estimate.n_effective,
            "gravity": gravity,
            "attitude_sd_deg": tilt_sd_deg(model, covariance, gravity),
        },
        native={"mean": estimate.mean.tolist(), "vertical": axis},
    )


def _nonsense(poses: Sequence[PoseMean], gravity: float | None) -> str:
    """Why the means cannot be those of gravity; empty if they can. `gravity` None: of unknown unit."""
    means = np.array([pose.mean for pose in poses])
    if not np.isfinite(means).all() or not np.isfinite([pose.covariance for pose in poses]).all():
        return "a pose's mean is not finite: leave that pose out"
    spread = float(np.ptp(means, axis=0).max())
    if not 1e-12 < spread < 1e12:
        return f"the poses' means span {spread:.3g}: the accelerometer is stuck, or the poses are one and the same"
    lengths = np.linalg.norm(means, axis=1)
    if gravity is not None and not (0.5 * gravity < lengths.min() and lengths.max() < 2.0 * gravity):
        return (
            f"readings of {lengths.min():.3g} to {lengths.max():.3g} m/s2 are not gravity ({gravity:.3g}): "
            "check the unit, or the sensor is broken"
        )
    return ""


@dataclass(frozen=True)
class _Open:
    """Indices of undetermined parameters and of cross terms held by the prior alone, with the missing movement."""

    unknown: list[int]
    crosses: list[int]
    movement: str
    form: str


def _result(
    made: FitBuilder,
    problem: NormProblem,
    poses: Sequence[PoseMean],
    solution: NormSolution,
    left: _Open,
) -> FitResult:
    prior_terms = int((problem.prior > 0).sum())
    chi2 = float(solution.residuals @ solution.residuals + problem.prior @ (solution.parameters - NEUTRAL) ** 2)
    dof = len(poses) + prior_terms - 9
    p_value = float(scipy.special.chdtrc(dof, chi2)) if dof > 0 else None
    x, covariance = without_crosses(problem, solution, left.crosses)
    warnings = []
    if p_value is not None and p_value < _MISFIT:
        covariance = covariance * (chi2 / dof)
        warnings.append(_contradiction(solution, poses, p_value))
    if p_value is None:
        warnings.append("as many unknowns as poses: nothing tests the fit; add three oblique poses")
    x, covariance = with_neutral(x, covariance, left.unknown + left.crosses)
    model, full = model_of(problem, x, covariance, left.form)
    names = _names(left.unknown + left.crosses, left.form)
    temperatures = [pose.temperature for pose in poses if pose.temperature is not None]
    if temperatures and max(temperatures) - min(temperatures) > 5.0:
        warnings.append(f"the temperature moved by {np.ptp(temperatures):.1f} degC between the poses")
    warm = dataclasses.replace(made, temperature=float(np.mean(temperatures)) if temperatures else None)
    return warm.fitted(
        model,
        full,
        message=f"{len(poses)} poses determine part of it: {left.movement}"
        if left.unknown
        else f"fitted to {len(poses)} poses",
        n_used=made.n_samples,
        residual_rms=residual_in(made.unit, model, solution.lengths, problem.gravity),
        condition_number=float(np.linalg.cond(solution.jacobian / np.linalg.norm(solution.jacobian, axis=0))),
        undetermined=_movements(names, left.movement),
        partial=bool(left.unknown),
        warnings=warnings,
        quality={
            **residual_statistics(solution.residuals, max(dof, 0), 1.0),
            "poses": len(solution.lengths),
            "chi2": chi2,
            "dof": dof,
            "p_value": p_value,
            "worst_pose": int(np.argmax(np.abs(solution.residuals))),
            "pose_residuals": (problem.gravity * solution.lengths).tolist(),
            "pose_residuals_sd": solution.residuals.tolist(),
            "gravity": problem.gravity,
            "attitude_sd_deg": tilt_sd_deg(model, full, problem.gravity),
        },
        native={"offset": model.offset.tolist(), "matrix": model.matrix.tolist(), "form": left.form},
    )


def residual_in(unit: str, model: TriadModel, lengths: Array, gravity: float) -> float:
    """Rms residual in the `unit` of the samples; `lengths` (N,) are relative errors of the corrected length."""
    rms = gravity * math.sqrt(float((lengths**2).mean()))
    return rms if unit == "m/s2" else rms / float(np.cbrt(abs(np.linalg.det(model.matrix))))


def _names(indices: Sequence[int], form: str = "symmetric") -> tuple[str, ...]:
    names: list[str] = []
    for index in indices:
        if index < 3:
            names.append(f"offset_{AXES[index]}")
            continue
        i, j = PAIRS[index - 3]
        names.append(f"matrix_{AXES[i]}{AXES[j]}")
        if i != j and form == "symmetric":
            names.append(f"matrix_{AXES[j]}{AXES[i]}")
    return tuple(names)


def missing_faces(directions: Array) -> str:
    """Instruction that names the faces missing among the measured `directions` (N, 3), unit vectors."""
    missing = [
        _FACES[axis][side]
        for axis in range(3)
        for side, sign in enumerate((1.0, -1.0))
        if (sign * directions[:, axis]).max() < 0.7
    ]
    return f"hold it {' and '.join(missing)}" if missing else "hold every pose longer, and add oblique ones"


def _movements(names: Sequence[str], movement: str) -> dict[str, str]:
    """For each undetermined parameter, the movement that would determine it."""
    crossed = {f"matrix_{a}{b}" for a in AXES for b in AXES if a != b}
    return {name: _OBLIQUE if name in crossed else movement for name in names}


def _contradiction(solution: NormSolution, poses: Sequence[PoseMean], p_value: float) -> str:
    worst = int(np.argmax(np.abs(solution.residuals)))
    pose = poses[worst]
    return (
        f"the poses contradict each other (p = {p_value:.1e}; the sd is inflated to their scatter): pose {worst + 1}, "
        f"{pose.start:.1f} to {pose.end:.1f} s, is off most; take it again, or find what bends or shakes"
    )


def check_assumed(gravity: float, cross_sd: float | None) -> None:
    """Raise InvalidInputError unless gravity is positive, and the prior sd of the cross terms zero or more."""
    require_positive(gravity)
    if cross_sd is not None and not (np.isfinite(cross_sd) and cross_sd >= 0.0):
        raise InvalidInputError(f"the prior sd of the cross terms must be zero or more, not {cross_sd}")


def _listed(values: Array) -> str:
    return ", ".join(f"{value:.3g}" for value in values)
