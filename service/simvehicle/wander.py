"""The slow wander of an inertial sensor's bias: a random walk in time, the same however often it is read."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating]

HORIZON_S = 14400
"""From here on the bias stays where it is."""


@dataclass
class RandomWalk:
    """A walk (3,) that starts at zero and grows by one standard deviation a root second."""

    rng: np.random.Generator
    _elapsed: float = 0.0
    _walk: Array = field(init=False)

    def __post_init__(self) -> None:
        self._walk = np.vstack([np.zeros(3), np.cumsum(self.rng.normal(size=(HORIZON_S, 3)), axis=0)])

    def __call__(self, t: Array) -> Array:
        """The walk (N, 3) at vehicle times (N,), straight between whole seconds."""
        since = t + self._elapsed
        return np.column_stack([np.interp(since, np.arange(HORIZON_S + 1), axis) for axis in self._walk.T])

    def restart(self, elapsed: float) -> None:
        """Vehicle time begins again at zero after `elapsed` seconds; the bias goes on."""
        self._elapsed += elapsed
