"""Accelerometer with pose and temperature together, ``measured = M g_k + b + p(T)`` (METHODS 3.4).

Two constraints on the same parameters, both with poses in any direction:

between poses
    Only the length of gravity is known, ``|C (m_k - b - p(T_k))| = g``: one number a pose, along the normal. No
    fixture is squarer than this needs (0.05 deg of tilt outweigh the noise), and with directions unknown the solution
    is the maximum likelihood.
within a pose
    Gravity stands still while the temperature moves, so the drift of all three axes shows by itself, whatever the
    direction is: least squares with one constant a pose. It needs poses with a change of temperature. If each face is
    visited once during the warm-up, direction and temperature are confounded; a second round in the opposite order
    separates them.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from scipy.special import chdtrc

from mavcal.calib import STANDARD_GRAVITY
from mavcal.calib.accel.poses import check_assumed, missing_faces, residual_in
from mavcal.calib.errors import InvalidInputError
from mavcal.calib.fit import AXES, FitBuilder, FitResult, parameter_names
from mavcal.calib.recording import Array, Channel
from mavcal.calib.stats.norm_fit import PAIRS
from mavcal.calib.stats.residuals import residual_statistics
from mavcal.calib.stats.stillness import Still, pose_means
from mavcal.calib.stats.windows import finite_rows
from mavcal.calib.thermal.accel_solve import (
    AccelThermalSolution,
    WarmPose,
    WarmProblem,
    WarmSolution,
    confounding,
    scale_drift,
    solve_poses,
    within_information,
    within_poses,
)
from mavcal.calib.thermal.drift import powers_about
from mavcal.calib.triad import ThermalPolynomial, TriadModel, tilt_sd_deg

METHOD = "accel-thermal"

_MISFIT = 0.001
_LEAST_SPAN = 2.0
_SCALE_MOVES = 16.3  # chi2 of three scale slopes that has a chance of 0.001


def fit_accel_thermal(
    accel: Channel,
    stills: Sequence[Still],
    temperature: Channel,
    *,
    degree: int = 2,
    gravity: float = STANDARD_GRAVITY,
    t_ref: float | None = None,
    cross_sd: float | None = 0.01,
    gyro: Channel | None = None,
    relative: bool = False,
) -> FitResult:
    """Offset, matrix and drift of an accelerometer from still poses at different temperatures.

    Parameters
    ----------
    accel, temperature
        Samples and thermometer, any rates.
    stills
        Spans in which the sensor was still, in any direction.
    degree : int
        Of the drift, 1 to 3; a truth of degree 2 fitted by 1 costs 1.4 times the bound.
    gravity : float
        Length of the corrected vector.
    t_ref : float or None
        Temperature that the offset refers to, degC. None: the mean of the poses.
    cross_sd : float or None
        Prior standard deviation of the cross terms of the symmetric matrix; None: no prior.
    gyro : Channel or None
        Corrects the means for the shrinkage by hand tremor.
    relative : bool
        The calibration in force was not known.

    Returns
    -------
    FitResult
        Offset at `t_ref`, symmetric matrix, drift about `t_ref`. What the poses do not determine is named with the face
        to show and the temperature to show it at. ``quality["confounding"]`` is the ratio of the drift's sd to that
        with every face at every temperature; above 4 a round in the opposite order is advised.
    """
    if not 1 <= degree <= 3:
        raise InvalidInputError(f"the degree of the drift is 1 to 3, not {degree}")
    check_assumed(gravity, cross_sd)

    again = "hold every face still for some seconds while it is cold, and again, in opposite order, when it is warm"
    accel = accel.take(finite_rows(accel.values))
    made = FitBuilder.of(METHOD, accel, relative=relative)
    at = _temperature_at(accel, temperature)
    if at is None:
        return made.refused(
            "the thermometer has no finite sample", movement="stream the temperature of the inertial unit"
        )
    inside = np.zeros(len(accel), dtype=np.bool_)
    for still in stills:
        inside |= (accel.t >= still.start) & (accel.t < still.end)
    if len(stills) < 4 or not inside.any():
        return made.refused(f"{len(stills)} still poses are not enough: six faces at two temperatures", movement=again)
    low, high = float(at[inside].min()), float(at[inside].max())
    if high - low < _LEAST_SPAN:
        return made.refused(
            f"the temperature of the poses moved by {high - low:.2f} degC ({low:.1f} to {high:.1f}): "
            f"{_LEAST_SPAN:.0f} are needed; without them accel-multi is the method",
            movement=again,
        )
    middle, half_span = 0.5 * (low + high), 0.5 * (high - low)
    x = (at - middle) / half_span
    solved = _solved(accel, x, stills, gyro, degree=degree, gravity=gravity, cross_sd=cross_sd)
    if isinstance(solved, str):
        return made.refused(solved, movement=again)
    reference = float(middle + half_span * np.mean([w.powers[0] for w in solved.warm])) if t_ref is None else t_ref
    made = dataclasses.replace(made, temperature=reference)
    return _result(made, solved, gravity=gravity, cross_sd=cross_sd, span=(low, high), t_ref=reference)


def _solved(
    accel: Channel,
    x: Array,
    stills: Sequence[Still],
    gyro: Channel | None,
    *,
    degree: int,
    gravity: float,
    cross_sd: float | None,
) -> AccelThermalSolution | str:
    """Solution in two rounds, or why there is none; the second round corrects means for drift within each pose.

    The mean of a pose then belongs to its mean powers of the temperature, and its scatter is only noise.
    """
    within = within_poses(accel, x, stills, degree)
    level = accel
    drift = within.coefficients
    solved: AccelThermalSolution | str = ""
    for _ in range(2):
        warm = _warm_poses(level, x, stills, gyro, degree)
        if len(warm) < 4:
            return f"{len(warm)} poses of eight samples or more: hold six faces at two temperatures"
        solved = solve_poses(warm, within, in_si=accel.unit == "m/s2", gravity=gravity, cross_sd=cross_sd)
        if isinstance(solved, str):
            return solved
        p = solved.solution.parameters[9:].reshape(degree, 3)
        drift = np.where(np.isin(np.arange(9, 9 + 3 * degree), solved.unknown).reshape(degree, 3), 0.0, p)
        level = _levelled(accel, x, stills, solved.problem.radius * drift)
    return solved


def _levelled(accel: Channel, x: Array, stills: Sequence[Still], drift: Array) -> Channel:
    """The samples without the drift within each still span, relative to its mean."""
    values = accel.values.copy()
    for still in stills:
        i, j = np.searchsorted(accel.t, (still.start, still.end))
        if j > i:
            powers = x[i:j, None] ** np.arange(1, len(drift) + 1)
            values[i:j] -= (powers - powers.mean(axis=0)) @ drift
    return dataclasses.replace(accel, values=values)


def _result(
    made: FitBuilder,
    solved: AccelThermalSolution,
    *,
    gravity: float,
    cross_sd: float | None,
    span: tuple[float, float],
    t_ref: float,
) -> FitResult:
    problem, solution, unknown = solved.problem, solved.solution, solved.unknown
    degree = problem.degree
    chi2, dof = _chi2(problem, solution, unknown, cross_sd)
    p_value = None if dof <= 0 else float(chdtrc(dof, chi2))
    model, covariance, scale_of = _model(
        problem, solution, unknown, cross_sd=cross_sd, gravity=gravity, span=span, t_ref=t_ref
    )
    if p_value is not None and p_value < _MISFIT:
        covariance = covariance * (chi2 / dof)
    confounded = confounding(problem, solution)
    return made.fitted(
        model,
        covariance,
        message=f"{len(solved.warm)} poses over {span[0]:.1f} to {span[1]:.1f} degC, directions free, drift of degree "
        f"{degree}",
        n_used=sum(w.pose.n for w in solved.warm),
        residual_rms=residual_in(made.unit, model, solution.lengths, gravity),
        condition_number=scale_of,
        undetermined=_open(unknown, degree, missing_faces(solved.weak.directions)),
        partial=any(i < 6 or i >= 9 for i in unknown),
        warnings=_warnings(solved, p_value, confounded),
        quality={
            **residual_statistics(solution.residuals, dof, 1.0),
            "chi2": chi2,
            "p_value": p_value,
            "poses": len(solved.warm),
            "span": span[1] - span[0],
            "t_min": span[0],
            "t_max": span[1],
            "confounding": confounded,
            "within_samples": problem.within.n,
            "gravity": gravity,
            "attitude_sd_deg": _attitude_sd(model, covariance, gravity, span),
        },
        native=_native(solved, gravity, 0.5 * (span[1] - span[0])),
    )


def _warnings(solved: AccelThermalSolution, p_value: float | None, confounded: float) -> Iterator[str]:
    """Warnings of the fit; `p_value` None: as many unknowns as poses."""
    problem, solution = solved.problem, solved.solution
    if p_value is None:
        yield "as many unknowns as poses: nothing tests the fit; visit the faces once more"
    elif p_value < _MISFIT:
        pose = solved.warm[int(np.argmax(np.abs(solution.residuals)))].pose
        yield (
            f"the poses contradict each other (p = {p_value:.1e}; the sd is inflated to their scatter): that of "
            f"{pose.start:.1f} to {pose.end:.1f} s is off most; or the drift needs a higher degree"
        )
    if confounded > 4.0:
        yield (
            f"direction and temperature went together (the drift is known {confounded:.1f} times worse for it): visit "
            "the faces a second time in opposite order"
        )
    slope, slope_covariance = scale_drift(problem, solution)
    if slope @ np.linalg.solve(slope_covariance, slope) > _SCALE_MOVES:
        yield (
            f"the scale moves with temperature as well ({_listed(200.0 * slope)} % of x, y, z over the span): no "
            "autopilot stores that, the matrix is that of the mean"
        )


def _chi2(
    problem: WarmProblem, solution: WarmSolution, unknown: Sequence[int], cross_sd: float | None
) -> tuple[float, int]:
    """Squared residuals with those of the prior and of the drift within poses, and their degrees of freedom."""
    inner, target = within_information(problem)
    off = solution.parameters - target
    pulled = problem.prior * (solution.parameters - problem.start) ** 2
    chi2 = float(solution.residuals @ solution.residuals + off @ inner @ off + pulled.sum())
    free = [i for i in range(len(off)) if i not in unknown]
    known_before = int((problem.prior[free] > 0).sum())
    within_poses = 3 * problem.degree if problem.within.n else 0
    return chi2, len(problem.means) + known_before + within_poses - len(free)


def _model(
    problem: WarmProblem,
    solution: WarmSolution,
    unknown: Sequence[int],
    *,
    cross_sd: float | None,
    gravity: float,
    span: tuple[float, float],
    t_ref: float,
) -> tuple[TriadModel, Array, float]:
    """Model in sensor units, covariance over its parameters, and the condition number."""
    degree, radius = problem.degree, problem.radius
    x, covariance = solution.parameters.copy(), solution.covariance.copy()
    if any(6 <= i < 9 for i in unknown) and cross_sd:
        covariance = _with_cross_scatter(problem, solution, [i for i in unknown if 6 <= i < 9], cross_sd)
    neutral = np.concatenate([np.zeros(3), np.ones(3), np.zeros(3 + 3 * degree)])
    for i in unknown:
        x[i] = neutral[i]
        covariance[i, :] = covariance[:, i] = 0.0
    middle, half_span = 0.5 * (span[0] + span[1]), 0.5 * (span[1] - span[0])
    shift = powers_about(t_ref, middle, half_span, degree + 1)
    size = 12 + 3 * degree
    spread = np.zeros((size, len(x)))
    for k, (i, j) in enumerate(PAIRS):
        spread[3 + 3 * i + j, 3 + k] = spread[3 + 3 * j + i, 3 + k] = gravity / radius
    for axis in range(3):
        columns = [axis, *(9 + axis + 3 * np.arange(degree))]
        rows = [axis, *range(12 + axis * degree, 12 + (axis + 1) * degree)]
        spread[np.ix_(rows, columns)] = radius * shift
    values = spread @ x
    model = TriadModel(
        offset=values[:3],
        matrix=values[3:12].reshape(3, 3),
        polynomial=ThermalPolynomial(t_ref, span[0], span[1], values[12:].reshape(3, degree)),
    )
    free = [i for i in range(len(x)) if i not in unknown]
    information = solution.information[np.ix_(free, free)]
    scale = np.sqrt(np.diag(information))
    condition = float(np.sqrt(np.linalg.cond(information / np.outer(scale, scale))))
    return model, spread @ covariance @ spread.T, condition


def _with_cross_scatter(problem: WarmProblem, solution: WarmSolution, crosses: list[int], cross_sd: float) -> Array:
    """Covariance with the scatter that cross terms of prior sd `cross_sd` leave in the others, held at zero.

    With ``r = J1 x1 + J2 x2``, fitting x1 alone errs by ``-F11^-1 F12 x2``. In addition, ``|C d|`` lengthens by c^2/2
    for each cross term c of an axis.
    """
    rest = [i for i in range(len(solution.parameters)) if i not in crosses]
    H = solution.covariance[np.ix_(rest, rest)] @ solution.information[np.ix_(rest, crosses)]
    covariance = solution.covariance.copy()
    covariance[np.ix_(rest, rest)] += cross_sd**2 * H @ H.T
    for axis in range(3):
        k = sum(axis in PAIRS[i - 3] for i in crosses)
        covariance[3 + axis, 3 + axis] += 0.25 * k * (k + 2) * cross_sd**4
    return covariance


def _open(unknown: Sequence[int], degree: int, remedy: str) -> dict[str, str]:
    """Names of what is not determined, in the order of the model, each with the movement that would."""
    found: dict[str, str] = {}
    for i in unknown:
        if i < 3:
            found[f"offset_{AXES[i]}"] = remedy
        elif i < 9:
            a, b = (AXES[k] for k in PAIRS[i - 3])
            text = remedy if a == b else f"hold it obliquely between {a} and {b}, both ways"
            found[f"matrix_{a}{b}"] = found[f"matrix_{b}{a}"] = text
        else:
            power, axis = divmod(i - 9, 3)
            text = f"hold {AXES[axis]} up and down again at another temperature, the faces in opposite order"
            found[f"poly{power + 1}_{AXES[axis]}"] = text
    return {name: found[name] for name in parameter_names(degree) if name in found}


def _attitude_sd(model: TriadModel, covariance: Array, gravity: float, span: tuple[float, float]) -> float:
    """Standard deviation of the level, degrees, at the worst temperature of the span."""
    assert model.polynomial is not None
    degree = model.polynomial.coefficients.shape[1]
    worst = 0.0
    for at in np.linspace(span[0], span[1], 9):
        powers = (at - model.polynomial.t_ref) ** np.arange(1, degree + 1)
        moved = np.hstack([np.eye(12), np.vstack([np.kron(np.eye(3), powers), np.zeros((9, 3 * degree))])])
        worst = max(worst, tilt_sd_deg(model, moved @ covariance @ moved.T, gravity))
    return worst


def _native(solved: AccelThermalSolution, gravity: float, half_span: float) -> dict[str, Any]:
    problem, solution = solved.problem, solved.solution
    slope, covariance = scale_drift(problem, solution)
    return {
        "form": "|C (m - b - p(T))| = g, C symmetric, directions free",
        "pose_residuals": (gravity * solution.lengths).tolist(),
        "pose_residuals_sd": solution.residuals.tolist(),
        "pose_directions": solution.directions.tolist(),
        "scale_per_degc": (slope / half_span).tolist(),
        "scale_per_degc_sd": (np.sqrt(np.diag(covariance)) / half_span).tolist(),
    }


def _listed(values: Array) -> str:
    return ", ".join(f"{value:.2g}" for value in values)


def _temperature_at(accel: Channel, temperature: Channel) -> Array | None:
    values = temperature.values[:, 0]
    good = np.isfinite(values)
    if not good.any():
        return None
    return np.asarray(np.interp(accel.t, temperature.t[good], values[good]), dtype=np.float64)


def _warm_poses(
    accel: Channel, x: Array, stills: Sequence[Still], gyro: Channel | None, degree: int
) -> tuple[WarmPose, ...]:
    warm = []
    for pose in pose_means(accel, tuple(stills), gyro=gyro):
        i, j = np.searchsorted(accel.t, (pose.start, pose.end))
        warm.append(WarmPose(pose, np.array([float((x[i:j] ** k).mean()) for k in range(1, degree + 1)])))
    return tuple(warm)
