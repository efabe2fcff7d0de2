"""Integrated gyroscope rotation between poses, with its derivatives by the gyroscope's model.

In the body the direction u of gravity obeys ``du/dt = -w x u``. The model G, b turns the samples m into the rate ``w =
G (m - b)``. Each sample holds for the time nearest to it, over which the rate is taken as constant. The step is then
exactly a rotation (Rodrigues). Steps are multiplied in chunks side by side, so that forty movements cost no more calls
than one.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_CHUNK = 64  # at most, samples multiplied in a row; all chunks go side by side


@dataclass(frozen=True, eq=False)
class Moves:
    """The gyroscope's samples between the poses, cut into chunks that no two movements share.

    `rates` (c, n, 3) in sensor units about `origin` (3,), `steps` (c, n) in seconds, zero where a chunk has ended;
    `first` (k + 1,) says at which chunk each of the k movements begins, `durations` (k,) what it lasts.
    """

    rates: Array
    steps: Array
    first: NDArray[np.intp]
    origin: Array
    durations: Array

    def __len__(self) -> int:
        return len(self.durations)

    @classmethod
    def of(cls, t: Array, values: Array, spans: Array, origin: Array) -> Moves:
        """The movements in `spans` (k, 2) of the samples `values` (N, 3) at `t` (N,); N is at least two."""
        edges = np.concatenate([[-np.inf], 0.5 * (t[1:] + t[:-1]), [np.inf]])
        begins = np.maximum(np.searchsorted(edges, spans[:, 0], side="right") - 1, 0)
        ends = np.searchsorted(edges, spans[:, 1])
        width = int(np.clip((ends - begins).max(initial=2), 2, _CHUNK))
        width += width % 2
        counts = -(-(ends - begins) // width)
        first = np.concatenate([[0], np.cumsum(counts)]).astype(np.intp)
        move = np.repeat(np.arange(len(spans)), counts)
        within = np.arange(first[-1]) - first[move]
        rows = (begins[move] + width * within)[:, None] + np.arange(width)
        inside = rows < ends[move][:, None]
        rows = np.where(inside, rows, 0)
        step = np.minimum(edges[rows + 1], spans[move, 1:]) - np.maximum(edges[rows], spans[move, :1])
        return cls(
            rates=(values[rows] - origin) * inside[..., None],
            steps=np.where(inside, step, 0.0),
            first=first,
            origin=origin,
            durations=spans[:, 1] - spans[:, 0],
        )

    def take(self, which: NDArray[np.intp]) -> Moves:
        """Only the movements `which`."""
        counts = np.diff(self.first)[which]
        chunks = np.concatenate([np.arange(self.first[k], self.first[k + 1]) for k in which] or [np.zeros(0, np.intp)])
        first = np.concatenate([[0], np.cumsum(counts)]).astype(np.intp)
        return Moves(self.rates[chunks], self.steps[chunks], first, self.origin, self.durations[which])

    def thinned(self) -> Moves:
        """The same movements with every second sample, as at half the sample rate."""
        return dataclasses.replace(self, rates=self.rates[:, ::2], steps=self.steps[:, ::2] + self.steps[:, 1::2])

    @property
    def mean_step(self) -> float:
        """Mean time for which a sample holds, s."""
        return float(self.steps.sum() / max(np.count_nonzero(self.steps), 1))


@dataclass(frozen=True, eq=False)
class Turns:
    """Rotations of the body in the movements, by one model of the gyroscope.

    `rotations` (k, 3, 3): ``u_after = D u_before``. `sensitivity` (k, 3, 12): a change of the model (nine entries of G
    by rows, then b) turns ``D u`` by ``-psi x D u`` with ``psi = sensitivity @ change``. `noise` (k, 3, 3) is the
    covariance of psi by the white noise of the samples.
    """

    rotations: Array
    sensitivity: Array
    noise: Array


def integrate(moves: Moves, matrix: Array, offset: Array, density: Array) -> Turns:
    """Integrate every movement.

    Parameters
    ----------
    moves
        The samples between the poses.
    matrix, offset : shape (3, 3) and (3,)
        Rate = matrix @ (sample - offset), rad/s; the offset is absolute, not about ``moves.origin``.
    density : shape (3,)
        Noise of the three axes, (sensor unit)^2 s: variance of a white sample times the time between samples.
    """
    x = moves.rates - (offset - moves.origin)
    phi = (x @ matrix.T) * moves.steps[..., None]
    before, whole = _chained(_rotations(phi))
    # psi seen at the start of the chunk: the sum of A_i^T J(phi_i) h_i dw_i, A_i the rotation before sample i
    carried = np.swapaxes(before, -1, -2) @ _left_jacobian(phi)
    carried = carried * moves.steps[..., None, None]
    regressors = np.concatenate([x, np.ones_like(x[..., :1])], axis=-1)
    sums = np.einsum("cnij,cnr->cirj", carried, regressors, optimize=True)  # (c, 3, 4, 3)
    by_matrix = np.swapaxes(sums[:, :, :3, :], 2, 3).reshape(-1, 3, 9)  # G by rows: dw_j = dG_jr x_r
    local = np.concatenate([by_matrix, -sums[:, :, 3, :] @ matrix], axis=2)
    spread = carried @ (matrix * np.sqrt(density)) / np.sqrt(np.maximum(moves.steps, 1e-300))[..., None, None]
    wide = np.moveaxis(spread, 1, 2).reshape(len(spread), 3, -1)
    return _joined(moves, whole, local, wide @ np.swapaxes(wide, 1, 2))


def _joined(moves: Moves, whole: Array, local: Array, noise: Array) -> Turns:
    """The chunks joined to movements; psi is turned to the end of its movement."""
    count = len(moves)
    counts = np.diff(moves.first)
    rotation = np.tile(np.eye(3), (count, 1, 1))
    total, covariance = np.zeros((count, 3, 12)), np.zeros((count, 3, 3))
    for k in range(int(counts.max(initial=0))):
        on = np.flatnonzero(counts > k)
        chunk = moves.first[on] + k
        back = np.swapaxes(rotation[on], 1, 2)
        total[on] += back @ local[chunk]
        covariance[on] += back @ noise[chunk] @ rotation[on]
        rotation[on] = whole[chunk] @ rotation[on]
    return Turns(rotation, rotation @ total, rotation @ covariance @ np.swapaxes(rotation, 1, 2))


def _rotations(phi: Array) -> Array:
    """``exp(-[phi]x)`` (..., 3, 3) of rotation vectors (..., 3)."""
    angle2 = (phi**2).sum(axis=-1)
    angle = np.sqrt(angle2)
    sinc = np.sinc(angle / np.pi)
    half = 0.5 * np.sinc(0.5 * angle / np.pi) ** 2  # (1 - cos)/angle^2
    x, y, z = phi[..., 0], phi[..., 1], phi[..., 2]
    R = np.empty((*phi.shape, 3))
    R[..., 0, 0], R[..., 1, 1], R[..., 2, 2] = (1.0 - half * (angle2 - c * c) for c in (x, y, z))
    for i, j, a, b, c in ((0, 1, x, y, z), (2, 0, z, x, y), (1, 2, y, z, x)):
        R[..., i, j] = half * a * b + sinc * c
        R[..., j, i] = half * a * b - sinc * c
    return R


def _left_jacobian(phi: Array) -> Array:
    """Jacobian (..., 3, 3) of ``exp(-[phi]x)`` by phi, in axes before the step: ``I + [phi]x/2 + [phi]x^2/6 + ...``."""
    angle2 = (phi**2).sum(axis=-1)
    half = 0.5 * np.sinc(0.5 * np.sqrt(angle2) / np.pi) ** 2
    third = 1.0 / 6.0 - angle2 / 120.0  # (angle - sin)/angle^3; a step is far below one radian
    x, y, z = phi[..., 0], phi[..., 1], phi[..., 2]
    J = np.empty((*phi.shape, 3))
    J[..., 0, 0], J[..., 1, 1], J[..., 2, 2] = (1.0 - third * (angle2 - c * c) for c in (x, y, z))
    for i, j, a, b, c in ((0, 1, x, y, z), (2, 0, z, x, y), (1, 2, y, z, x)):
        J[..., i, j] = third * a * b - half * c
        J[..., j, i] = third * a * b + half * c
    return J


def _chained(steps: Array) -> tuple[Array, Array]:
    """Rotations before every step of its chunk, and over the whole chunk: ``D = E_64 ... E_2 E_1``."""
    before = np.empty_like(steps)
    total = np.tile(np.eye(3), (len(steps), 1, 1))
    for k in range(steps.shape[1]):
        before[:, k] = total
        total = steps[:, k] @ total
    return before, total
