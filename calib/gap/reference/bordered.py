"""Normal equations of a chain: each node is tied to its neighbours, and all of them share some constants.

The matrix of the nodes is banded; the constants are its border. A Cholesky factor of the band and the Schur complement
of the border solve it in time linear in the number of nodes.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve_banded, cholesky_banded

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Rows:
    """Measured less predicted (M, 3) at `node` (M,), which must be sorted; `weight` (M, 3) are inverse variances."""

    node: NDArray[np.intp]
    residual: Array
    weight: Array


class BorderedEquations:
    """Banded normal equations of `n` nodes with a border: diagonal blocks, blocks beside them, border, corner.

    A node has `size` numbers, and all have the constants in common. Only constants in `free` (p,) are solved for.
    """

    def __init__(self, n: int, size: int, constants: int, free: NDArray[np.intp]) -> None:
        self.free = free
        self.diagonal = np.zeros((n, size, size))
        self.beside = np.zeros((n - 1, size, size))
        self.border = np.zeros((n, size, constants))
        self.corner = np.zeros((constants, constants))
        self.right = np.zeros((n, size))
        self.right_constants = np.zeros(constants)
        self.cost = 0.0
        self.velocity_residual = np.zeros((0, 3))
        self.mag_residual = np.zeros((0, 3))

    def observe(self, rows: Rows, part: slice, by_part: Array, constants: NDArray[np.intp], by_constant: Array) -> None:
        """Rows ``residual = by_part x + by_constant c + noise``, (M, 3).

        They see only `part` of a node's state, three numbers, and the `constants` (p,).
        """
        turned = (by_part * rows.weight[:, :, None]).swapaxes(1, 2)
        firsts = np.flatnonzero(np.diff(rows.node, prepend=-1))
        seen = rows.node[firsts]
        self.diagonal[seen, part, part] += np.add.reduceat(turned @ by_part, firsts)
        self.right[seen, part] += np.add.reduceat((turned @ rows.residual[:, :, None])[:, :, 0], firsts)
        self.cost += float((rows.weight * rows.residual**2).sum() - np.log(np.maximum(rows.weight, 1e-12)).sum())
        if len(constants):
            states = np.arange(part.start, part.stop)
            self.border[np.ix_(seen, states, constants)] += np.add.reduceat(turned @ by_constant, firsts)
            self.add_constants(constants, by_constant, rows.residual, rows.weight)

    def add_constants(self, constants: NDArray[np.intp], by_constant: Array, residual: Array, weight: Array) -> None:
        """Rows ``residual = by_constant c + noise`` (M, r), of the `constants` (p,) alone."""
        flat = by_constant.reshape(-1, len(constants))
        rows = (by_constant * weight[:, :, None]).reshape(flat.shape)
        self.corner[np.ix_(constants, constants)] += rows.T @ flat
        self.right_constants[constants] += rows.T @ residual.reshape(-1)

    def solved(self, node_right: Array, constant_right: Array) -> tuple[Array, Array]:
        """Values of the nodes (n, size, k) and the constants (c, k) for right sides of those shapes."""
        border, free = self._free_border, self.free
        inner = cho_solve_banded((self._factor, True), np.hstack([border, node_right.reshape(len(border), -1)]))
        over, plain = inner[:, : len(free)], inner[:, len(free) :]
        c = np.zeros_like(constant_right)
        c[free] = np.linalg.solve(self._free_corner - border.T @ over, constant_right[free] - border.T @ plain)
        return (plain - over @ c[free]).reshape(node_right.shape), c

    @property
    def log_determinant(self) -> float:
        """Log of the determinant of the whole matrix, nodes and free constants."""
        inner = self._free_corner - self._free_border.T @ cho_solve_banded((self._factor, True), self._free_border)
        return 2.0 * float(np.log(self._factor[0]).sum()) + float(np.linalg.slogdet(inner)[1])

    @property
    def _free_border(self) -> Array:
        return self.border.reshape(-1, len(self.corner))[:, self.free]

    @property
    def _free_corner(self) -> Array:
        return self.corner[np.ix_(self.free, self.free)]

    @cached_property
    def _factor(self) -> Array:
        """Cholesky factor of the nodes' part; the equations are complete by then."""
        return np.asarray(cholesky_banded(self._banded(), lower=True))

    def _banded(self) -> Array:
        n, size, _ = self.diagonal.shape
        banded = np.zeros((2 * size, n * size))
        for j in range(size):
            for i in range(j, size):
                banded[i - j, j::size] = self.diagonal[:, i, j]
            for i in range(size):
                banded[size + i - j, j : (n - 1) * size : size] = self.beside[:, j, i]
        return banded
