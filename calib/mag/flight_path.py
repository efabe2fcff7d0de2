"""Attitude over a flight for the compass fit: integrated gyroscope, and the log's attitude.

The log's attitude is never taken as the truth: its heading came from the very compass that is to be calibrated. The
gyroscope propagates the attitude, and the log's attitude only anchors it roughly. Every knot of time has an unknown
small rotation, ``R_true = exp([delta]) R_reference`` (north-east-down). It changes from knot to knot by the gyroscope's
offset, scale and noise.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.geometry import quaternion_product
from mavcal.calib.recording import Array, Channel

ANGLE_WALK = math.radians(0.15)
"""Angle random walk, rad/sqrt(s), of a MEMS gyroscope sampled at 50 Hz or more on a shaking airframe."""
BENT_SD = 0.003
"""Relative error of an angle between two knots, from cross-axis errors without a parameter here."""
BIAS_WALK = 2e-4
"""Random walk of a gyroscope's offset during warm-up, rad/s per sqrt(s): 0.1 deg/s in a minute."""
TILT_SD = math.radians(2.0)
HEADING_SD = math.radians(15.0)
CORRELATION_S = 30.0
"""Size and correlation time of errors of a log's attitude, including a heading from a bad compass."""
_KNOT = 1.0  # s
_MOST_KNOTS = 6000
_PARTS = 5  # times at which the attitude within a sample's averaging is looked at
_GAP = 0.2  # s without a gyroscope over which it is not known how the vehicle turned
_GAP_RATE = 1.0  # rad/s, then
_STEP = 0.05  # s, over which rates are taken from an attitude
_WINDOW = 5.0  # s, over which gyroscope and attitude are compared for a first offset


@dataclass(frozen=True, eq=False)
class Turning:
    """Sources of the motion: a gyroscope, the log's attitude, or both, in body axes."""

    gyro: Channel | None
    attitude: Channel | None

    def span(self) -> tuple[float, float]:
        """First and last time at which the attitude is known."""
        carrier = self.gyro if self.gyro is not None else self.attitude
        if carrier is None:
            raise InvalidInputError("neither a gyroscope nor an attitude says how the vehicle turned")
        return float(carrier.t[0]), float(carrier.t[-1])


@dataclass(frozen=True, eq=False)
class GyroModel:
    """Rate = (1 + scale) * (sample - bias), rad/s, with the offset `bias` (J, 3) at times `t` (J,): it wanders."""

    t: Array
    bias: Array
    scale: Array

    @classmethod
    def steady(cls, bias: Array) -> GyroModel:
        """One offset (3,) throughout."""
        return cls(np.zeros(1), bias[None, :], np.zeros(3))

    def at(self, t: Array) -> Array:
        """The offset (N, 3) at `t` (N,)."""
        return np.column_stack([np.interp(t, self.t, column) for column in self.bias.T])


@dataclass(frozen=True, eq=False)
class Path:
    """The reference attitude at N samples of the compass, and its possible error at J knots.

    `rotations` (N, 3, 3) take the body to north-east-down, the mean over the time that a sample averages; `rates`
    (N, 3) are in rad/s, `bends` (N, 3, 3) the second derivative of the attitude in 1/s2. Sample k lies between the
    knots `left` (N,) and the next, at the fraction `fraction` (N,).

    From knot to knot ``delta`` changes by ``-by_bias @ (error of bias) + by_scale @ (error of scale)``, (J - 1, 3, 3)
    each, and by noise of variance `variance` (J - 1,). The gyroscope's assumed offset is `bias` (J, 3), which wanders
    with the variance `wander` (J - 1,). The log's attitude says ``delta = observed`` (J, 3) with `information` (J, 3),
    the body's axes at the knots being `knot_rotations` (J, 3, 3).
    """

    knots_t: Array

    rotations: Array
    rates: Array
    bends: Array
    left: NDArray[np.intp]
    fraction: Array
    by_bias: Array
    by_scale: Array
    variance: Array
    bias: Array
    wander: Array
    observed: Array
    information: Array
    knot_rotations: Array

    @property
    def knots(self) -> int:
        """Number of knots."""
        return len(self.observed)


def knots_of(start: float, end: float) -> Array:
    """Times (J,) of the knots, J >= 2."""
    count = int(np.clip(math.ceil((end - start) / _KNOT), 1, _MOST_KNOTS))
    return np.linspace(start, end, count + 1)


def make_path(turning: Turning, t: Array, model: GyroModel, start: Array | None, window: float = 0.0) -> Path:
    """The reference at the times `t` (N,), starting at the attitude `start` (3, 3); None: at the log's, or level.

    The compass averages over `window` seconds before each of `t`, which attenuates a swing: by 1.6 % at 1 Hz for
    ArduPilot's tenth of a second. Without a gyroscope the log's attitude itself is the reference.
    """
    knots = knots_of(float(t[0]), float(t[-1]))
    left = np.clip(np.searchsorted(knots, t, side="right") - 1, 0, len(knots) - 2)
    fraction = (t - knots[left]) / np.diff(knots)[left]
    if turning.gyro is None and turning.attitude is not None:
        return _path_of_attitude(turning.attitude, t, window, knots, left, fraction)
    if turning.gyro is None:
        raise InvalidInputError("neither a gyroscope nor an attitude says how the vehicle turned")
    carried = _Integrated(turning.gyro, model)
    turn = _aligned(carried, turning.attitude, start, float(t[0]))
    rotations = np.mean([carried.at(part)[0] for part in _within(t, window)], axis=0)
    rates = carried.at(t)[1]
    knot_rotations = turn @ carried.at(knots)[0]
    by_bias, by_scale, variance = carried.between(knots, turn)
    observed, information = _observed(turning.attitude, knots, knot_rotations)
    bends = carried.at(t + _STEP)[0] - 2.0 * carried.at(t)[0] + carried.at(t - _STEP)[0]
    return Path(
        knots_t=knots,
        rotations=turn @ rotations,
        rates=rates,
        bends=turn @ bends / _STEP**2,
        left=left,
        fraction=fraction,
        by_bias=by_bias,
        by_scale=by_scale,
        variance=variance,
        bias=model.at(knots),
        wander=BIAS_WALK**2 * np.diff(knots),
        observed=observed,
        information=information,
        knot_rotations=knot_rotations,
    )


def _within(t: Array, window: float) -> list[Array]:
    """Times (N,) within the `window` before each of `t`, evenly spread."""
    if window <= 0.0:
        return [t]
    return [t - window * (k + 0.5) / _PARTS for k in range(_PARTS)]


def first_bias(turning: Turning) -> Array:
    """Initial offset (3,) of the gyroscope: against the log's attitude, else while it hardly turns."""
    gyro, attitude = turning.gyro, turning.attitude
    if gyro is None:
        return np.zeros(3)
    if attitude is not None:
        start, end = max(gyro.t[0], attitude.t[0]), min(gyro.t[-1], attitude.t[-1])
        edges = np.linspace(start, end, max(int((end - start) / _WINDOW), 1) + 1)
        seen = Rotation.from_matrix(attitudes(attitude, edges))
        carried = Rotation.from_matrix(_Integrated(gyro, GyroModel.steady(np.zeros(3))).at(edges)[0])
        ours, theirs = carried[:-1].inv() * carried[1:], seen[:-1].inv() * seen[1:]
        differences = (theirs.inv() * ours).as_rotvec() / np.diff(edges)[:, None]
        return np.asarray(np.median(differences, axis=0))
    steps = max(int((gyro.t[-1] - gyro.t[0]) / (0.5 * _WINDOW)), 1)
    parts = [part for part in np.array_split(gyro.values, steps) if len(part) > 1]
    quietest = min(parts, key=lambda part: float(part.std(axis=0).sum()))
    return np.asarray(np.median(quietest, axis=0))


class _Integrated:
    """The gyroscope integrated from its first sample; each sample applies to the time nearest to it."""

    def __init__(self, gyro: Channel, model: GyroModel) -> None:
        self.rates = (gyro.values - model.at(gyro.t)) * (1.0 + model.scale)
        inner = 0.5 * (gyro.t[1:] + gyro.t[:-1])
        self.edges = np.concatenate([gyro.t[:1], inner, gyro.t[-1:]])
        self.t = gyro.t
        steps = Rotation.from_rotvec(self.rates * np.diff(self.edges)[:, None]).as_quat()
        self.before = np.vstack([[0.0, 0.0, 0.0, 1.0], _prefix_products(steps)[:-1]])

    def at(self, t: Array) -> tuple[Array, Array]:
        """Attitudes (N, 3, 3) from the first body axes, and rates (N, 3)."""
        i = np.clip(np.searchsorted(self.edges, t, side="right") - 1, 0, len(self.rates) - 1)
        within = Rotation.from_rotvec(self.rates[i] * (t - self.edges[i])[:, None])
        return np.asarray((Rotation.from_quat(self.before[i]) * within).as_matrix()), self.rates[i]

    def between(self, knots: Array, turn: Array) -> tuple[Array, Array, Array]:
        """Sensitivities to offset and scale (J - 1, 3, 3), and the variance of the noise (J - 1,)."""
        steps = np.diff(self.edges)
        middle = turn @ np.asarray(Rotation.from_quat(self.before).as_matrix())
        integral = np.cumsum(np.vstack([np.zeros((1, 9)), (middle * steps[:, None, None]).reshape(-1, 9)]), axis=0)
        turned = middle * (self.rates * steps[:, None])[:, None, :]
        angle = np.cumsum(np.vstack([np.zeros((1, 9)), turned.reshape(-1, 9)]), axis=0)
        swept = np.cumsum(np.append(0.0, np.linalg.norm(self.rates, axis=1) * steps))
        lost = np.cumsum(np.append(0.0, (_GAP_RATE * np.maximum(np.diff(self.t) - _GAP, 0.0)) ** 2))

        def over(edges: Array, values: Array) -> Array:
            columns = values.reshape(len(edges), -1).T
            return np.diff(np.column_stack([np.interp(knots, edges, column) for column in columns]), axis=0)

        by_bias = over(self.edges, integral).reshape(-1, 3, 3)
        by_scale = over(self.edges, angle).reshape(-1, 3, 3)
        walk = ANGLE_WALK**2 * np.diff(knots)
        bent = (BENT_SD * over(self.edges, swept)[:, 0]) ** 2
        return by_bias, by_scale, walk + bent + over(self.t, lost)[:, 0]


def _prefix_products(q: Array) -> Array:
    """``q[0] q[1] ... q[i]`` of quaternions x y z w (N, 4), by doubling."""
    product, reach = q.T.copy(), 1
    while reach < len(q):
        product = np.hstack([product[:, :reach], quaternion_product(product[:, :-reach], product[:, reach:])])
        reach *= 2
    return np.asarray((product / np.linalg.norm(product, axis=0)).T)


def _aligned(carried: _Integrated, attitude: Channel | None, start: Array | None, begin: float) -> Array:
    """The rotation (3, 3) that takes the first body axes of the gyroscope to north-east-down."""
    if start is not None:
        return np.asarray(start @ carried.at(np.array([begin]))[0][0].T)
    if attitude is None:
        return np.asarray(carried.at(np.array([begin]))[0][0].T)
    inside = attitude.take((attitude.t >= carried.t[0]) & (attitude.t <= carried.t[-1]))
    logged = Rotation.from_quat(inside.values, scalar_first=True).as_matrix()
    both = np.einsum("nij,nkj->ik", logged, carried.at(inside.t)[0])
    u, _, vt = np.linalg.svd(both)
    return np.asarray(u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt)


def attitudes(attitude: Channel, t: Array) -> Array:
    """The log's attitude (N, 3, 3) at `t` (N,), held beyond its ends."""
    track = Slerp(attitude.t, Rotation.from_quat(attitude.values, scalar_first=True))
    return np.asarray(track(np.clip(t, attitude.t[0], attitude.t[-1])).as_matrix())


def _information(knots: Array) -> Array:
    """Information on the log's attitude at every knot (J, 3): errors that last `CORRELATION_S` count once."""
    step = float(knots[1] - knots[0])
    spread = max(2.0 * CORRELATION_S / step, 1.0)
    return np.tile(1.0 / (spread * np.array([TILT_SD, TILT_SD, HEADING_SD]) ** 2), (len(knots), 1))


def _observed(attitude: Channel | None, knots: Array, reference: Array) -> tuple[Array, Array]:
    if attitude is None:
        return np.zeros((len(knots), 3)), np.zeros((len(knots), 3))
    difference = attitudes(attitude, knots) @ np.swapaxes(reference, 1, 2)
    seen = (knots >= attitude.t[0]) & (knots <= attitude.t[-1])
    return Rotation.from_matrix(difference).as_rotvec(), _information(knots) * seen[:, None]


def _path_of_attitude(
    attitude: Channel, t: Array, window: float, knots: Array, left: NDArray[np.intp], fraction: Array
) -> Path:
    rotations = np.mean([attitudes(attitude, part) for part in _within(t, window)], axis=0)
    before, after = attitudes(attitude, t - _STEP), attitudes(attitude, t + _STEP)
    rates = Rotation.from_matrix(np.swapaxes(before, 1, 2) @ after).as_rotvec() / (2.0 * _STEP)
    bends = attitudes(attitude, t + _STEP) - 2.0 * attitudes(attitude, t) + attitudes(attitude, t - _STEP)
    count = len(knots)
    return Path(
        knots_t=knots,
        rotations=rotations,
        rates=rates,
        bends=bends / _STEP**2,
        left=left,
        fraction=fraction,
        by_bias=np.zeros((count - 1, 3, 3)),
        by_scale=np.zeros((count - 1, 3, 3)),
        variance=2.0 * HEADING_SD**2 / CORRELATION_S * np.diff(knots),
        bias=np.zeros((count, 3)),
        wander=BIAS_WALK**2 * np.diff(knots),
        observed=np.zeros((count, 3)),
        information=_information(knots),
        knot_rotations=attitudes(attitude, knots),
    )
