"""Eighty sections of the sphere: every face of an icosahedron cut into four, as coverage masks of MAVLink have them.

A direction belongs to the section whose centre is nearest. The numbering is our own: draw with :data:`CENTRES`.
"""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

N_SECTIONS = 80


def _centres() -> Array:
    golden = (1.0 + 5.0**0.5) / 2.0
    vertices = np.array(
        [np.roll((0.0, s, t * golden), k) for k in range(3) for s, t in itertools.product((1.0, -1.0), repeat=2)]
    )
    vertices /= np.linalg.norm(vertices[0])
    edge = min(np.linalg.norm(vertices[0] - v) for v in vertices[1:])
    centres = []
    for corners in itertools.combinations(vertices, 3):
        if all(np.linalg.norm(p - q) < 1.01 * edge for p, q in itertools.combinations(corners, 2)):
            middles = [_unit(p + q) for p, q in itertools.combinations(corners, 2)]
            centres.append(_unit(np.sum(middles, axis=0)))
            # The combinations are (0, 1), (0, 2), (1, 2): a corner's two middles are those that name it.
            for corner, (i, j) in zip(corners, ((0, 1), (0, 2), (1, 2)), strict=True):
                centres.append(_unit(corner + middles[i] + middles[j]))
    return np.array(centres)


def _unit(vector: Array) -> Array:
    return np.asarray(vector / np.linalg.norm(vector))


CENTRES = _centres()
"""Unit vectors to the middles of the sections, (80, 3)."""


def sections(directions: ArrayLike) -> NDArray[np.intp]:
    """Number of the section (0..79) of each of `directions` (N, 3), of any length but 0."""
    return np.asarray(np.argmax(np.asarray(directions, dtype=np.float64) @ CENTRES.T, axis=1))


def visited(directions: ArrayLike) -> NDArray[np.bool_]:
    """Which of the sections (80,) hold at least one of `directions` (N, 3)."""
    result = np.zeros(N_SECTIONS, dtype=np.bool_)
    result[sections(directions)] = True
    return result


def mask_bytes(seen: NDArray[np.bool_]) -> list[int]:
    """The ten bytes of a coverage mask, section i in bit ``i % 8`` of byte ``i // 8``.

    >>> mask_bytes(np.arange(80) == 9)[:3]
    [0, 2, 0]
    """
    return [int(b) for b in np.packbits(seen, bitorder="little")]
