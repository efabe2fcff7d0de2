"""What an effect of the catalogue is. Adding one is adding it to the tuple of its family's file."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from calib.gap.problem import Trace
from calib.recording import Sensor

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Parameter:
    """A parameter in the forward sense: what is added to, or multiplies, the ideal sensor (GAP 8)."""

    name: str
    unit: str


class Missing(Protocol):
    """Why an effect cannot be tested on a trace: (reason, need), or None if it can."""

    def __call__(self, trace: Trace, /) -> tuple[str, str] | None: ...  # noqa: D102


def always(_trace: Trace) -> tuple[str, str] | None:
    """Testable on any trace."""
    return None


@dataclass(frozen=True)
class Shape:
    """The one nonlinear parameter of an effect: a delay, a cut-off, a time constant, a moment.

    `grid(trace)` gives the values that are tried first (M,); the contest pays log M for them, then refines between
    neighbours.
    """

    parameter: Parameter
    grid: Callable[[Trace], Array]


@dataclass(frozen=True)
class Effect:
    """One entry of the catalogue.

    Parameters
    ----------
    id
        ``<sensor>_<kind>`` of GAP 8.
    sensor
        Whose effect.
    parameters
        Of the linear amplitudes, in the order of the columns.
    excited_by, fix
        One phrase each: what movement or condition excites it, and which one tells it apart from its rivals.
    missing
        What a trace lacks for it.
    shape
        None: purely linear.
    """

    id: str
    sensor: Sensor
    parameters: tuple[Parameter, ...]
    excited_by: str
    fix: str
    missing: Missing = always
    shape: Shape | None = None


@dataclass(frozen=True, kw_only=True)
class MeanEffect(Effect):
    """Moves the mean: measured = ideal + sum_j parameter_j * columns_j.

    `columns(trace, theta)` gives (p, N, 3); `theta` is the shape's value, NaN for effects without one.
    """

    columns: Callable[[Trace, float], Array]


@dataclass(frozen=True, kw_only=True)
class NoiseEffect(Effect):
    """Adds power: S_k += sum_j parameter_j * density_j(k), amplitudes >= 0 per axis.

    `density(trace, omega, theta)` gives (p, K) on DCT frequencies `omega` (rad per sample, 0..pi), in variance of one
    sample for a unit parameter. `variance(trace)`, if not None, gives (N,): the effect's power follows it in time.
    """

    density: Callable[[Trace, Array, float], Array]
    variance: Callable[[Trace], Array] | None = None


@dataclass(frozen=True)
class LatticeEvidence:
    """Found in the lattice of the samples: exact, before any statistics (GAP 3.0).

    `masked` are the rows that leave the likelihood.
    """

    values: tuple[float, ...]
    se: tuple[float, ...]
    two_delta_loglik: float
    masked: NDArray[np.bool_]
    text: str


@dataclass(frozen=True, kw_only=True)
class LatticeEffect(Effect):
    """Seen in repeated, clipped, zeroed or coarsely rounded samples."""

    detect: Callable[[Trace], LatticeEvidence | None]
