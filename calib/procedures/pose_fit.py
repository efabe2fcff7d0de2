"""Fits the accelerometers to a set of poses, and decides whether they are enough, or which pose to add or repeat."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mavcal.calib.accel.poses import fit_poses
from mavcal.calib.fit import FitResult, FitStatus
from mavcal.calib.procedures.holds import HeldPose
from mavcal.calib.procedures.roster import label
from mavcal.calib.recording import Sensor

LEAST_FREEDOM = 3
"""Least degrees of freedom of a residual test."""

CHANCE = 1e-3
"""P-value below which poses contradict each other."""

CURED = 1e-2
"""Least p-value of the other poses without the one that disagrees."""

MARGIN = 6.0
"""Least further decrease of chi2 without the culprit than without any other pose: twenty to one in likelihood."""


@dataclass(frozen=True, eq=False)
class Assessment:
    """The fits of all accelerometers and the verdict over them.

    `culprit` is the one pose that contradicts all the others; None: there is none, or it cannot be told which.
    """

    fits: tuple[FitResult, ...]
    passed: bool
    offset_sd: float
    residual_rms: float
    culprit: HeldPose | None
    short: str


def assess(poses: Sequence[HeldPose], instances: Sequence[int], gravity: float, target: float) -> Assessment:
    """Fit every accelerometer and judge: uncertainty `target` (m/s2) on every offset, and the residual test.

    If the poses contradict each other, the fits' covariance is inflated to their scatter. They still pass if that is
    within the target, since the contradiction is then smaller than the requested uncertainty.
    """
    fits = tuple(_fit(poses, i, gravity) for i in instances)
    refusal = next((f for f in fits if f.status == FitStatus.REFUSED), None)
    if refusal is not None:
        short = f"{label(Sensor.ACCEL, refusal.instance)}: {refusal.message}"
        return Assessment(fits, passed=False, offset_sd=math.inf, residual_rms=math.inf, culprit=None, short=short)
    sd = max(_offset_sd(f) for f in fits)
    rms = max(f.residual_rms for f in fits)
    failing = [f for f in fits if _chance(f) < CHANCE]
    tested = all(f.quality["dof"] >= LEAST_FREEDOM for f in fits)
    passed = tested and sd <= target
    contradiction = bool(failing) and not passed  # the inflated uncertainty misses the goal too
    return Assessment(
        fits=fits,
        passed=passed,
        offset_sd=sd,
        residual_rms=rms,
        culprit=_culprit(poses, failing[0].instance, gravity) if contradiction else None,
        short=_short(sd, rms, target, passed=passed, contradiction=contradiction),
    )


def _fit(poses: Sequence[HeldPose], instance: int, gravity: float) -> FitResult:
    means = [p.means[instance] for p in poses if instance in p.means]
    return fit_poses(means, gravity=gravity, instance=instance)


def _offset_sd(fit: FitResult) -> float:
    sd = fit.sd[:3]
    return math.inf if np.isnan(sd).any() else float(sd.max())


def _chance(fit: FitResult) -> float:
    p_value = fit.quality["p_value"]
    return 1.0 if p_value is None else float(p_value)


def _culprit(poses: Sequence[HeldPose], instance: int, gravity: float) -> HeldPose | None:
    """The pose without which the others agree, if unambiguous."""
    without = [_fit([p for p in poses if p is not left_out], instance, gravity) for left_out in poses]
    usable = [k for k, f in enumerate(without) if f.status != FitStatus.REFUSED]
    order = sorted(usable, key=lambda k: float(without[k].quality["chi2"]))
    if len(order) < 2 or _chance(without[order[0]]) < CURED:
        return None
    best, second = (float(without[k].quality["chi2"]) for k in order[:2])
    return poses[order[0]] if second - best > MARGIN else None


def _short(sd: float, rms: float, target: float, *, passed: bool, contradiction: bool) -> str:
    if passed:
        return f"every offset is known to {sd:.4f} m/s2 or better; the poses agree within {rms:.4f} m/s2 (rms)"
    if contradiction:
        return f"the poses disagree by {rms:.3f} m/s2 (rms), more than their noise explains"
    return f"the offsets are known to {sd:.4f} m/s2, not to {target:.4f}"
