"""g-sensitivity of a gyroscope: ``rate = b + K a`` at rest in several poses (METHODS 3.5).

The twelve numbers follow from the means of still poses by weighted least squares on ``[a 1]``. The Earth's rate adds to
the readings. Its vertical part looks like an equal diagonal of K; its horizontal part scatters.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import scipy

from mavcal.calib import STANDARD_GRAVITY
from mavcal.calib.errors import InvalidInputError, require_positive
from mavcal.calib.fit import AXES, FitBuilder, FitResult
from mavcal.calib.gyro.rest import LARGEST_BIAS
from mavcal.calib.gyro.turns import EARTH_RATE, usable
from mavcal.calib.imu.poses import Poses, measure
from mavcal.calib.recording import Array, Channel
from mavcal.calib.stats.residuals import residual_statistics
from mavcal.calib.triad import TriadModel, drift_sd_deg_per_min

METHOD = "gyro-g-sensitivity"
MOVEMENT = "rest it on each of its six sides for ten seconds or more, and once more in the opposite order"
_MISFIT = 0.001
_FLAT = 0.1  # of gravity, rms: poses that span less in some direction leave a column of K open
_LEAST_SAMPLES = 8


def fit_g_sensitivity(
    gyro: Channel,
    accel: Channel,
    spans: Array,
    *,
    gravity: float = STANDARD_GRAVITY,
    latitude: float | None = None,
    drift: bool = False,
    temperature: float | None = None,
    relative: bool = False,
) -> FitResult:
    """Offset without acceleration and the matrix K (3, 3) in ``native``, rad/s per m/s2.

    Parameters
    ----------
    gyro, accel
        Samples of the same time; the accelerometer need not be better than a few percent.
    spans : shape (P, 2)
        The rests, s.
    gravity
        Gravity in the unit of `accel`; K is per m/s2 in any case.
    latitude
        Latitude in degrees, to subtract the vertical part of the Earth's rate. None: it stays in K and in the
        uncertainty.
    drift
        Also fit an offset that moves steadily over time; six poses or more are needed.
    temperature, relative
        Passed on to the result.

    Raises
    ------
    InvalidInputError
        If gravity is not positive, or the latitude none.
    """
    require_positive(gravity)
    if latitude is not None and not -90.0 <= latitude <= 90.0:
        raise InvalidInputError(f"a latitude lies between -90 and 90 degrees, not at {latitude}")
    made = FitBuilder.of(METHOD, gyro, relative=relative, temperature=temperature, movement=MOVEMENT)
    gyro, accel = usable(gyro), usable(accel)
    counts = [np.diff(np.searchsorted(c.t, np.ravel(spans)).reshape(-1, 2), axis=1)[:, 0] for c in (gyro, accel)]
    spans = np.asarray(spans).reshape(-1, 2)[np.minimum(*counts) >= _LEAST_SAMPLES]
    unknowns = 5 if drift else 4
    if len(spans) < unknowns:
        return made.refused(
            f"{len(spans)} rests of both sensors: {unknowns} different ones at least are needed; {MOVEMENT}"
        )
    stuck = [AXES[i] for i in range(3) if np.ptp(gyro.values[:, i]) == 0.0]
    if stuck:
        return made.refused(
            f"the gyroscope reads one constant value on {', '.join(stuck)}: it is stuck or not connected"
        )
    fastest = float(np.linalg.norm(np.median(gyro.values, axis=0)))
    if gyro.unit == "rad/s" and fastest > LARGEST_BIAS:
        return made.refused(
            f"the gyroscope reads {fastest:.3g} rad/s: it turns, or the unit is another (deg/s, counts)"
        )
    poses = measure(accel, gyro, spans)
    a = poses.means * (STANDARD_GRAVITY / gravity)
    if not 0.5 < np.median(np.linalg.norm(a, axis=1)) / STANDARD_GRAVITY < 2.0:
        return made.refused(
            f"the accelerometer reads {np.median(np.linalg.norm(poses.means, axis=1)):.3g} at rest, not the "
            f"{gravity:.3g} of gravity: check its unit, or give --gravity"
        )
    smallest = np.linalg.svd((a - a.mean(axis=0)) / np.sqrt(len(a)))[1].min()
    if smallest < _FLAT * STANDARD_GRAVITY:
        return made.refused(f"the {len(a)} rests are too much alike (they span {smallest:.2g} m/s2): {MOVEMENT}")
    return _fit(made, poses, a, latitude, drift=drift)


@dataclass(frozen=True, eq=False)
class _Solved:
    """Least squares of each axis: coefficients (p, 3), covariance (3, p, p), whitened residuals (P, 3)."""

    coefficients: Array
    covariance: Array
    whitened: Array

    @classmethod
    def of(cls, design: Array, rates: Array, variances: Array) -> _Solved:
        p = design.shape[1]
        coefficients, covariance = np.empty((p, 3)), np.empty((3, p, p))
        whitened = np.empty_like(rates)
        for axis in range(3):
            weight = 1.0 / np.sqrt(variances[:, axis])
            Q, upper = np.linalg.qr(design * weight[:, None])
            coefficients[:, axis] = np.linalg.solve(upper, Q.T @ (rates[:, axis] * weight))
            back = np.linalg.inv(upper)
            covariance[axis] = back @ back.T
            whitened[:, axis] = (rates[:, axis] - design @ coefficients[:, axis]) * weight
        return cls(coefficients, covariance, whitened)


def _fit(made: FitBuilder, poses: Poses, a: Array, latitude: float | None, *, drift: bool) -> FitResult:
    """Weighted least squares of each axis on ``[a/g, 1, time]``."""
    middle = poses.spans.mean(axis=1)
    time = (middle - middle.mean()) / max(float(np.ptp(middle)), 1e-9)
    columns = [a / STANDARD_GRAVITY, np.ones((len(a), 1))] + ([time[:, None]] if drift else [])
    design = np.hstack(columns)
    rates, variances = poses.rates, poses.rate_variances
    in_si = made.unit == "rad/s"
    if in_si and latitude is not None:
        up = a / np.linalg.norm(a, axis=1)[:, None]
        rates = rates - EARTH_RATE * np.sin(np.radians(latitude)) * up
    if in_si:
        horizontal = 1.0 if latitude is None else np.cos(np.radians(latitude)) ** 2
        variances = variances + EARTH_RATE**2 * horizontal / 3.0
    solved = _Solved.of(design, rates, variances)
    coefficients, covariance, dof = solved.coefficients, solved.covariance, 3 * (len(a) - design.shape[1])
    chi2 = float((solved.whitened**2).sum())
    p_value = float(scipy.special.chdtrc(dof, chi2)) if dof > 0 else None
    if p_value is not None and p_value < _MISFIT:
        covariance = covariance * (chi2 / dof)
    earth_open = in_si and latitude is None
    K, K_sd = _sensitivity(coefficients, covariance, vertical_unknown=earth_open)
    offsets = np.zeros((12, 12))
    offsets[:3, :3] = np.diag(covariance[:, 3, 3])
    model = TriadModel(coefficients[3])
    shift = K @ np.array([0.0, 0.0, -STANDARD_GRAVITY])
    return made.fitted(
        model,
        offsets,
        message=f"{len(a)} rests; level, acceleration adds {', '.join(f'{x:.2g}' for x in shift)} {made.unit}",
        n_used=int(poses.gyro_counts.sum()),
        residual_rms=float(np.sqrt(((rates - design @ coefficients) ** 2).mean())),
        condition_number=float(np.linalg.cond(design)),
        warnings=_warnings(p_value, earth_open=earth_open),
        quality={
            **residual_statistics(solved.whitened, dof, 1.0),
            "poses": len(a),
            "attitude_sd_deg_per_min": drift_sd_deg_per_min(model, offsets) if in_si else None,
        },
        native={
            "K": K.tolist(),
            "K_sd": K_sd.tolist(),
            "bias": model.offset.tolist(),
            "offset_level": (model.offset + shift).tolist(),
            "drift_per_s": (coefficients[4] / max(float(np.ptp(middle)), 1e-9)).tolist() if drift else None,
        },
    )


def _warnings(p_value: float | None, *, earth_open: bool) -> Iterator[str]:
    """Warnings of the fit; `p_value` None: as many unknowns as rests."""
    if p_value is None:
        yield "as many unknowns as rests: nothing tests the fit; rest it in more poses"
    elif p_value < _MISFIT:
        yield (
            f"the rests contradict each other (p = {p_value:.1e}): the offset moved meanwhile (temperature), or it was "
            "turned; the sd are widened. Visit the poses again in the opposite order, or fit --drift yes"
        )
    if earth_open:
        yield (
            f"the Earth's rate about the vertical (up to {EARTH_RATE / STANDARD_GRAVITY:.1e} per m/s2) is inside the "
            "diagonal of K: state --latitude"
        )


def _sensitivity(coefficients: Array, covariance: Array, *, vertical_unknown: bool) -> tuple[Array, Array]:
    """K (3, 3), rad/s per m/s2, one row for each axis of the gyroscope, and its standard deviations."""
    K = coefficients[:3].T / STANDARD_GRAVITY
    variance = np.einsum("akk->ak", covariance[:, :3, :3]) / STANDARD_GRAVITY**2
    if vertical_unknown:
        variance = variance + np.eye(3) * (EARTH_RATE / STANDARD_GRAVITY) ** 2 / 3.0
    return K, np.sqrt(variance)
