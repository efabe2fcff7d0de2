"""Drift of a compass with temperature per axis and pose, and its repeatability.

A motionless compass reads ``b + k_b (T - t_ref) + (1 + k_m (T - t_ref)) M field``. A drift of its offset is the same in
every pose; one of its sensitivity is proportional to the field along the axis. Several poses are needed to tell them
apart.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.fit import AXES, OFFSETS, FitBuilder, FitResult
from mavcal.calib.recording import Array, Channel
from mavcal.calib.thermal.drift import DriftBlocks, DriftData
from mavcal.calib.thermal.quality import common_warnings
from mavcal.calib.triad import ThermalPolynomial, TriadModel

METHOD = "mag-thermal"

_WARM = "hold it still away from currents and steel, warm it up through ten degrees, and repeat it in another pose"
_SURE = 3.0  # sd: within them poses agree, beyond them a slope is none of chance
_BESIDE = 0.25  # of the slope: by as much poses may differ and still repeat


@dataclass(frozen=True, eq=False)
class _Pose:
    """Slopes (3,) of one pose with their sd, its mean field and the range of temperature."""

    data: DriftData
    slopes: Array
    sd: Array
    field: Array
    residual: Array


def fit_mag_thermal(
    poses: Sequence[tuple[Channel, Array]], *, t_ref: float = 25.0, min_span: float = 5.0, relative: bool = False
) -> FitResult:
    """Slope of every axis of one compass against its temperature.

    Parameters
    ----------
    poses
        For each pose the samples of the motionless compass and a temperature (N,) for each, degC.
    t_ref : float
        Temperature at which nothing is corrected, degC.
    min_span : float
        Least range of temperature of every pose, degC.
    relative : bool
        The calibration in force was not known.

    Returns
    -------
    FitResult
        Slopes in ``model.polynomial`` for the axes with equal slopes in every pose. The others are undetermined, and
        with a single pose all are. ``native["poses"]`` has the slopes of each. Refused where no pose warms up enough.
    """
    made = FitBuilder.of(METHOD, poses[0][0], relative=relative, temperature=t_ref, movement=_WARM)
    made = dataclasses.replace(made, n_samples=sum(len(channel) for channel, _ in poses))
    found, reasons = [], []
    for channel, temperature in poses:
        data = DriftData.of(channel, temperature)
        reason = data.refusal(1, min_span)
        if reason:
            reasons.append(reason)
        else:
            found.append(_pose(data, t_ref))
    if not found:
        return made.refused(reasons[0])
    repeats = _repeats(found)
    slopes, sd = _pooled(found)
    return made.fitted(
        TriadModel(polynomial=_polynomial(found, t_ref, np.where(repeats, slopes, 0.0))),
        _covariance(np.where(repeats, sd, 0.0)),
        message=_message(found, repeats, slopes, sd, made.unit),
        n_used=sum(pose.data.n for pose in found),
        residual_rms=math.sqrt(float(np.mean([pose.residual**2 for pose in found]))),
        condition_number=1.0,
        undetermined=dict.fromkeys(OFFSETS, "turn it in all directions: mag-ellipsoid")
        | {f"poly1_{a}": _WARM for a, ok in zip(AXES, repeats, strict=True) if not ok},
        partial=not repeats.all(),
        warnings=[*_warnings(found, repeats, made.unit), *(f"one pose was left out: {reason}" for reason in reasons)],
        quality={"poses": len(found), "t_min": _span(found)[0], "t_max": _span(found)[1]},
        native={"poses": [_pose_document(pose) for pose in found], "slopes": slopes.tolist(), "slopes_sd": sd.tolist()},
    )


def _pose(data: DriftData, t_ref: float) -> _Pose:
    blocks = DriftBlocks.of(data.t - t_ref, data.time, data.y, degree=1)
    variance = blocks.noise().covariances[:, 1, 1]
    return _Pose(data, blocks.ordinary[1], np.sqrt(variance), data.y.mean(axis=0), blocks.residual_sd())


def _pooled(found: Sequence[_Pose]) -> tuple[Array, Array]:
    """Mean slope (3,) weighted by the poses' precision; its sd includes their differences."""
    weights = np.array([1.0 / np.maximum(pose.sd, 1e-12) ** 2 for pose in found])
    slopes = np.array([pose.slopes for pose in found])
    mean = (weights * slopes).sum(axis=0) / weights.sum(axis=0)
    spread = (weights * (slopes - mean) ** 2).sum(axis=0) / max(len(found) - 1, 1)
    return mean, np.sqrt(np.maximum(spread, 1.0) / weights.sum(axis=0))


def _repeats(found: Sequence[_Pose]) -> NDArray[np.bool_]:
    """Mask (3,) of the axes with a significant slope that is equal in every pose."""
    if len(found) < 2:
        return np.zeros(3, dtype=np.bool_)
    mean, sd = _pooled(found)
    agree = np.ones(3, dtype=np.bool_)
    for pose in found:
        off = np.abs(pose.slopes - mean)
        agree &= (off <= np.maximum(_SURE * pose.sd, _BESIDE * np.abs(mean))) & (pose.slopes * mean > 0.0)
    return np.asarray(agree & (np.abs(mean) > _SURE * sd), dtype=np.bool_)


def _span(found: Sequence[_Pose]) -> tuple[float, float]:
    return min(pose.data.t_min for pose in found), max(pose.data.t_max for pose in found)


def _polynomial(found: Sequence[_Pose], t_ref: float, slopes: Array) -> ThermalPolynomial:
    low, high = _span(found)
    return ThermalPolynomial(t_ref, low, high, slopes[:, None])


def _covariance(sd: Array) -> Array:
    covariance = np.zeros((15, 15))
    covariance[12:, 12:] = np.diag(sd**2)
    return covariance


def _message(found: Sequence[_Pose], repeats: NDArray[np.bool_], slopes: Array, sd: Array, unit: str) -> str:
    low, high = _span(found)
    where = f"over {low:.1f} to {high:.1f} degC in {len(found)} pose{'s' if len(found) > 1 else ''}"
    listed = ", ".join(f"{a} {k:.3g} +- {s:.1g}" for a, k, s in zip(AXES, slopes, sd, strict=True))
    kept = ", ".join(a for a, ok in zip(AXES, repeats, strict=True) if ok)
    which = f"{kept} repeat" if kept else "no axis is shown to repeat"
    return f"slopes {where}: {listed} {unit}/degC; {which}"


def _warnings(found: Sequence[_Pose], repeats: NDArray[np.bool_], unit: str) -> list[str]:
    warnings = [text for pose in found for text in common_warnings(pose.data, ~pose.data.constant)]
    if len(found) < 2:
        return [
            *warnings,
            "one pose does not tell a drift of the offset from one of the sensitivity or of the field: repeat it in "
            "another pose",
        ]
    for axis in np.flatnonzero(~repeats):
        each = " and ".join(f"{pose.slopes[axis]:.3g} +- {pose.sd[axis]:.1g}" for pose in found)
        fields = " and ".join(f"{pose.field[axis]:.1f}" for pose in found)
        if _goes_with_field(found, int(axis)):
            verdict = f"and goes with the field on it ({fields} {unit}): its sensitivity drifts, not its offset"
        elif _differ(found, int(axis)):
            verdict = "and does not repeat: it is no drift of the offset with temperature"
        else:
            verdict = "too uncertain to tell it from zero: warm it up further"
        warnings.append(f"the slope of {AXES[axis]} is {each} {unit}/degC in the {len(found)} poses, {verdict}")
    return warnings


def _differ(found: Sequence[_Pose], axis: int) -> bool:
    """Whether the slopes of the poses differ significantly."""
    mean = float(_pooled(found)[0][axis])
    return any(abs(float(pose.slopes[axis]) - mean) > _SURE * float(pose.sd[axis]) for pose in found)


def _goes_with_field(found: Sequence[_Pose], axis: int) -> bool:
    """Whether slope over field is equal in every pose, and significant."""
    field = np.array([pose.field[axis] for pose in found])
    slopes = np.array([pose.slopes[axis] for pose in found])
    sd = np.maximum(np.array([pose.sd[axis] for pose in found]), 1e-12)
    if np.ptp(field) < 0.5 * np.abs(field).max():
        return False
    per_field = float((slopes * field / sd**2).sum() / (field**2 / sd**2).sum())
    off = np.abs(slopes - per_field * field)
    known = abs(per_field) * math.sqrt(float((field**2 / sd**2).sum())) > _SURE
    return bool(known and (off <= np.maximum(_SURE * sd, _BESIDE * np.abs(slopes))).all())


def _pose_document(pose: _Pose) -> dict[str, Any]:
    return {
        "slopes": pose.slopes.tolist(),
        "slopes_sd": pose.sd.tolist(),
        "field": pose.field.tolist(),
        "t_min": pose.data.t_min,
        "t_max": pose.data.t_max,
        "samples": pose.data.samples,
    }
