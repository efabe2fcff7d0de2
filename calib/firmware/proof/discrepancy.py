"""Discrepancy between the streams and a hypothesis about the parameters in force, with covariance.

Under a hypothesis the stream is undone to raw readings. Two things are known of those:

equality
    the sensor was not touched between the captures before and after the write, so its raw mean is the same; a gyroscope
    at rest reads the same in any attitude;
invariance
    corrected by the fitted model, a sensor at rest reads a vector of known length: an accelerometer g, a gyroscope
    zero, a magnetometer the strength of the field.

Neither needs to know which way the vehicle points.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from mavcal.calib import STANDARD_GRAVITY
from mavcal.calib.firmware.proof.evidence import StillMean
from mavcal.calib.firmware.proof.known_drift import KnownDrift
from mavcal.calib.fit import FitResult
from mavcal.calib.recording import Array, Sensor
from mavcal.calib.triad import TriadModel

Undo = Callable[[Sequence[StillMean]], Array]
"""Corrected readings to raw ones (K, 3), under one hypothesis."""

EARTH_RATE: Final = 7.292115e-5  # rad/s (WGS 84); inside a gyroscope's fitted offset, and different in every attitude
ATTITUDE_SD: Final = np.radians(0.05)
"""Standard deviation of the attitude change of an untouched vehicle between captures, rad: a table that someone leans
on."""
BIAS_WALK: Final = 1.5e-5
"""rad/s per s of gyro bias drift between captures: 0.05 deg/s a minute, the default drift of ArduPilot's simulator."""
MOST_BIAS_WALK: Final = np.radians(0.25)
"""Largest such drift, rad/s: it reverses after five minutes (SIM_DRIFT_TIME)."""
RESTART_S: Final = 30.0
"""Time, s, between the capture before a write and the restart of the vehicle after it."""
STABILITY: Final = {Sensor.ACCEL: 1e-3, Sensor.GYRO: 5e-5, Sensor.MAG: 0.05}
"""Scatter of a resting sensor from one capture to the next beyond its noise: 0.1 mg, 10 deg/h, 0.5 mgauss."""
TEMPERATURE_STEP: Final = 2.0
"""degC within which readings after the write are averaged before they are compared with the one before."""
_UNDETERMINED: Final = 10.0  # sd of a parameter that the fit leaves open, in its unit
_ANY_FIELD: Final = 100.0  # uT, sd of a field strength that is not known


@dataclass(frozen=True, eq=False)
class Expected:
    """The sensor's true correction as fitted, with its covariance."""

    model: TriadModel
    covariance: Array
    """Over offset (3), matrix by rows (9) and the coefficients of the drift (3k)."""
    reference: float | None
    """degC at which the offset stands; None: not known."""
    misfit: float
    """Scatter of the fit's own residuals, in the unit of the stream."""
    magnitude: float | None
    """Length of the true vector; None: constant but not known."""


def expected_of(
    at_rest: FitResult | None, drift: FitResult | None, known: KnownDrift, magnitude: float | None
) -> Expected | None:
    """Expected reading from the fits; None: no fit determines the offset. `known` is the known drift."""
    fit = at_rest if at_rest is not None else drift
    if fit is None:
        return None
    size = len(known.covariance)
    spread = np.zeros((12 + size, 12 + size))
    spread[:12, :12] = fit.covariance[:12, :12]
    spread[:12, :12] += np.diag([_UNDETERMINED**2 * (n in fit.undetermined) for n in fit.names[:12]])
    spread[12:, 12:] = known.covariance
    polynomial, offset, reference = known.polynomial, fit.model.offset, fit.temperature
    if at_rest is None:
        spread[:12, 12:], spread[12:, :12] = fit.covariance[:12, 12:], fit.covariance[12:, :12]
        assert polynomial is not None
        reference = polynomial.t_ref
    elif polynomial is not None and reference is not None:
        offset = offset - polynomial(reference)
    else:
        polynomial = None
    misfit = fit.residual_rms if np.isfinite(fit.residual_rms) else 0.0
    return Expected(TriadModel(offset, fit.model.matrix, polynomial), spread, reference, misfit, magnitude)


def true_magnitude(sensor: Sensor) -> float | None:
    """Magnitude that an ideal sensor reads at rest: gravity, or 0 for a gyroscope; None: not known, as of a field."""
    return {Sensor.ACCEL: STANDARD_GRAVITY, Sensor.GYRO: 0.0}.get(sensor)


@dataclass(frozen=True, eq=False)
class BeforeAfter:
    """Readings of one sensor before (None: not captured) and after the write."""

    sensor: Sensor
    before: StillMean | None
    raw_before: Array | None
    after: tuple[StillMean, ...]
    invariant: tuple[StillMean, ...]
    """Readings after the write that count for invariance (a turning compass adds its samples)."""
    expected: Expected | None
    drift: KnownDrift
    restarted: bool
    """Whether the vehicle was restarted between the captures: its clock then started again."""

    @property
    def equality(self) -> bool:
        """Whether the raw reading before and after can be compared."""
        return self.raw_before is not None and bool(self.after)

    @property
    def lengths(self) -> bool:
        """Whether the magnitude of the readings after the write can be compared with a known one."""
        return self.expected is not None and bool(self.invariant)

    @property
    def weights(self) -> Array:
        """Means of readings after that are compared with the one before, (G, n): one row a temperature.

        A gyroscope at rest may be compared in every rest, anything else only as long as nobody has moved it: in the
        first one.
        """
        first = self.after[0].rest
        usable = [k for k, r in enumerate(self.after) if self.sensor == Sensor.GYRO or r.rest == first]
        groups: dict[int | None, list[int]] = {}
        for k in usable:
            heat = self.after[k].temperature
            groups.setdefault(None if heat is None else round(heat / TEMPERATURE_STEP), []).append(k)
        rows = np.zeros((len(groups), len(self.after)))
        for row, members in zip(rows, groups.values(), strict=True):
            row[members] = 1.0 / len(members)
        return rows

    @property
    def gaps(self) -> Array:
        """Seconds from the capture before to each reading after, (n,)."""
        assert self.before is not None
        since = np.array([r.t for r in self.after])
        return since + RESTART_S if self.restarted else since - self.before.t

    @property
    def zero_rate(self) -> bool:
        """Compare a gyroscope with zero only without an earlier capture: its bias may have changed since the fit."""
        return self.sensor == Sensor.GYRO and self.raw_before is None


def discrepancy(capture: BeforeAfter, undo: Undo, *, equality: bool) -> Array:
    """The vector that is zero, up to its covariance, if the hypothesis behind `undo` is true."""
    parts = []
    if equality and capture.raw_before is not None and capture.before is not None:
        drift = capture.drift.shift(capture.before.temperature, [r.temperature for r in capture.after])
        change = capture.weights @ (undo(capture.after) - drift) - capture.raw_before
        parts.append(change.ravel())
    expected = capture.expected
    if expected is not None and capture.invariant:
        corrected = _corrected(expected, undo(capture.invariant), capture.invariant)
        if capture.sensor != Sensor.GYRO:
            parts.append(np.linalg.norm(corrected, axis=1) - (expected.magnitude or 0.0))
        elif capture.zero_rate:
            parts.append(corrected.mean(axis=0))
    return np.concatenate(parts) if parts else np.zeros(0)


def covariance(capture: BeforeAfter, model: TriadModel, undo: Undo, *, equality: bool) -> Array:
    """Covariance of :func:`discrepancy`, taken where every change is in force (`model`, `undo`)."""
    back = np.asarray(np.linalg.inv(model.matrix), dtype=np.float64)
    blocks = []
    noise: dict[int, Array] = {}
    readings = list(dict.fromkeys((*capture.after, *capture.invariant)))
    for k, reading in enumerate(readings):
        noise[k] = back @ reading.covariance @ back.T
    place = {id(r): k for k, r in enumerate(readings)}
    if equality and capture.before is not None:
        weights = np.zeros((len(capture.weights), len(readings)))
        weights[:, [place[id(r)] for r in capture.after]] = capture.weights
        blocks.append((np.kron(weights, np.eye(3)), _equality_floor(capture, back)))
    if capture.expected is not None and capture.invariant:
        blocks += _invariance_blocks(capture, capture.expected, undo, place)
    rows = np.vstack([row for row, _ in blocks])
    whole = np.zeros((3 * len(readings), 3 * len(readings)))
    for k, block in noise.items():
        whole[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] = block
    result = np.asarray(rows @ whole @ rows.T)
    start = 0
    for row, floor in blocks:
        result[start : start + len(row), start : start + len(row)] += floor
        start += len(row)
    return result


def _equality_floor(capture: BeforeAfter, back: Array) -> Array:
    """Noise of the capture before, and what may change between two captures that nobody touched, (3G, 3G).

    The capture before, an attitude that has crept and a drift are common to all readings after; scatter is not.
    """
    before, weights = capture.before, capture.weights
    assert before is not None
    ones, own = np.ones((len(weights), len(weights))), np.eye(len(weights))
    scatter = STABILITY[capture.sensor] ** 2 * np.eye(3)
    floor = np.kron(ones, back @ before.covariance @ back.T) + np.kron(own, scatter)
    if capture.sensor == Sensor.GYRO:
        walk = np.minimum(BIAS_WALK * (weights @ capture.gaps), MOST_BIAS_WALK)
        floor += np.kron(np.outer(walk, walk) + EARTH_RATE**2 * own, np.eye(3))
    else:
        vector = back @ capture.after[0].mean
        floor += np.kron(ones, ATTITUDE_SD**2 * (vector @ vector * np.eye(3) - np.outer(vector, vector)))
    heat = [r.temperature for r in capture.after]
    floor += capture.drift.uncertainty(before.temperature, heat, weights)
    floor += capture.drift.staleness(heat, [r.temperature_sd for r in capture.after], weights)
    return np.asarray(floor)


def _corrected(expected: Expected, raw: Array, readings: Sequence[StillMean]) -> Array:
    polynomial = expected.model.polynomial
    if polynomial is None:
        return expected.model.apply(raw)
    known = polynomial.t_ref if expected.reference is None else expected.reference
    return expected.model.apply(raw, np.array([known if r.temperature is None else r.temperature for r in readings]))


def _invariance_blocks(
    capture: BeforeAfter, expected: Expected, undo: Undo, place: dict[int, int]
) -> list[tuple[Array, Array]]:
    """Rows over the readings and the floor of the invariance part."""
    if capture.sensor == Sensor.GYRO and not capture.zero_rate:
        return []
    size = 3 * len(place)
    matrix = expected.model.matrix
    rows, jacobian = [], []
    temperatures = [r.temperature for r in capture.invariant]
    by_drift = capture.drift.jacobian(expected.reference, temperatures)
    whole = _corrected(expected, undo(capture.invariant), capture.invariant)
    for reading, corrected, moved in zip(capture.invariant, whole, by_drift, strict=True):
        if capture.sensor == Sensor.GYRO:
            normal = np.eye(3) / len(capture.invariant)
        else:
            normal = corrected[None, :] / np.linalg.norm(corrected)
        row = np.zeros((len(normal), size))
        k = place[id(reading)]
        row[:, 3 * k : 3 * k + 3] = normal @ matrix
        centred = np.linalg.solve(matrix, corrected)
        rows.append(row)
        jacobian.append(np.hstack([-normal @ matrix, np.kron(normal, centred[None, :]), -normal @ matrix @ moved]))
    J = np.sum(jacobian, axis=0) if capture.sensor == Sensor.GYRO else np.vstack(jacobian)
    allowed = float(capture.drift.allowance(expected.reference, temperatures).max())
    unknown = np.array(capture.drift.open_axes) | (expected.reference is None)
    open_axes = J[:, :3][:, unknown]
    floor = J @ expected.covariance @ J.T + allowed**2 * open_axes @ open_axes.T
    stability = STABILITY[capture.sensor] ** 2 + (EARTH_RATE**2 if capture.sensor == Sensor.GYRO else 0.0)
    floor += (expected.misfit**2 * (capture.sensor != Sensor.GYRO) + stability) * np.eye(len(J))
    if expected.magnitude is None:
        floor += _ANY_FIELD**2 * np.ones((len(J), len(J)))
    stacked = np.sum(rows, axis=0) if capture.sensor == Sensor.GYRO else np.vstack(rows)
    return [(stacked, floor)]
