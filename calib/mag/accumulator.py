"""Samples of a magnetometer so far and their rough shape, for a live procedure that asks once a second."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from mavcal.calib.errors import UndeterminedError
from mavcal.calib.mag.ellipsoid import FEWEST
from mavcal.calib.mag.moments import Moments
from mavcal.calib.mag.samples import Array, Cloud, check_not_flat, check_samples
from mavcal.calib.mag.shape import Ellipsoid
from mavcal.calib.mag.simple_fits import solve_sphere

_COVERED = 4000  # samples that are enough to know the coverage
_ROUNDING = 1e-9  # of a cloud's distance from zero, and of its width: what is thinner is rounding, not movement


class EllipsoidAccumulator:
    """Samples of one magnetometer, fed in chunks, and their rough shape."""

    def __init__(self) -> None:
        self._store = np.empty((1024, 3))
        self._count = 0

    def __len__(self) -> int:
        return self._count

    @property
    def samples(self) -> Array:
        """All samples so far, (N, 3); read only."""
        view = self._store[: self._count]
        view.flags.writeable = False
        return view

    def add(self, samples: ArrayLike) -> None:
        """Take in `samples` (N, 3) or (3,), any N.

        Raises
        ------
        InvalidInputError
            If they are not finite or of another shape; nothing is taken in then.
        """
        chunk = np.atleast_2d(np.asarray(samples, dtype=np.float64))
        if not chunk.size:
            return
        self._append(check_samples(chunk, 1, may_repeat=True))

    def rough(self) -> Ellipsoid | None:
        """A quick ellipsoid of the samples so far, or a sphere; None: they determine neither."""
        if self._count < FEWEST:
            return None
        samples = self._thinned()
        centre = samples.mean(axis=0)
        scale = float(np.linalg.norm(samples.std(axis=0)))
        if scale <= _ROUNDING * float(np.abs(samples).max()):
            return None
        scaled = (samples - centre) / scale
        try:
            check_not_flat(scaled.T @ scaled, _ROUNDING)
            found, _ = Moments.of(Cloud(scaled, np.zeros(3), 1.0)).ellipsoid()
            if found.radii[2] > 3.0 * found.radii[0]:
                offset, radius = solve_sphere(scaled)
                found = Ellipsoid(offset, radius * np.eye(3))
        except UndeterminedError:
            return None
        return found.moved(centre, scale)

    def _thinned(self) -> Array:
        return self.samples[:: max(1, self._count // _COVERED)]

    def _append(self, chunk: Array) -> None:
        needed = self._count + len(chunk)
        if needed > len(self._store):
            enlarged = np.empty((max(needed, 2 * len(self._store)), 3))
            enlarged[: self._count] = self._store[: self._count]
            self._store = enlarged
        self._store[self._count : needed] = chunk
        self._count = needed


def directions_of(samples: Array, shape: Ellipsoid) -> Array:
    """Unit vectors (M, 3) of `samples` (N, 3) mapped by `shape`; a sample at its centre is left out."""
    directions = np.linalg.solve(shape.shape, (samples - shape.offset).T).T
    return np.asarray(directions[np.linalg.norm(directions, axis=1) > 0.0], dtype=np.float64)
