"""The magnetometer against the gyroscope: in the body the Earth's field obeys ``dm/dt = -w x m`` (METHODS 3.1).

Any motion serves, and no accelerometer is needed. Between two samples of the compass the gyroscope is integrated, not
differentiated. So this is the chain of directions and turns of :mod:`calib.imu.problem`, with samples in place of
poses: ``y_k = b + C^-1 u_k`` and ``u_k+1 = D_k u_k``. It gives the offset; the matrix up to its scale; the rotation
between compass and gyroscope, which no ellipsoid can see; the gyroscope's offset; and the delay of the compass.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any, Unpack

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.fit import FitResult, parameter_names
from mavcal.calib.imu.unknowns import UNKNOWNS, ImuPrior
from mavcal.calib.imu.weighting import groups
from mavcal.calib.mag.blur import deblurred, rates_during
from mavcal.calib.mag.gyro_chain import (
    BIAS_SD,
    FREE_GYRO_MATRIX,
    LONGEST_DELAY,
    Chain,
    ChainSolution,
    rotation_of,
    weak_prior,
)
from mavcal.calib.mag.heading import heading_sd_deg
from mavcal.calib.mag.result import (
    SCALE_UNKNOWN,
    UNDETERMINED_SD,
    CompassFit,
    MagContext,
    MagFacts,
    compass_result,
    with_strength_sd,
)
from mavcal.calib.recording import Array, Channel
from mavcal.calib.stats.norm_fit import symmetric
from mavcal.calib.stats.residuals import residual_statistics
from mavcal.calib.stats.windows import finite_rows, without_spikes
from mavcal.calib.triad import TriadModel

METHOD = "mag-gyro"
MOVEMENT = "turn it about two axes or more, by a right angle and both ways, away from steel"
_LEAST_SAMPLES = 30
_LARGEST = 1e12  # of any unit
_FASTEST = 70.0  # rad/s, 4000 deg/s: no gyroscope of a vehicle measures more
_LEAST_TURN = math.radians(30.0)
_ROUGHEST = 0.15  # of the field: residuals with which nothing is calibrated
_SHRINK = 0.002  # of the field, by averaging while it turns: more is left out


def fit_gyro_aided(
    mag: Channel, gyro: Channel, *, delay: float | None = None, window: float = 0.0, **facts: Unpack[MagFacts]
) -> FitResult:
    """Offset and matrix of a magnetometer in the axes of the gyroscope, from any motion.

    Parameters
    ----------
    mag, gyro
        Samples of the same clock; `gyro` in rad/s. Its offset is estimated; where its scale is off by more than the
        data allow, its matrix is estimated too.
    delay
        How much later than the gyroscope the compass is, s; None: estimated.
    window
        Time over which the compass averages, s (ArduPilot: 0.1); its blur is undone, samples of fast turns left out.
    **facts
        What is known of the magnetometer, :class:`calib.mag.result.MagContext`.

    Returns
    -------
    FitResult
        The matrix rotates the field into the gyroscope's axes. ``native`` has the rotation, the gyroscope's offset and
        the delay. Refused, with the missing movement, where the motion does not determine it.

    Raises
    ------
    InvalidInputError
        If the gyroscope is not in rad/s, or time goes back.
    """
    context = MagContext(**facts)
    _check(mag, gyro, delay)
    made = context.made(METHOD, len(mag), MOVEMENT)
    mag, gyro = (channel.take(finite_rows(channel.values)) for channel in (mag, gyro))
    mag, gyro = (channel.take(without_spikes(channel.values)) for channel in (mag, gyro))
    gyro = gyro.take(np.diff(gyro.t, prepend=-np.inf) > 0.0)
    reason = _unusable(mag, gyro)
    if reason:
        return made.refused(reason)
    sharp = _slow_enough(mag, gyro, window)
    chain = Chain(mag.take(sharp), gyro, context)
    found = chain.solved(delay)
    if found is not None and window > 0.0:
        chain = Chain(_deblurred(chain.mag, gyro, found, window), gyro, context)
        found = chain.refined(found, delay)
    if found is None:
        return made.refused(f"compass and gyroscope do not turn alike by any model: check units and axes; {MOVEMENT}")
    return _verdict(made.n_samples, chain, found, context) or made.refused(*_open(found, context))


def _slow_enough(mag: Channel, gyro: Channel, window: float) -> NDArray[np.bool_]:
    """The compass samples hardly attenuated by averaging while turning; all if these are too few."""
    if window <= 0.0:
        return np.ones(len(mag), dtype=np.bool_)
    sharp = rates_during(mag.t, gyro.t, gyro.values, window).sharp(_SHRINK)
    return sharp if sharp.sum() >= _LEAST_SAMPLES else np.ones(len(mag), dtype=np.bool_)


def _deblurred(mag: Channel, gyro: Channel, found: ChainSolution, window: float) -> Channel:
    """The compass as it would read without averaging, by the model `found`."""
    rates = rates_during(mag.t, gyro.t, gyro.values - found.solution.x[18:21], window)
    model = _model(found.solution.x, found.radius, None)
    return dataclasses.replace(mag, values=deblurred(mag.values, rates, model))


def _model(x: Array, radius: float, strength: float | None) -> TriadModel:
    """The correction into the gyroscope's axes; without a strength the mean radius keeps its length."""
    shape = symmetric(x[3:9])
    length = float(np.linalg.det(shape)) ** (-1.0 / 3.0) if strength is None else strength / radius
    return TriadModel(radius * x[:3], length * rotation_of(x[9:18].reshape(3, 3)).T @ shape)


def _spread(x: Array, covariance: Array, radius: float, strength: float | None) -> Array:
    """Covariance (12, 12) of offset and matrix, by central differences."""

    def numbers(at: Array) -> Array:
        model = _model(at, radius, strength)
        return np.concatenate([model.offset, model.matrix.ravel()])

    step = 1e-6
    J = np.column_stack([(numbers(x + h) - numbers(x - h)) / (2.0 * step) for h in step * np.eye(UNKNOWNS)])
    return np.asarray(J @ covariance @ J.T, dtype=np.float64)


def _relative_sd(found: ChainSolution, prior: ImuPrior | None) -> Array:
    """Standard deviations (12,) of offset and matrix, relative to the field and to one."""
    x = found.solution.x
    return np.sqrt(np.diag(_spread(x, found.covariance(prior), 1.0, None)))


def _open(found: ChainSolution, context: MagContext) -> tuple[str, tuple[str, ...]]:
    """Reason to refuse the whole fit, and the undetermined parameters."""
    rough = float(np.sqrt((_residuals(found) ** 2).mean()))
    if rough > _ROUGHEST:
        return (
            f"the compass is {rough:.0%} of the field away from what the gyroscope says: the field changed while "
            "turning, or their axes or clocks differ",
            parameter_names(),
        )
    scales = np.linalg.norm(found.solution.x[9:18].reshape(3, 3), axis=0)
    if not ((scales > 0.5) & (scales < 2.0)).all():
        factors = ", ".join(f"{1.0 / scale:.3g}" for scale in scales)
        return f"the gyroscope reads {factors} times the rate about x, y, z: check its unit", parameter_names()
    sd = _relative_sd(found, weak_prior(found.solution.x))
    names = tuple(n for n, s in zip(parameter_names(), sd, strict=True) if s > UNDETERMINED_SD)
    listed = ", ".join(names) or "it"
    return (
        f"the motion does not determine {listed} (offset known to {sd[:3].max():.0%} of the field): {MOVEMENT}",
        names,
    )


def _residuals(found: ChainSolution) -> Array:
    """Residuals of the compass (N, 3), relative to the field."""
    return found.solution.at.poses * math.sqrt(found.problem.covariances[0, 0, 0])


def _verdict(n_samples: int, chain: Chain, found: ChainSolution, context: MagContext) -> FitResult | None:
    """The fit; None if nothing of it may be used."""
    if (_relative_sd(found, weak_prior(found.solution.x)) > UNDETERMINED_SD).any():
        return None
    scales = np.linalg.norm(found.solution.x[9:18].reshape(3, 3), axis=0)
    if not ((scales > 0.5) & (scales < 2.0)).all():
        return None
    residuals = _residuals(found)
    if float(np.sqrt((residuals**2).mean())) > _ROUGHEST:
        return None
    x, covariance = found.solution.x, found.covariance()
    model = _model(x, found.radius, context.strength)
    full = _spread(x, covariance, found.radius, context.strength)
    full = with_strength_sd(full, model, context.field)
    return compass_result(
        CompassFit(
            METHOD,
            model,
            full,
            n_samples=n_samples,
            n_used=len(chain.mag),
            message=f"{len(chain.mag)} samples over {chain.mag.t[-1] - chain.mag.t[0]:.0f} s against the gyroscope",
            residual_rms=float(np.sqrt((residuals**2).mean())) * found.radius,
            condition_number=_condition(found),
            quality=_quality(found, context, model, full),
            native=_native(found, covariance),
            warnings=_warnings(found, context),
        ),
        context,
    )


def _quality(found: ChainSolution, context: MagContext, model: TriadModel, full: Array) -> dict[str, Any]:
    samples, turns = groups(found.problem, found.solution)
    noise_known = context.noise_variance is not None
    mean_radius = found.radius * float(np.linalg.det(symmetric(found.solution.x[3:9]))) ** (-1.0 / 3.0)
    strength = mean_radius if context.strength is None else context.strength
    poses = found.solution.at.poses
    return {
        **residual_statistics(poses, max(round(samples.dof), 0), 1.0 if noise_known else None),
        "turns_p_value": turns.p_value,
        "noise_sd": found.noise * found.radius,
        "noise_from": "given" if noise_known else "residuals",
        "variance_inflation": found.inflation,
        "radius": mean_radius,
        "heading_sd_deg": heading_sd_deg(model, full, strength, context.inclination, context.body_from_sensor),
        "heading_dip_deg": math.degrees(context.inclination),
    }


def _native(found: ChainSolution, covariance: Array) -> dict[str, Any]:
    """The rotation between the sensors, and what was learnt of the gyroscope and of the clocks."""
    x = found.solution.x
    G = x[9:18].reshape(3, 3)
    rotation = rotation_of(G).T
    return {
        "gyro_from_mag": rotation.tolist(),
        "rotation_deg": math.degrees(math.acos(float(np.clip((np.trace(rotation) - 1.0) / 2.0, -1.0, 1.0)))),
        "rotation_sd_deg": _rotation_sd_deg(found, covariance),
        "gyro_bias": x[18:21].tolist(),
        "gyro_bias_sd": np.sqrt(np.diag(covariance)[18:21]).tolist(),
        "gyro_matrix": (rotation @ G).tolist() if found.coordinates is FREE_GYRO_MATRIX else None,
        "delay": found.delay,
        "delay_sd": found.delay_sd or None,
    }


def _rotation_sd_deg(found: ChainSolution, covariance: Array) -> float:
    """Standard deviation of the rotation about its worst axis, degrees."""
    G = found.solution.x[9:18].reshape(3, 3)
    # a turn by omega changes G by [omega]x G: omega = vee of the skew part of dG G^-1
    back = np.linalg.inv(G)
    rows = np.zeros((3, 9))
    for axis, (i, j) in enumerate(((2, 1), (0, 2), (1, 0))):
        for k in range(3):
            rows[axis, 3 * i + k] += 0.5 * back[k, j]
            rows[axis, 3 * j + k] -= 0.5 * back[k, i]
    variance = rows @ covariance[9:18, 9:18] @ rows.T
    return math.degrees(math.sqrt(max(float(np.linalg.eigvalsh(variance)[-1]), 0.0)))


def _condition(found: ChainSolution) -> float:
    basis = found.coordinates.tangents(found.solution.x)
    reduced = basis.T @ found.solution.information @ basis
    scale = np.sqrt(np.diag(reduced))
    return float(np.sqrt(np.linalg.cond(reduced / np.outer(scale, scale))))


def _warnings(found: ChainSolution, context: MagContext) -> tuple[str, ...]:
    warnings = []
    if context.strength is None:
        warnings.append(SCALE_UNKNOWN)
    if found.coordinates is FREE_GYRO_MATRIX:
        warnings.append("the gyroscope's scale or axes are off: its matrix was estimated too, calibrate it")
    if np.linalg.norm(found.solution.x[18:21]) > BIAS_SD:
        warnings.append(f"the gyroscope's offset is {np.linalg.norm(found.solution.x[18:21]):.3g} rad/s: rest it first")
    if found.inflation > 2.0:
        warnings.append(
            f"the residuals are correlated in time (variance x {found.inflation:.1f}): blur, currents or steel nearby"
        )
    return tuple(warnings)


def _unusable(mag: Channel, gyro: Channel) -> str:
    """Reason to refuse the fit; empty: there is none."""
    for channel, least in ((mag, _LEAST_SAMPLES), (gyro, 2 * _LEAST_SAMPLES)):
        if len(channel) < least:
            return f"{len(channel)} finite samples of the {channel.sensor}: {least} are needed"
        largest = float(np.abs(channel.values).max())
        if largest > _LARGEST:
            return f"the {channel.sensor} reads up to {largest:.3g} {channel.unit}: that is no measurement"
        if not np.ptp(channel.values, axis=0).all():
            return f"the {channel.sensor} reads one constant value on an axis: it is stuck, or was not turned"
    inside = (mag.t >= gyro.t[0] + LONGEST_DELAY) & (mag.t <= gyro.t[-1])
    if inside.sum() < _LEAST_SAMPLES:
        return (
            f"{int(inside.sum())} samples of the compass lie in the time of the gyroscope: {_LEAST_SAMPLES} are needed"
        )
    fastest = float(np.median(np.linalg.norm(gyro.values, axis=1)))
    if fastest > _FASTEST:
        return f"the gyroscope reads {fastest:.3g} rad/s half of the time: its unit is another (deg/s, counts)"
    steps = np.diff(gyro.t)
    rates = gyro.values[1:] - np.median(gyro.values, axis=0)
    turned = float((np.linalg.norm(rates, axis=1) * steps).sum())
    if turned < _LEAST_TURN:
        return f"it turned by {math.degrees(turned):.0f} degrees in all: {MOVEMENT}"
    return ""


def _check(mag: Channel, gyro: Channel, delay: float | None) -> None:
    if gyro.unit != "rad/s":
        raise InvalidInputError(f"the gyroscope must be in rad/s, not in {gyro.unit}: state --unit-gyro")
    if delay is not None and not abs(delay) <= LONGEST_DELAY:
        raise InvalidInputError(f"the delay of a compass is at most {LONGEST_DELAY} s either way, not {delay}")
    mag.require_ordered()
    gyro.require_ordered()
