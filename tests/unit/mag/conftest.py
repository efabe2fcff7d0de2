from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mavcal.calib.mag.shape import Ellipsoid

SHAPE = np.array([[51.0, 2.2, -1.5], [2.2, 47.0, 1.8], [-1.5, 1.8, 49.5]])
OFFSET = np.array([12.0, -8.5, 21.0])
DIP = math.radians(66.0)


@dataclass(frozen=True)
class Compass:
    """A magnetometer in uT with 3 % of soft iron, and movements that drive it."""

    truth: Ellipsoid
    dip: float = DIP

    def everywhere(self, rng: np.random.Generator, count: int) -> Any:
        """Field directions (count, 3) spread over the sphere."""
        directions = rng.normal(size=(count, 3))
        return directions / np.linalg.norm(directions, axis=1, keepdims=True)

    def tilted(self, rng: np.random.Generator, count: int, tilt_deg: float) -> Any:
        """Field directions (count, 3) of a vehicle with all headings, roll and pitch within `tilt_deg`."""
        tilt = np.radians(rng.uniform(-tilt_deg, tilt_deg, (count, 2)))
        angles = np.column_stack([rng.uniform(-math.pi, math.pi, count), tilt])
        field = [math.cos(self.dip), 0.0, math.sin(self.dip)]
        return Rotation.from_euler("ZYX", angles).inv().apply(field)

    def read(self, directions: Any, rng: np.random.Generator, noise: float = 0.3) -> Any:
        """Samples (N, 3) for field directions (N, 3)."""
        exact = directions @ self.truth.shape + self.truth.offset
        return exact + noise * rng.normal(size=exact.shape)


@pytest.fixture
def compass() -> Compass:
    return Compass(Ellipsoid(OFFSET, SHAPE))


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(7)


TWELVE = np.array(
    [
        (673, -57, 191),
        (-431, -113, 230),
        (150, 366, 232),
        (92, -535, 187),
        (98, -59, 711),
        (141, -111, -290),
        (474, 295, 217),
        (-185, 258, 243),
        (121, 203, 627),
        (88, -336, 593),
        (548, -46, 497),
        (569, -75, -106),
    ],
    dtype=np.float64,
)


@pytest.fixture
def twelve_points() -> Any:
    """Twelve integer samples in mgauss whose fits were computed twice, independently (METHODS 3.1)."""
    return TWELVE.copy()
