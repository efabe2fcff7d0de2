"""A trajectory re-estimated from a recording: a smoother over gyroscope, accelerometer, GPS velocity and magnetometer.

The smoother estimates the candidate effects too. Gyroscope and accelerometer have biases that may wander and follow the
unit's temperature. The gyroscope has scale and axes, the accelerometer a rotation and scales. The magnetometer has an
offset, soft iron, a field per ampere and a delay. A compass that averages over its period is late by half of it. The
GPS has a delay. Without the compass' delay, turns would distort the field. Gauss-Newton over all nodes at once
(multiple shooting). The error state of a node is attitude (in the body), velocity, gyroscope and accelerometer bias.
The unit's measurements connect neighbours, so the normal equations are banded, bordered by the constants.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from mavcal.calib.gap.reference.bordered import BorderedEquations, Rows
from mavcal.calib.gap.reference.posed import GRAVITY_NED
from mavcal.calib.gap.reference.strapdown import STEPS, Increments, IntervalMotion

Array = NDArray[np.float64]

NODE = 12  # attitude, velocity, gyroscope bias, accelerometer bias
ATTITUDE, VELOCITY, GYRO_BIAS = slice(0, 3), slice(3, 6), slice(6, 9)
"""Indices in the state of a node. Source: the order of :data:`NODE`."""
OFFSET, PER_AMPERE, EARTH = slice(0, 3), slice(3, 6), slice(6, 9)
LATE_GPS, LATE_MAG = 9, 10
SOFT_IRON, GYRO, ACCEL, ACCEL_SCALE = slice(11, 17), slice(17, 26), slice(26, 29), slice(29, 32)
"""Indices of the constants: magnetometer offset, field per ampere, and the Earth's field; delays. Then the
magnetometer's symmetric matrix (xx, yy, zz, xy, xz, yz) and the gyroscope's by rows, both minus the identity. Last the
rotation of the accelerometer, and its scales x y z minus one.
"""
GYRO_DRIFT, ACCEL_DRIFT = slice(32, 38), slice(38, 44)
"""Indices of the thermal drifts: by the temperature (in units of `strapdown.WARMTH_UNIT`) and by its square, x y z of
each."""
CONSTANTS = 44
ITERATIONS = 8
"""Most iterations. Chosen, not measured: it bounds the time; steps become small sooner."""
_HUBER = 3.0
"""Standard deviations beyond which a residual loses weight. Chosen, not measured: one in 370 normal residuals is
larger."""
LEAST_VELOCITY_SD = 0.1
"""Least standard deviation of a velocity, m/s, for unmodelled sample times and motion between nodes. Chosen, not
measured: 10 ms at 1 g."""
LEAST_MAG_SD = 0.5
"""Least standard deviation of a field, uT, for unmodelled firmware filters and motion between nodes. Chosen, not
measured: 1 % of a field of 50 uT."""

WALK = np.repeat([3e-4, 0.02, 1e-5, 3e-4], 3)
"""Prior standard deviations of the walks of a node's state, per root second: rad, m/s, rad/s and m/s2. Source: decision
9 for the gyroscope's bias. The others are chosen, not measured: below what usual inertial units show in flight."""
BIAS: Array = np.repeat([0.05, 0.2], 3)
"""Prior standard deviation of the gyroscope's bias, rad/s, and of the accelerometer's, m/s2. Chosen, not measured: 3
deg/s and 2 % of gravity, larger than calibrated units have."""
TRUTH_SD = np.radians(0.05)
"""Standard deviation of a simulator's attitude, rad, due to the time at which it was written. Chosen, not measured:
0.05 degrees are 0.5 ms at 100 deg/s."""
_UNDETERMINED = 1.0
"""Prior standard deviation of the first attitude, rad, for an undetermined heading without a compass, at rest. Chosen,
not measured: a radian leaves all of it open, and without it the equations have no solution.
"""
_CAUTION = 3.0
"""Factor on the errors of the aiding in the accuracy of the attitude, since they are correlated. Chosen, not measured:
errors of a receiver last for some ten samples, and three is the root of it."""
_LOST = np.repeat([1.0, 10.0], 3)
"""Standard deviation of attitude (rad) and velocity (m/s) over an interval without samples. Chosen, not measured: a
radian and 10 m/s leave all of it open."""
_DRIFT = np.repeat([0.01, 0.003, 0.1, 0.03], 3)
"""Prior standard deviation of drifts with the temperature and with its square, rad/s and m/s2. Chosen, not measured:
several times that of uncalibrated units."""
CONSTANT = np.concatenate([np.repeat([5.0, 1.0, 1.0], 3), [0.15, 0.05], np.full(6, 0.1), np.full(15, 0.03), _DRIFT])
"""Prior standard deviations of the constants; the Earth's field has that of its source. Source: decision 8 for matrices
and rotations. The others are chosen, not measured: larger than calibrated vehicles have."""
_NOTHING, _IMPLAUSIBLE = 1e-6, 5.0
"""Prior standard deviation of a fixed constant, and standard deviations beyond which an estimate is implausible.
Source: decision 8 for the second; the first guards an inverse."""


@dataclass(frozen=True, eq=False)
class Aiding:
    """Measurements relative to the Earth.

    Parameters
    ----------
    velocity_t, velocity : shape (M,), (M, 3)
        Of the GPS, m/s, north-east-down, at the times of its receipt.
    mag_t, mag, current : shape (L,), (L, 3), (L,)
        Of the magnetometer, uT, and the current then, A. L may be 0.
    earth : shape (3,)
        The field expected here, uT, north-east-down.
    earth_sd
        Standard deviation of that field, uT.
    gain_sd
        Prior standard deviation of the magnetometer's mean gain about one; where the field is unknown, the gain is one
        by definition.
    truth_t, truth : shape (J,), J rotations
        Known attitudes from a simulator; None: none.
    """

    velocity_t: Array
    velocity: Array
    mag_t: Array
    mag: Array
    current: Array
    earth: Array
    earth_sd: float = 1.0
    gain_sd: float = 0.1
    truth_t: Array | None = None
    truth: Rotation | None = None


@dataclass(frozen=True, eq=False)
class TrajectoryState:
    """State at the nodes `t` (K + 1,): attitude, velocity, biases (K + 1, 3), constants (44,), noise of the aiding.

    `att_sd` (rad) and `constants_sd` (44,) are standard deviations of attitude and constants, infinite until computed
    by :func:`with_accuracy`. `walk` (12,) are the standard deviations of the random walks of a node's state, per root
    second.
    """

    t: Array
    attitude: Rotation
    velocity: Array
    gyro_bias: Array
    accel_bias: Array
    constants: Array
    velocity_sd: Array
    mag_sd: float
    cost: float = np.inf
    att_sd: float = np.inf
    constants_sd: Array = field(default_factory=lambda: np.full(CONSTANTS, np.inf))
    walk: Array = field(default_factory=lambda: WALK)

    @property
    def earth(self) -> Array:
        """The Earth's field, uT, north-east-down."""
        return self.constants[EARTH]

    @property
    def late_gps(self) -> float:
        """Delay of the GPS, s."""
        return float(self.constants[LATE_GPS])

    @property
    def soft_iron(self) -> Array:
        """Soft-iron matrix of the magnetometer, (3, 3)."""
        xx, yy, zz, xy, xz, yz = self.constants[SOFT_IRON]
        return np.asarray(np.eye(3) + np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))

    @property
    def gyro_matrix(self) -> Array:
        """Scale and misalignment matrix of the gyroscope, (3, 3)."""
        return np.asarray(np.eye(3) + self.constants[GYRO].reshape(3, 3))

    @property
    def plausible(self) -> bool:
        """Whether scales and misalignments are within plausible limits."""
        matrices = slice(SOFT_IRON.start, None)
        return bool((np.abs(self.constants[matrices]) < _IMPLAUSIBLE * CONSTANT[matrices]).all())

    def interval_motion(self, imu: Increments) -> IntervalMotion:
        """Motion between the nodes from the inertial unit, with its errors corrected."""
        turn = Rotation.from_rotvec(self.constants[ACCEL])
        gyro, accel = (
            _drift_regressors(imu) @ self.constants[drift].reshape(2, 3) for drift in (GYRO_DRIFT, ACCEL_DRIFT)
        )
        scale = 1.0 + self.constants[ACCEL_SCALE]
        return imu.integrated(self.gyro_bias[:-1] + gyro, self.accel_bias[:-1] + accel, self.gyro_matrix, turn, scale)


def _drift_regressors(imu: Increments) -> Array:
    """Regressors of the biases, (K, 2): temperature and its square."""
    return np.stack([imu.warmth, imu.warmth**2], axis=1)


def initial_state(t: Array, attitude: Rotation, aiding: Aiding) -> TrajectoryState:
    """Initial state: given attitudes at the nodes `t`, GPS velocity, no errors."""
    velocity = np.column_stack([np.interp(t, aiding.velocity_t, v) for v in aiding.velocity.T])
    constants = _prior_constants(aiding)
    zero = np.zeros((len(t), 3))
    return TrajectoryState(t, attitude, velocity, zero, zero, constants, np.full(3, 0.3), 3.0)


def _prior_constants(aiding: Aiding) -> Array:
    """Prior means of the constants."""
    constants = np.zeros(CONSTANTS)
    constants[EARTH] = aiding.earth
    constants[LATE_GPS] = 0.1
    return constants


def smooth(
    imu: Increments,
    aiding: Aiding,
    state: TrajectoryState,
    iterations: int = ITERATIONS,
    *,
    matrices: bool = False,
    drifts: bool = False,
) -> TrajectoryState:
    """The trajectory of maximum posterior probability, from the initial `state`.

    `matrices` frees scales and misalignments, `drifts` thermal biases; neither with a known attitude, since they would
    absorb errors of the sensor.
    """
    prior = _prior_sd(aiding, matrices=matrices, drifts=drifts)
    for _ in range(iterations):
        normal = _normal_equations(imu, aiding, state, prior)
        state, moved = _updated(state, normal)
        if moved < 5e-5:
            break
    return replace(state, cost=_normal_equations(imu, aiding, state, prior).cost)


def with_accuracy(
    imu: Increments, aiding: Aiding, state: TrajectoryState, *, matrices: bool, drifts: bool
) -> TrajectoryState:
    """`state` with the standard deviations of its attitude and constants; parameters as in :func:`smooth`."""
    prior = _prior_sd(aiding, matrices=matrices, drifts=drifts)
    cautious = replace(state, velocity_sd=_CAUTION * state.velocity_sd, mag_sd=_CAUTION * state.mag_sd)
    att_sd, constants_sd = _standard_deviations(_normal_equations(imu, aiding, cautious, prior))
    return replace(state, att_sd=att_sd, constants_sd=constants_sd)


def log_evidence(
    imu: Increments, aiding: Aiding, state: TrajectoryState, *, matrices: bool = False, drifts: bool = False
) -> float:
    """Log marginal likelihood of all measurements over trajectories (Laplace), up to a constant.

    It compares bias walks, of which a freer one always fits at least as well.
    """
    prior = _prior_sd(aiding, matrices=matrices, drifts=drifts)
    normal = _normal_equations(imu, aiding, state, prior)
    return -0.5 * (normal.cost + normal.log_determinant + 2.0 * float(np.log(prior[normal.free]).sum()))


def _prior_sd(aiding: Aiding, *, matrices: bool, drifts: bool) -> Array:
    """Prior standard deviations of the constants, (44,); beside a known attitude matrices and drifts are not free."""
    sd = CONSTANT.copy()
    sd[EARTH] = aiding.earth_sd
    if not matrices or aiding.truth is not None:
        sd[SOFT_IRON.start : GYRO_DRIFT.start] = _NOTHING
    if not drifts or aiding.truth is not None:
        sd[GYRO_DRIFT.start :] = _NOTHING
    return sd


def _normal_equations(imu: Increments, aiding: Aiding, state: TrajectoryState, sd: Array) -> BorderedEquations:
    normal = BorderedEquations(len(state.t), NODE, CONSTANTS, np.flatnonzero(sd > _NOTHING))
    between = state.interval_motion(imu)
    _add_inertial(normal, imu, between, state)
    _add_velocity(normal, imu.dt, between, aiding, state)
    if len(aiding.mag_t):
        _add_field(normal, imu.dt, between, aiding, state)
    if aiding.truth is not None and aiding.truth_t is not None:
        _add_truth(normal, imu.dt, between, aiding.truth_t, aiding.truth, state)
    prior = 1.0 / BIAS**2
    normal.diagonal[0, range(6, NODE), range(6, NODE)] += prior
    bias = np.concatenate([state.gyro_bias[0], state.accel_bias[0]])
    normal.right[0, 6:] -= prior * bias
    normal.diagonal[0, range(3), range(3)] += 1.0 / _UNDETERMINED**2
    off = _prior_constants(aiding) - state.constants
    normal.corner[range(CONSTANTS), range(CONSTANTS)] += 1.0 / sd**2
    normal.right_constants += off / sd**2
    gain = slice(SOFT_IRON.start, SOFT_IRON.start + 3)
    mean = float(state.constants[gain].mean())
    normal.corner[gain, gain] += 1.0 / (3.0 * aiding.gain_sd) ** 2
    normal.right_constants[gain] -= mean / (3.0 * aiding.gain_sd**2)
    normal.cost += float((prior * bias**2).sum() + ((off / sd) ** 2).sum() + (mean / aiding.gain_sd) ** 2)
    return normal


def _add_inertial(normal: BorderedEquations, imu: Increments, between: IntervalMotion, state: TrajectoryState) -> None:
    """Add the dynamics ``x[k+1] = F x[k] + B c + defect + walk``, with the constants c of the inertial unit."""
    dt = imu.dt
    here, there = state.attitude[:-1], state.attitude[1:]
    matrix = here.as_matrix()
    defect = np.zeros((len(matrix), NODE))
    defect[:, :3] = (there.inv() * here * between.turn).as_rotvec()
    defect[:, 3:6] = state.velocity[:-1] + here.apply(between.velocity) + GRAVITY_NED * dt - state.velocity[1:]
    defect[:, 6:9] = state.gyro_bias[:-1] - state.gyro_bias[1:]
    defect[:, 9:] = state.accel_bias[:-1] - state.accel_bias[1:]
    f = np.tile(np.eye(NODE), (len(matrix), 1, 1))
    f[:, :3, :3] = between.turn.inv().as_matrix()
    f[:, :3, 6:9] = -dt * np.eye(3)
    f[:, 3:6, :3] = -matrix @ _cross(between.velocity)
    f[:, 3:6, 9:] = -dt * matrix
    variance = np.tile(state.walk**2 * dt, (len(matrix), 1))
    variance[:, :6] += np.where(imu.known[:, None], imu.sampling.ravel() ** 2, _LOST**2)
    weight = 1.0 / variance
    weighted = f * weight[:, :, None]
    normal.diagonal[:-1] += weighted.swapaxes(1, 2) @ f
    normal.diagonal[1:, range(NODE), range(NODE)] += weight
    normal.beside -= np.swapaxes(weighted, 1, 2)
    normal.right[:-1] -= (weighted.swapaxes(1, 2) @ defect[:, :, None])[:, :, 0]
    normal.right[1:] += weight * defect
    normal.cost += float((weight * defect**2).sum() - np.log(weight).sum())
    constants = normal.free[normal.free >= GYRO.start]
    if not len(constants):
        return
    b = _by_unit_constants(imu, between, here, there)[:, :, constants - GYRO.start]
    weighted_b = b * weight[:, :, None]
    normal.border[:-1, :, constants] += f.swapaxes(1, 2) @ weighted_b
    normal.border[1:, :, constants] -= weighted_b
    normal.add_constants(constants, b, -defect, weight)


def _by_unit_constants(imu: Increments, between: IntervalMotion, here: Rotation, there: Rotation) -> Array:
    """How the constants of the inertial unit, from `GYRO` on, change the next node's state, (K, 12, 27).

    The gyroscope's matrix acts on the estimated rotation, not on the reading, whose noise would bias the matrix (errors
    in variables, Deming 1943).
    """
    matrix, turned = here.as_matrix(), (here.inv() * there).as_rotvec()
    b = np.zeros((len(matrix), NODE, CONSTANTS))
    for i in range(3):
        b[:, i, GYRO.start + 3 * i : GYRO.start + 3 * i + 3] = -turned
    b[:, 3:6, ACCEL] = matrix @ _cross(between.velocity)
    b[:, 3:6, ACCEL_SCALE] = -matrix * between.velocity[:, None, :]
    for j, power in enumerate(_drift_regressors(imu).T):
        own = slice(3 * j, 3 * j + 3)
        b[:, :3, GYRO_DRIFT][:, :, own] = -imu.dt * power[:, None, None] * np.eye(3)
        b[:, 3:6, ACCEL_DRIFT][:, :, own] = -imu.dt * power[:, None, None] * matrix
    return b[:, :, GYRO.start :]


def _add_velocity(
    normal: BorderedEquations, dt: float, between: IntervalMotion, aiding: Aiding, state: TrajectoryState
) -> None:
    node, since = _node_before(aiding.velocity_t - state.constants[LATE_GPS], state.t)
    here = state.attitude[node]
    acceleration = here.apply(between.velocity[np.minimum(node, len(between.velocity) - 1)]) / dt + GRAVITY_NED
    residual = aiding.velocity - state.velocity[node] - acceleration * since[:, None]
    by_velocity = np.broadcast_to(np.eye(3), (len(node), 3, 3))
    rows = Rows(node, residual, _weights(residual, state.velocity_sd))
    normal.observe(rows, VELOCITY, by_velocity, np.array([LATE_GPS]), -acceleration[:, :, None])
    normal.velocity_residual = residual


def _add_field(
    normal: BorderedEquations, dt: float, between: IntervalMotion, aiding: Aiding, state: TrajectoryState
) -> None:
    node, body_from_ned, rate = _attitudes(aiding.mag_t - state.constants[LATE_MAG], dt, between, state)
    ideal, iron = body_from_ned.apply(state.earth), state.soft_iron
    offset, per_ampere = state.constants[OFFSET], state.constants[PER_AMPERE]
    residual = aiding.mag - ideal @ iron - offset - aiding.current[:, None] * per_ampere
    by_constant = np.zeros((len(node), 3, SOFT_IRON.stop))
    by_constant[:, :, OFFSET] = np.eye(3)
    by_constant[:, :, PER_AMPERE] = np.eye(3) * aiding.current[:, None, None]
    by_constant[:, :, EARTH] = iron @ body_from_ned.as_matrix()
    by_constant[:, :, LATE_MAG] = np.cross(rate, ideal) @ iron
    by_constant[:, range(3), range(SOFT_IRON.start, SOFT_IRON.start + 3)] = ideal
    for k, (i, j) in enumerate(((0, 1), (0, 2), (1, 2)), SOFT_IRON.start + 3):
        by_constant[:, i, k], by_constant[:, j, k] = ideal[:, j], ideal[:, i]
    constants = normal.free[normal.free < SOFT_IRON.stop]
    rows = Rows(node, residual, _weights(residual, np.full(3, state.mag_sd)))
    normal.observe(rows, ATTITUDE, iron @ _cross(ideal), constants, by_constant[:, :, constants])
    normal.mag_residual = residual


def _add_truth(
    normal: BorderedEquations,
    dt: float,
    between: IntervalMotion,
    truth_t: Array,
    truth: Rotation,
    state: TrajectoryState,
) -> None:
    node, body_from_ned, _ = _attitudes(truth_t, dt, between, state)
    residual = (body_from_ned * truth).as_rotvec()
    by_attitude, none = np.broadcast_to(np.eye(3), (len(node), 3, 3)), np.zeros(0, np.intp)
    rows = Rows(node, residual, _weights(residual, np.full(3, TRUTH_SD)))
    normal.observe(rows, ATTITUDE, by_attitude, none, np.zeros((len(node), 3, 0)))


def _attitudes(
    t: Array, dt: float, between: IntervalMotion, state: TrajectoryState
) -> tuple[NDArray[np.intp], Rotation, Array]:
    """The node before each of `t`, the rotation from north-east-down to the body, and the rate in the body."""
    node, since = _node_before(t, state.t)
    interval, step = np.minimum(node, len(between.velocity) - 1), dt / STEPS
    if not between.dense:
        rate = between.turn.as_rotvec()[interval] / dt
        return node, (state.attitude[node] * Rotation.from_rotvec(rate * since[:, None])).inv(), rate
    j = np.clip((since / step).astype(np.intp), 0, STEPS - 1)
    within = np.stack([r.as_quat() for r in between.within])[j, interval]
    rate = between.rate[interval, j]
    turned = Rotation.from_quat(within) * Rotation.from_rotvec(rate * (since - j * step)[:, None])
    return node, (state.attitude[node] * turned).inv(), rate


def _node_before(t: Array, nodes: Array) -> tuple[NDArray[np.intp], Array]:
    """The node before each of `t`, and the time since then."""
    node = np.clip(np.searchsorted(nodes, t, side="right") - 1, 0, len(nodes) - 1)
    return node, t - nodes[node]


def _weights(residual: Array, sd: Array) -> Array:
    """Inverse variances with Huber weights beyond three standard deviations."""
    return np.asarray(np.minimum(1.0, _HUBER * sd / np.maximum(np.abs(residual), 1e-12)) / sd**2)


def _updated(state: TrajectoryState, normal: BorderedEquations) -> tuple[TrajectoryState, float]:
    """The state after the step, with re-estimated noise of the aiding, and the largest change of attitude, rad."""
    nodes, constants = normal.solved(normal.right[:, :, None], normal.right_constants[:, None])
    step = nodes[:, :, 0]
    mag = normal.mag_residual
    new = replace(
        state,
        attitude=state.attitude * Rotation.from_rotvec(step[:, :3]),
        velocity=state.velocity + step[:, 3:6],
        gyro_bias=state.gyro_bias + step[:, 6:9],
        accel_bias=state.accel_bias + step[:, 9:],
        constants=state.constants + constants[:, 0],
        velocity_sd=np.maximum(1.4826 * np.median(np.abs(normal.velocity_residual), axis=0), LEAST_VELOCITY_SD),
        mag_sd=max(1.4826 * float(np.median(np.abs(mag))), LEAST_MAG_SD) if len(mag) else state.mag_sd,
    )
    return new, float(np.abs(step[:, :3]).max())


def _standard_deviations(normal: BorderedEquations) -> tuple[float, Array]:
    """Standard deviations of roll, pitch and yaw, rad, as a median over nodes, and of the constants (44,)."""
    n, free = len(normal.diagonal), normal.free
    nodes = np.linspace(0, n - 1, 8).astype(np.intp)
    right = np.zeros((n, NODE, 24 + len(free)))
    for i, node in enumerate(nodes):
        right[node, range(3), range(3 * i, 3 * i + 3)] = 1.0
    solution, constants = normal.solved(right, np.hstack([np.zeros((CONSTANTS, 24)), np.eye(CONSTANTS)[:, free]]))
    variances = [solution[node, range(3), range(3 * i, 3 * i + 3)] for i, node in enumerate(nodes)]
    constants_sd = np.full(CONSTANTS, _NOTHING)
    constants_sd[free] = np.sqrt(np.diag(constants[free, 24:]))
    return float(np.sqrt(np.median(variances))), constants_sd


def _cross(v: Array) -> Array:
    """Matrices (K, 3, 3) of the vector product with each of `v` (K, 3)."""
    made = np.zeros((len(v), 3, 3))
    made[:, 0, 1], made[:, 0, 2], made[:, 1, 2] = -v[:, 2], v[:, 1], -v[:, 0]
    return np.asarray(made - np.swapaxes(made, 1, 2))
