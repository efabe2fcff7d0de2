"""Calibration from turns of known rate: ``mean = M rate + b``, with the columns of M for the axes turned about.

For two turns about one axis at rates +-W this is ``M e = (m+ - m-)/(2 W)`` and ``b = (m+ + m-)/2`` (METHODS S3). Whole
turns on a thread are the same with different rates. If there are more turns than unknowns, their noise weights them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.fit import AXES, FitBuilder, FitResult, parameter_names
from mavcal.calib.recording import Array, Channel
from mavcal.calib.stats.quantisation import with_apparent_quantum
from mavcal.calib.stats.residuals import residual_statistics
from mavcal.calib.stats.windows import finite_rows, without_spikes
from mavcal.calib.triad import TriadModel, drift_sd_deg_per_min

EARTH_RATE = 7.292115e-5
"""Turn of the Earth against the stars, rad/s (WGS 84)."""
_LARGEST = 1e12  # of any unit
_FASTEST = 200.0  # rad/s, 11 000 deg/s: beyond every gyroscope's range
_MISFIT = 0.001
_STRANGE = 2.0  # a scale farther from one than this factor: the rate that was stated is not the one that was turned


def usable(channel: Channel) -> Channel:
    """The finite samples of `channel` without lone spikes, with the quantum found from them.

    Raises
    ------
    InvalidInputError
        If time goes back, the columns are not three, or a number is absurdly large.
    """
    channel.require_ordered()
    channel = channel.take(finite_rows(channel.values))
    largest = float(np.abs(channel.values).max(initial=0.0))
    if largest > (_FASTEST if channel.unit == "rad/s" else _LARGEST):
        raise InvalidInputError(
            f"the {channel.sensor} reads up to {largest:.3g} {channel.unit}: no sensor does, check its unit"
        )
    return with_apparent_quantum(channel.take(without_spikes(channel.values)))


@dataclass(frozen=True, eq=False)
class Turn:
    """One turn (or rest): its true rate (3,) rad/s, the gyroscope's mean (3,) and the covariance (3, 3) of that.

    `rate_sd` is the uncertainty of the true rate, rad/s; `duration` in s; `n` the samples.
    """

    label: str
    rate: Array
    mean: Array
    covariance: Array
    duration: float
    n: int
    rate_sd: float = 0.0


def fit_turns(
    method: str,
    gyro: Channel,
    turns: Sequence[Turn],
    *,
    movement: str,
    earth_known: bool = False,
    native: Mapping[str, Any] | None = None,
    warnings: tuple[str, ...] = (),
    temperature: float | None = None,
    relative: bool = False,
) -> FitResult:
    """Offset, and the columns of the matrix for the axes turned about.

    Parameters
    ----------
    method, movement
        Name of the method, and what to do if turns are missing.
    gyro
        The channel with the turns; the result has its unit.
    turns
        Turns at a known rate; an axis needs two different rates.
    earth_known
        Whether the Earth's rate is part of the turns' rates; else it is in the offset and in its uncertainty.
    native, warnings, temperature, relative
        Passed on to the result.
    """
    made = FitBuilder.of(method, gyro, relative=relative, temperature=temperature, movement=movement)
    rates = np.array([turn.rate for turn in turns]).reshape(-1, 3)
    fastest = np.abs(rates).max(initial=0.0)
    axes = [j for j in range(3) if fastest > 0.0 and np.abs(rates[:, j]).max() > 0.01 * fastest]
    if not axes:
        return made.refused(f"{len(turns)} turns of known rate were found: {movement}")
    design = np.column_stack([rates[:, axes] / fastest, np.ones(len(turns))])
    if len(turns) < len(axes) + 1 or np.linalg.cond(design) > 1e3:
        open_axes = ", ".join(AXES[j] for j in axes if np.ptp(rates[:, j]) < 0.1 * np.abs(rates[:, j]).max())
        return made.refused(f"scale and offset of {open_axes or 'the gyroscope'} are not told apart: {movement}")
    solved = _solve(design, turns, fastest)
    matrix = _sensitivity(solved.coefficients[:-1] / fastest, axes, gyro.unit)
    if abs(np.linalg.det(matrix)) < 1e-3 * np.prod(np.linalg.norm(matrix, axis=0)):
        return made.refused("the turns about different axes read the same: name the axis of every turn in its label")
    scales = np.diag(matrix)[axes]
    if gyro.unit == "rad/s" and not ((scales > 1.0 / _STRANGE) & (scales < _STRANGE)).all():
        return made.refused(
            f"the gyroscope reads {', '.join(f'{s:.3g}' for s in scales)} times the stated rate about "
            f"{', '.join(AXES[j] for j in axes)}: check the rate (deg/s), its direction and the unit"
        )
    found = _Found(turns, axes, matrix, solved, fastest)
    return _result(made, found, earth_known=earth_known, native=native or {}, warnings=warnings)


@dataclass(frozen=True, eq=False)
class _Solved:
    coefficients: Array  # (p + 1, 3), rows: columns of M times the scale of the design, then the offset
    covariance: Array  # (3 (p + 1),) squared, coefficient by coefficient
    residuals: Array  # (S, 3)
    whitened: Array  # (S, 3)
    condition: float


def _solve(design: Array, turns: Sequence[Turn], fastest: float) -> _Solved:
    """Generalised least squares; a rate's own uncertainty acts along the column that it multiplies."""
    p = design.shape[1]
    covariances = np.array([turn.covariance for turn in turns])
    tiny = 1e-18 * float(max((turn.mean**2).sum() for turn in turns)) + 1e-300
    coefficients = np.zeros((p, 3))
    for _ in range(2):  # the second time with the columns known
        along = np.array([t.rate_sd / fastest for t in turns])[:, None] * (design[:, :-1] != 0.0)
        extra = np.einsum("sp,pi,pj->sij", along**2, coefficients[:-1], coefficients[:-1])
        white = np.linalg.inv(np.linalg.cholesky(covariances + extra + tiny * np.eye(3)))
        A = np.einsum("sij,sp->sipj", white, design).reshape(3 * len(turns), 3 * p)
        y = np.concatenate([w @ turn.mean for w, turn in zip(white, turns, strict=True)])
        Q, upper = np.linalg.qr(A)
        coefficients = np.linalg.solve(upper, Q.T @ y).reshape(p, 3)
    back = np.linalg.inv(upper)
    residuals = np.array([t.mean for t in turns]) - design @ coefficients
    whitened = np.einsum("sij,sj->si", white, residuals)
    return _Solved(coefficients, back @ back.T, residuals, whitened, float(np.linalg.cond(design)))


def _sensitivity(columns: Array, axes: Sequence[int], unit: str) -> Array:
    """M (3, 3) with the known columns; the others are those of a perfect sensor of the same scale."""
    usual = 1.0 if unit == "rad/s" else float(np.linalg.norm(columns, axis=1).mean())
    matrix = usual * np.eye(3)
    matrix[:, axes] = columns.T
    return matrix


@dataclass(frozen=True, eq=False)
class _Found:
    """The solution and its inputs: the sensitivity (3, 3) about `axes`, and rates as fractions of the fastest."""

    turns: Sequence[Turn]
    axes: Sequence[int]
    sensitivity: Array
    solved: _Solved
    fastest: float


def _result(
    made: FitBuilder, found: _Found, *, earth_known: bool, native: Mapping[str, Any], warnings: tuple[str, ...]
) -> FitResult:
    solved, axes = found.solved, found.axes
    matrix = np.asarray(np.linalg.inv(found.sensitivity), dtype=np.float64)
    dof = solved.residuals.size - 3 * (len(axes) + 1)
    covariance = _covariance(solved, axes, matrix, found.fastest)
    p_value = float(scipy.special.chdtrc(dof, (solved.whitened**2).sum())) if dof > 0 else None
    if p_value is not None and p_value < _MISFIT:
        covariance = covariance * float((solved.whitened**2).sum()) / dof
        warnings = (*warnings, f"the turns contradict each other (p = {p_value:.1e}): the sd are widened")
    if dof <= 0:
        warnings = (*warnings, "as many unknowns as turns: nothing tests the fit; repeat every turn")
    if not earth_known:
        earth = found.sensitivity * EARTH_RATE
        covariance[:3, :3] += earth @ earth.T / 3.0
    names = tuple(f"matrix_{AXES[i]}{AXES[j]}" for j in range(3) if j not in axes for i in range(3))
    where = [parameter_names().index(name) for name in names]
    covariance[where, :] = covariance[:, where] = 0.0
    model = TriadModel(solved.coefficients[-1], matrix)
    return made.fitted(
        model,
        covariance,
        message=f"{len(found.turns)} turns about {', '.join(AXES[j] for j in axes)}",
        n_used=sum(turn.n for turn in found.turns),
        residual_rms=float(np.sqrt((solved.residuals**2).mean())),
        condition_number=solved.condition,
        undetermined={name: f"turn it about {name[-1]} as well, both ways" for name in names},
        warnings=warnings,
        quality={
            **residual_statistics(solved.whitened, dof, 1.0),
            "turns": len(found.turns),
            "attitude_sd_deg_per_min": drift_sd_deg_per_min(model, covariance),
        },
        native={**native, **_native(found, model)},
    )


def _native(found: _Found, model: TriadModel) -> dict[str, Any]:
    sensitivity, axes = found.sensitivity, found.axes
    return {
        "sensitivity": sensitivity.tolist(),
        "columns": {AXES[j]: sensitivity[:, j].tolist() for j in axes},
        "scale": {AXES[j]: float(sensitivity[j, j]) for j in axes},
        "offset": model.offset.tolist(),
        "turns": [
            {"label": t.label, "rate": t.rate.tolist(), "mean": t.mean.tolist(), "duration": t.duration}
            for t in found.turns
        ],
    }


def _covariance(solved: _Solved, axes: Sequence[int], matrix: Array, fastest: float) -> Array:
    """Covariance (12, 12) of offset and correction matrix; ``dC = -C dM C``."""
    spread = np.zeros((12, len(solved.covariance)))
    spread[:3, -3:] = np.eye(3)
    for k, j in enumerate(axes):
        # dM = dcolumn e_j^T: dC = -(C dcolumn) (row j of C)
        spread[3:, 3 * k : 3 * k + 3] = -np.einsum("ai,b->abi", matrix, matrix[j]).reshape(9, 3) / fastest
    return np.asarray(spread @ solved.covariance @ spread.T, dtype=np.float64)
