"""Coverage of a live calibration: information, predicted heading error, and where to turn next.

Visited directions of the field are recorded in eighty sections of the sphere, like MAVLink's coverage masks: every face
of an icosahedron divided into four. A direction belongs to the section whose centre is nearest. The numbering is our
own: draw with :data:`CENTRES`.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.mag.heading import heading_sd_deg
from mavcal.calib.mag.shape import COLUMNS, N_PARAMETERS, ROWS, Ellipsoid, correction, correction_covariance
from mavcal.calib.posture import tilted

Array = NDArray[np.float64]

N_SECTIONS = 80
# What is believed of any compass before the first sample, relative to the field: it keeps predictions finite.
_OFFSET_SD = 1.0
_SOFT_IRON_SD = 0.3

_RING = 24  # field directions that stand for one turn about the vertical
_SHARE = 0.2  # of the samples so far that a next turn is taken to add

_SIDES = (("nose", "tail"), ("right side", "left side"), ("belly", "top"))


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
    """Sections (80,) that hold at least one of `directions` (N, 3)."""
    result = np.zeros(N_SECTIONS, dtype=np.bool_)
    result[sections(directions)] = True
    return result


def mask_bytes(seen: NDArray[np.bool_]) -> list[int]:
    """The ten bytes of a coverage mask, section i in bit ``i % 8`` of byte ``i // 8``.

    >>> mask_bytes(np.arange(80) == 9)[:3]
    [0, 2, 0]
    """
    return [int(b) for b in np.packbits(seen, bitorder="little")]


@dataclass(frozen=True, eq=False)
class Advice:
    """The turn that reduces the heading error most."""

    direction: tuple[float, float, float]
    """Body direction (unit vector, FRD) to point down; then turn a full circle about the vertical."""
    text: str
    heading_sd_deg: float
    """Predicted heading error after it, degrees."""


@dataclass(frozen=True, eq=False)
class Coverage:
    """Field directions seen so far, in the vehicle's frame, as Fisher information of the nine parameters.

    Immutable and additive: chunks and vehicles can be joined in any order.
    """

    information: Array
    """Sum of ``J^T J`` for unit noise and unit field, (9, 9)."""
    seen: NDArray[np.bool_]
    """Sections of :data:`CENTRES` that were visited, (80,)."""
    count: int

    @classmethod
    def empty(cls) -> Coverage:
        """A coverage without a sample."""
        return cls(np.zeros((N_PARAMETERS, N_PARAMETERS)), np.zeros(N_SECTIONS, dtype=np.bool_), 0)

    @classmethod
    def of(cls, directions: ArrayLike) -> Coverage:
        """Coverage of `directions` (N, 3): corrected samples, of any length but 0."""
        array = np.asarray(directions, dtype=np.float64)
        if array.ndim != 2 or array.shape[1] != 3:
            raise InvalidInputError(f"directions must have shape (N, 3), not {array.shape}")
        if not len(array):
            return cls.empty()
        length = np.linalg.norm(array, axis=1, keepdims=True)
        if not (np.isfinite(length).all() and (length > 0.0).all()):
            raise InvalidInputError("a direction must be finite and of some length")
        units = array / length
        rows = _rows(units)
        return cls(rows.T @ rows, visited(units), len(units))

    def merged(self, other: Coverage) -> Coverage:
        """The coverage of both together."""
        return Coverage(self.information + other.information, self.seen | other.seen, self.count + other.count)

    @property
    def fraction(self) -> float:
        """Share of the 80 sections that were visited."""
        return float(self.seen.mean())

    @cached_property
    def mask(self) -> list[int]:
        """The ten bytes of the mask of visited sections."""
        return mask_bytes(self.seen)

    def heading_sd_deg(self, relative_noise: float, inclination: float) -> float:
        """Predicted heading error (degrees, worst heading and tilt) at a dip of `inclination` (rad).

        `relative_noise` is the noise of one axis over the field strength. Without movement it is that of any compass by
        the prior, some tens of degrees, never infinite.
        """
        return _predicted(self.information, relative_noise, inclination)

    def advice(self, relative_noise: float, inclination: float) -> Advice:
        """The body direction that should point down next, of the 6 faces, 12 edges and 8 corners.

        Each is judged by the heading error that remains after a full turn about the vertical with it down, at a dip of
        `inclination` (rad).
        """
        weight = max(_SHARE * self.count, _RING) / _RING
        best: tuple[float, Array] | None = None
        for down in _CANDIDATES:
            rows = _rows(ring(down, inclination))
            sd = _predicted(self.information + weight * (rows.T @ rows), relative_noise, inclination)
            if best is None or sd < best[0] * (1.0 - 1e-6):
                best = (sd, down)
        assert best is not None
        sd, down = best
        return Advice((float(down[0]), float(down[1]), float(down[2])), _words(down), sd)


def ring(down: Array, inclination: float) -> Array:
    """Field directions (24, 3) in the body over a turn about the vertical while `down` (3,) points down."""
    one = np.cross(down, np.eye(3)[int(np.argmin(np.abs(down)))])
    one /= np.linalg.norm(one)
    two = np.cross(down, one)
    angles = np.arange(_RING) * (2.0 * math.pi / _RING)
    level = np.outer(np.cos(angles), one) + np.outer(np.sin(angles), two)
    return math.sin(inclination) * down + math.cos(inclination) * level


def _rows(units: Array) -> Array:
    """Derivatives (N, 9) of the distance from the unit sphere: the normal is the direction itself."""
    products = units[:, ROWS] * units[:, COLUMNS]
    products[:, 3:] *= 2.0
    return np.hstack([units, products])


def _predicted(information: Array, relative_noise: float, inclination: float) -> float:
    if not relative_noise > 0.0:
        raise InvalidInputError(f"the noise of a compass must be positive, not {relative_noise} of the field")
    believed = np.diag([_OFFSET_SD**-2.0] * 3 + [_SOFT_IRON_SD**-2.0] * 6)
    covariance = np.linalg.inv(information / relative_noise**2 + believed)
    unit = Ellipsoid(np.zeros(3), np.eye(3))
    full = correction_covariance(unit, np.asarray(covariance), None, 0.0)
    return heading_sd_deg(correction(unit, None), full, 1.0, inclination)


def _candidates() -> tuple[Array, ...]:
    grid = [np.array(c, dtype=np.float64) for c in itertools.product((0, 1, -1), repeat=3) if any(c)]
    grid.sort(key=lambda c: np.count_nonzero(c))
    return tuple(c / np.linalg.norm(c) for c in grid)


_CANDIDATES = _candidates()


def _words(down: Array) -> str:
    axis = int(np.abs(down).argmax())
    if np.count_nonzero(np.abs(down) > 1e-6) == 1:
        side = _SIDES[axis][0 if down[axis] > 0.0 else 1]
        return f"point the {side} down and turn a full circle about the vertical"
    return f"hold it {tilted(down.tolist())}, and turn a full circle about the vertical"
