"""Gauss-Helmert fit of a magnetometer to the vertical: both observations carry noise (METHODS 3.2).

The iteration starts from one linear system, or from an ellipsoid and the rotation that it leaves open.

Two conditions hold for every sample y of the field and its unit vector g down: ``|B (y - b)| = 1`` and ``g . B (y - b)
= sin(dip)``. The thirteen unknowns are B, b and sin(dip). Each round linearises at observations that are projected back
onto the conditions. This keeps the noise of y and g from biasing the answer.

The delay of the magnetometer behind the accelerometer is one more unknown of the likelihood (METHODS 3.5). A rate of 1
rad/s turns ten milliseconds into 0.6 degrees, and a steady turn makes that look like a mounting angle.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from mavcal.calib.errors import UndeterminedError
from mavcal.calib.fit import FitStatus, parameter_names
from mavcal.calib.mag.ellipsoid import fit_ellipsoid
from mavcal.calib.mag.orientation import RIGHT_ANGLES, interpolated

Array = NDArray[np.float64]

N_UNKNOWNS = 13
"""B by rows, b, sin(dip)."""

STEEPEST = 0.05
"""Cosine of the dip below which the field shows no rotation about itself."""

_INVISIBLE = 3.0  # noises below which the horizontal field is not seen
_START_ROUNDS = 8
_ROUNDS = 40
_CLOSE = 0.01  # standard deviations, of a step that is the last: what is left then is smaller by the noise
_FIRST_NOISE = 0.02
_LEAST_NOISE = 1e-9
_BOUND = 1e3  # of the unknowns, whose order is 1: beyond it the iteration runs away
_MOVES = 0.02  # rad/s, rms: slower turns do not show a lag
_LOUD = 0.05  # of the square of the turning, the noise in it: more would shrink the lag
_WIDEST = 16  # samples to either side that a turn is taken over
_LONGEST_LAG = 1.0  # s: a lag that is open by more is no lag


@dataclass(frozen=True, eq=False)
class AlignmentNoise:
    """Standard deviations: of one axis of the field over its strength, and of the vertical, rad."""

    field: float
    vertical: float


@dataclass(frozen=True, eq=False)
class AlignmentSolution:
    """End of the iteration, in units of the scaled samples."""

    unknowns: Array
    """(13,)."""
    information: Array
    """(13, 13)."""
    rows: Array
    """(N, 2, 13): derivatives of the whitened residuals."""
    residuals: Array
    """(N, 2): whitened residuals of the conditions."""
    noise: AlignmentNoise
    corrected: Array
    """(N, 3): ``B (y - b)`` of the projected observations."""
    sine_weight: Array
    """(N,): one over the standard deviation of the second condition given the first."""

    @property
    def matrix(self) -> Array:
        """B (3, 3)."""
        return self.unknowns[:9].reshape(3, 3)


def align(
    field: Array, down: Array, start: Array, noise: AlignmentNoise | None, least: AlignmentNoise
) -> AlignmentSolution:
    """The maximum of the likelihood of `field` (N, 3), of the order of 1, and unit vectors `down` (N, 3).

    Parameters
    ----------
    field, down
        Observations at the same times.
    start : shape (13,)
        Unknowns to begin with.
    noise
        None: estimated from the residuals of both conditions.
    least
        Lower limit of the noise: that of quantisation.

    Raises
    ------
    UndeterminedError
        If the iteration does not come to an end.
    """
    state = _State(start, field, down)
    now = noise or AlignmentNoise(_FIRST_NOISE, _FIRST_NOISE)
    for _ in range(_ROUNDS):
        linear = _linearised(state, field, down, now)
        if noise is None:
            now = _estimated(linear, least)
            linear = replace(linear, noise=now)
        rows, residuals = linear.rows(), linear.whitening(linear.misclosure)
        flat = rows.reshape(-1, N_UNKNOWNS)
        information = flat.T @ flat
        scale = np.sqrt(np.maximum(np.diag(information), 1e-300))
        values, vectors = np.linalg.eigh(information / np.outer(scale, scale))
        if not values[0] > 1e-13:
            raise UndeterminedError("the samples leave part of the magnetometer's matrix open")
        step = -(vectors @ ((vectors.T @ (flat.T @ residuals.ravel() / scale)) / values)) / scale
        state = linear.projected(step, now)
        if not np.abs(state.unknowns).max() < _BOUND:
            break
        if (np.abs(step) <= _CLOSE / scale).all():
            bias = flat.T @ linear.whitening(linear.curvature_bias()).ravel()
            step += vectors @ ((vectors.T @ (bias / scale)) / values) / scale
            left = residuals + rows @ step
            weight = 1.0 / np.sqrt(linear.conditional)
            unknowns = linear.state.unknowns + step
            return AlignmentSolution(unknowns, information, rows, left, now, linear.corrected, weight)
    raise UndeterminedError("the field and the vertical do not fit each other: the iteration came to no end")


def misclosures(unknowns: Array, field: Array, down: Array) -> Array:
    """Misclosures (N, 2) of the two conditions, on the sphere and at the dip, for `field` and `down` as measured."""
    w = (field - unknowns[9:12]) @ unknowns[:9].reshape(3, 3).T
    return np.stack([np.sqrt(_dot(w, w)) - 1.0, _dot(down, w) - unknowns[12]], axis=1)


@dataclass(frozen=True, eq=False)
class _State:
    """Unknowns and projected observations."""

    unknowns: Array
    field: Array
    down: Array


@dataclass(frozen=True, eq=False)
class _Linear:
    """Both conditions of every sample, linearised about a state, and the terms of their variances."""

    state: _State
    observed: _State
    misclosure: Array  # (N, 2)
    from_offset: Array  # (N, 3): y - b
    directions: tuple[Array, Array]  # (N, 3) each: B (y - b) of length one, and down; the conditions' own directions
    by_field: Array  # (N, 2, 3)
    across: Array  # (N, 3): derivative of the second condition by the vertical
    corrected: Array  # (N, 3)
    products: Array  # (N, 3): by_field times itself: 11, 12, 22
    noise: AlignmentNoise

    @cached_property
    def variance(self) -> tuple[Array, Array, Array]:
        """Covariance of the two conditions: 11, 12, 22."""
        field = self.noise.field**2
        second = field * self.products[:, 2] + self.noise.vertical**2 * _dot(self.across, self.across)
        return field * self.products[:, 0], field * self.products[:, 1], second

    @cached_property
    def conditional(self) -> Array:
        """Variance (N,) of the second condition given the first."""
        first, both, second = self.variance
        return np.asarray(second - both**2 / first)

    def rows(self) -> Array:
        """Derivatives (N, 2, 13) of the whitened conditions: ``c d^T`` by B, ``-B^T c`` by b, for direction c."""
        first, both, _ = self.variance
        share, own, other = (both / first)[:, None], 1.0 / np.sqrt(first), 1.0 / np.sqrt(self.conditional)
        (u, g), f = self.directions, self.by_field
        d = self.from_offset[:, None, :]
        rows = np.empty((len(d), 2, N_UNKNOWNS))
        rows[:, 0, :9] = ((u * own[:, None])[:, :, None] * d).reshape(-1, 9)
        rows[:, 1, :9] = (((g - share * u) * other[:, None])[:, :, None] * d).reshape(-1, 9)
        rows[:, 0, 9:12] = -f[:, 0] * own[:, None]
        rows[:, 1, 9:12] = (share * f[:, 0] - f[:, 1]) * other[:, None]
        rows[:, 0, 12], rows[:, 1, 12] = 0.0, -other
        return rows

    def whitening(self, pairs: Array) -> Array:
        """`pairs` (N, 2) of the two conditions, whitened."""
        first, both, _ = self.variance
        white = np.empty_like(pairs)
        white[:, 0] = pairs[:, 0] / np.sqrt(first)
        white[:, 1] = (pairs[:, 1] - both / first * pairs[:, 0]) / np.sqrt(self.conditional)
        return white

    def moved(self, step: Array) -> Array:
        """The misclosures (N, 2) after `step` of the unknowns."""
        turned = self.from_offset @ step[:9].reshape(3, 3).T
        change = np.stack([_dot(c, turned) for c in self.directions], axis=1) - self.by_field @ step[9:12]
        change[:, 1] -= step[12]
        return np.asarray(self.misclosure + change)

    def curvature_bias(self) -> Array:
        """Expectation (N, 2) of the misclosures at the true unknowns: ``tr(F'' S) / 2``, to the second order.

        S is the noise that the projection leaves in the observations, ``S = Q - Q F^T (F Q F^T)^-1 F Q``. For
        ``|w|``, ``F'' = B^T (1 - u u^T) B / |w|``; for ``g . w`` it is B across field and vertical, and ``-g . w`` for
        the vertical itself, which stays of length one.
        """
        first, both, second = self.variance
        determinant = first * second - both**2
        inverse = np.stack([second, -both, first], axis=1) / determinant[:, None]
        B = self.state.unknowns[:9].reshape(3, 3)
        length = np.sqrt(_dot(self.corrected, self.corrected))
        u = self.corrected / length[:, None]
        f, s = self.by_field[:, 0], self.by_field[:, 1]
        turned_f, turned_s = f @ B.T, s @ B.T
        along_f, along_s = _dot(u, turned_f), _dot(u, turned_s)
        field, vertical = self.noise.field**2, self.noise.vertical**2
        ff = _dot(turned_f, turned_f) - along_f**2
        fs = _dot(turned_f, turned_s) - along_f * along_s
        ss = _dot(turned_s, turned_s) - along_s**2
        removed = inverse[:, 0] * ff + 2.0 * inverse[:, 1] * fs + inverse[:, 2] * ss
        trace = float((B**2).sum()) - _dot(f, f)
        of_length = 0.5 * (field * trace - field**2 * removed) / length
        q_f, q_s = _dot(self.across, turned_f), _dot(self.across, turned_s)
        crossed = -field * vertical * (inverse[:, 1] * q_f + inverse[:, 2] * q_s)
        sphere = 2.0 * vertical - vertical**2 * inverse[:, 2] * _dot(self.across, self.across)
        down = self.state.down
        of_sine = crossed - 0.5 * _dot(down, self.corrected) * sphere
        return np.stack([of_length, of_sine], axis=1)

    def projected(self, step: Array, noise: AlignmentNoise) -> _State:
        """The next state: unknowns moved by `step`, observations projected onto the conditions."""
        left = self.moved(step)
        first, both, second = self.variance
        determinant = first * second - both**2
        pull = np.empty_like(left)
        pull[:, 0] = (second * left[:, 0] - both * left[:, 1]) / determinant
        pull[:, 1] = (first * left[:, 1] - both * left[:, 0]) / determinant
        field = self.observed.field - noise.field**2 * np.einsum("nk,nki->ni", pull, self.by_field)
        down = self.observed.down - noise.vertical**2 * pull[:, 1, None] * self.across
        down = down / np.sqrt(_dot(down, down))[:, None]
        return _State(self.state.unknowns + step, field, down)


def _dot(a: Array, b: Array) -> Array:
    """Product of the rows of `a` and `b` (N, 3): faster than a sum over so short an axis."""
    return np.asarray(np.einsum("ij,ij->i", a, b))


def _linearised(state: _State, field: Array, down: Array, noise: AlignmentNoise) -> _Linear:
    B, b, sine = state.unknowns[:9].reshape(3, 3), state.unknowns[9:12], state.unknowns[12]
    d = state.field - b
    w = d @ B.T
    length = np.sqrt(_dot(w, w))
    u = w / length[:, None]
    g = state.down
    along = _dot(g, w)
    by_field = np.stack([u @ B, g @ B], axis=1)
    across = w - along[:, None] * g
    moved = field - state.field
    misclosure = np.stack([length - 1.0, along - sine], axis=1) + np.einsum("nki,ni->nk", by_field, moved)
    misclosure[:, 1] += _dot(across, down - g)
    f, s = by_field[:, 0], by_field[:, 1]
    products = np.stack([_dot(f, f), _dot(f, s), _dot(s, s)], axis=1)
    observed = _State(state.unknowns, field, down)
    return _Linear(state, observed, misclosure, d, (u, g), by_field, across, w, products, noise)


def _estimated(linear: _Linear, least: AlignmentNoise) -> AlignmentNoise:
    """Noise of the field, from the first condition alone, and of the vertical, from the rest of the second.

    The first condition determines nine of the unknowns, the second alone four.
    """
    first, both, second = linear.products.T
    of_field = float((linear.misclosure[:, 0] ** 2 / first).sum()) / max(len(first) - 9, 1)
    of_field = max(of_field, least.field**2, _LEAST_NOISE**2)
    share = both / first
    rest = (linear.misclosure[:, 1] - share * linear.misclosure[:, 0]) ** 2
    explained = of_field * (second - share * both)
    gain = _dot(linear.across, linear.across)
    squares = float((rest * len(rest) / max(len(rest) - 4, 1) - explained).sum()) / max(float(gain.sum()), 1e-12)
    return AlignmentNoise(float(np.sqrt(of_field)), float(np.sqrt(max(squares, least.vertical**2, _LEAST_NOISE**2))))


def check_dip(sine: float, noise: float) -> float:
    """The cosine of the dip, if a rotation about the vertical can be seen with `noise` (of the field, and rad).

    Raises
    ------
    UndeterminedError
        Naming the place.
    """
    cosine = math.sqrt(max(1.0 - sine**2, 0.0))
    if cosine < max(STEEPEST, _INVISIBLE * noise):
        raise UndeterminedError(
            f"the field is within {math.degrees(math.asin(cosine)):.1f} deg of the vertical here: a rotation about it "
            "does not show",
            missing=parameter_names()[3:],
            remedy="calibrate farther from the magnetic pole; mag-ellipsoid finds offset and soft iron anywhere",
        )
    return cosine


def linear_start(field: Array, down: Array) -> Array:
    """Unknowns (13,) from the second condition alone, which is linear in ``B, B b, sin(dip)`` but for their scale.

    Raises
    ------
    UndeterminedError
        If it leaves more than the scale undetermined.
    """
    rows = np.empty((len(field), N_UNKNOWNS))
    rows[:, :9] = (down[:, :, None] * field[:, None, :]).reshape(-1, 9)
    rows[:, 9:12], rows[:, 12] = -down, -1.0
    vectors = np.linalg.eigh(rows.T @ rows)[1]
    solution = vectors[:, 0]
    B = solution[:9].reshape(3, 3)
    if not np.linalg.cond(B) < 50.0:
        raise UndeterminedError("the vertical does not determine the magnetometer's matrix")
    b = np.linalg.solve(B, solution[9:12])
    size = float(np.linalg.norm((field - b) @ B.T, axis=1).mean()) * float(np.sign(np.linalg.det(B)))
    return np.concatenate([(B / size).ravel(), b, solution[12:] / size])


def two_stage_start(field: Array, down: Array, scale: float) -> Array:
    """Unknowns (13,) from the ellipsoid of `field`, outliers withstood, and the rotation that fits `down` to it.

    `scale` is the unit of `field` in that of the samples, in which messages are worded.

    Raises
    ------
    UndeterminedError
        If the movement does not determine the ellipsoid, or the field is vertical.
    """
    ellipsoid = fit_ellipsoid(scale * field)
    if ellipsoid.status == FitStatus.REFUSED:
        raise UndeterminedError(ellipsoid.message, missing=ellipsoid.undetermined)
    b, radius = ellipsoid.model.offset / scale, float(ellipsoid.native["expmfs"])
    shape = ellipsoid.model.matrix * scale / radius
    w = (field - b) @ shape.T
    noise = ellipsoid.residual_rms / radius
    fits = [_median_misfit(down, w @ turn.matrix.T) for turn in RIGHT_ANGLES]
    Q = RIGHT_ANGLES[int(np.argmin([misfit for misfit, _ in fits]))].matrix
    misfit, sine = min(fits)
    check_dip(min(abs(sine) + misfit, 1.0), noise)
    for _ in range(_START_ROUNDS):
        turned = w @ Q.T
        along = (down * turned).sum(axis=1)
        right = sine - along
        close = np.abs(right) <= 4.0 * np.median(np.abs(right)) + 1e-9
        rows = np.column_stack([np.cross(turned, down), -np.ones(len(w))])[close]
        step = np.linalg.lstsq(rows, right[close], rcond=1e-6)[0]
        Q, sine = Rotation.from_rotvec(step[:3]).as_matrix() @ Q, sine + float(step[3])
    check_dip(min(abs(sine), 1.0), noise)
    return np.concatenate([(Q @ shape).ravel(), b, [sine]])


def _median_misfit(down: Array, field: Array) -> tuple[float, float]:
    """Spread of ``g . m``, and its mean."""
    along = (down * field).sum(axis=1)
    sine = float(np.median(along))
    return float(np.median(np.abs(along - sine))), sine


@dataclass(frozen=True, eq=False)
class FieldLag:
    """Delay of the field behind the vertical, s, with its derivatives."""

    value: float
    sd: float
    column: Array
    """(N, 2): derivatives of the whitened residuals."""


def turning_of(at: Array, force: Array, gyro_t: Array | None, gyro: Array | None) -> Array | None:
    """Rate of change (N, 3) of the unit vector down at the times `at`, 1/s; None: it hardly turns, or cannot be told.

    With rates `gyro` (K, 3), rad/s, at the times `gyro_t` (K,) it is ``dg/dt = g x w``. Without, it is the difference
    of its neighbours, as near as noise allows.
    """
    down = -force / np.maximum(np.sqrt(np.einsum("ij,ij->i", force, force)), 1e-12)[:, None]
    if gyro is not None and gyro_t is not None and len(gyro) > 1:
        rate = np.cross(down, interpolated(at, gyro_t, gyro))
        return rate if np.vdot(rate, rate) > len(rate) * _MOVES**2 else None
    reach = 1
    while 2 * reach + 1 < len(at) and reach <= _WIDEST:
        rate, noise = _difference(at, down, reach)
        power = float(np.vdot(rate, rate)) / len(rate)
        if noise < _LOUD * power and power - noise > _MOVES**2:
            return rate
        reach *= 2
    return None


def _difference(at: Array, down: Array, reach: int) -> tuple[Array, float]:
    """Central difference over `reach` samples to either side, zero at the ends, and the noise in its mean square.

    The noise of the vertical shows in its third differences; a smooth turn adds little to them.
    """
    rate = np.zeros_like(down)
    span = at[2 * reach :] - at[: -2 * reach]
    usable = span > 0.0
    middle = rate[reach:-reach]
    middle[usable] = (down[2 * reach :] - down[: -2 * reach])[usable] / span[usable, None]
    third = np.diff(down, n=3, axis=0)
    variance = float(np.vdot(third, third)) / len(third) / 20.0 if len(third) else np.inf
    typical = float(np.median(span))
    return rate, 2.0 * variance / typical**2 if typical > 0.0 else np.inf


def lag_of(alignment: AlignmentSolution, turning: Array) -> FieldLag | None:
    """The lag that one more Gauss-Newton step gives to `alignment`, whose vertical turns by `turning` (N, 3).

    The field of ``t`` belongs to the vertical of ``t - lag``, so the second condition changes by ``-dg/dt . B (y - b)``
    a second. None: the movement does not show it.
    """
    column = np.zeros_like(alignment.residuals)
    column[:, 1] = -(turning * alignment.corrected).sum(axis=1) * alignment.sine_weight
    rows = np.concatenate([alignment.rows, column[:, :, None]], axis=2).reshape(-1, alignment.rows.shape[2] + 1)
    size = np.sqrt((rows**2).sum(axis=0))
    if not size[-1] > 0.0:
        return None
    normal = (rows.T @ rows) / np.outer(size, size)
    if not np.linalg.cond(normal) < 1e13:
        return None
    inverse = np.linalg.inv(normal)
    step = -(inverse @ (rows.T @ alignment.residuals.ravel() / size)) / size
    sd = float(np.sqrt(inverse[-1, -1]) / size[-1])
    return FieldLag(float(step[-1]), sd, column) if sd < _LONGEST_LAG else None
