"""The types of an effect of the catalogue. A new effect is one entry in the tuple of its family's file."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.gap.effects.traits import SensorTerm, Trait
from mavcal.calib.gap.problem import Trace
from mavcal.calib.recording import Sensor

Array = NDArray[np.float64]


@dataclass(frozen=True)
class EffectParameter:
    """A forward parameter of an effect: it is added to, or multiplies, the ideal reading (GAP 8).

    `squared`: the linear amplitude of the contest is the square of the reported value (amplitudes of noise).
    """

    name: str
    unit: str
    squared: bool = False


class Missing(Protocol):
    """Why an effect cannot be tested on a trace: (reason, need), or None if it can."""

    def __call__(self, trace: Trace, /) -> tuple[str, str] | None: ...  # noqa: D102


def never_missing(_trace: Trace) -> tuple[str, str] | None:
    """None: testable on any trace."""
    return None


@dataclass(frozen=True)
class EffectShape:
    """The one nonlinear parameter of an effect: a delay, a cut-off, a time constant, a moment.

    `grid(trace)` gives the values (M,) that are tried first, ascending. The best is refined between its neighbours, and
    the search has a price. For a large grid `screen(trace, residual)` picks at least one promising value from the
    residual (N, 3). The price is still that of the whole grid. A `discontinuous` shape (the moment of a jump) has no
    derivative between two samples and is not refined. A `chosen` shape is arbitrary beside another free effect, as the
    temperature at which a drift vanishes is beside an offset.
    """

    parameter: EffectParameter
    grid: Callable[[Trace], Array]
    screen: Callable[[Trace, Array], Array] | None = None
    discontinuous: bool = False
    chosen: bool = False


@dataclass(frozen=True)
class CatalogueEffect:
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
        What a trace lacks for the effect.
    shape
        None: purely linear.
    rivals
        Ids of the effects that imitate it where the movement is poor.
    shared
        One set of parameters acts on every trace of every sensor; `sensor` then only selects its page.
    repeatable
        It can happen more than once in a recording (a magnet put on and taken off, two tones).
    form
        Tells apart two descriptions of one effect that compete under the same id; empty for the only one.
    plain
        A phrase in plain words, for readers who do not know the id.
    traits
        Properties by which the search, the prices and the report treat it.
    term
        Term of the sensor equation that exports write it to; None: a simulated sensor has no such term.
    family
        Kind of a shape that the catalogue does not have; it sets the price. Empty for an effect with a name.
    part
        Whether it is a part of such a shape, with one of its many amplitudes.
    hidden
        Numbers that are fitted to the residual inside its columns: degrees of freedom that no parameter shows.
    """

    id: str
    sensor: Sensor
    parameters: tuple[EffectParameter, ...]
    excited_by: str
    fix: str
    missing: Missing = never_missing
    shape: EffectShape | None = None
    rivals: tuple[str, ...] = ()
    shared: bool = False
    repeatable: bool = False
    hidden: int = 0
    form: str = ""
    plain: str = ""
    traits: frozenset[Trait] = frozenset()
    term: SensorTerm | None = None
    family: str = ""
    part: bool = False

    @property
    def nameless(self) -> bool:
        """Whether it is a shape without a name in the catalogue."""
        return bool(self.family)

    @property
    def jumps(self) -> bool:
        """Whether it is an event: an offset from one moment on, which is its shape."""
        return Trait.JUMPING in self.traits

    @property
    def discontinuous(self) -> bool:
        """Whether its shape has no derivative between two samples: the moment of a jump."""
        return self.shape is not None and self.shape.discontinuous

    @property
    def tonal(self) -> bool:
        """Whether it is a wave of one frequency, which is its shape."""
        return Trait.TONAL in self.traits

    @property
    def drifts(self) -> bool:
        """Whether it is drift noise: flicker or a random walk."""
        return Trait.WANDERING in self.traits


@dataclass(frozen=True, kw_only=True)
class MeanEffect(CatalogueEffect):
    """Moves the mean: measured = ideal + sum_j parameter_j * columns_j.

    Parameters
    ----------
    columns
        ``columns(trace, theta)`` gives (p, N, 3); `theta` is the shape's value, NaN for effects without one. They may
        depend on each other where the movement is poor: a rank below p is no error.
    signals
        ``signals(trace, theta)`` gives (q, N) where column ``3 q + axis`` is signal q on that axis alone: one transform
        instead of nine. None for effects that are not of this form.
    fixed
        The amplitude of the only column is 1 by definition and `parameters` is empty: what is estimated is `theta`.
    exact
        ``exact(trace, parameters)`` gives (N, 3), the change of the mean without linearisation; None: it is linear.
    noise_gain
        ``noise_gain(trace, omega, theta)`` gives (R, K): one row multiplies the sensor's own noise spectrum, its level
        aside; None: 1.
    """

    columns: Callable[[Trace, float], Array]
    signals: Callable[[Trace, float], Array] | None = None
    fixed: bool = False
    exact: Callable[[Trace, Array], Array] | None = None
    noise_gain: Callable[[Trace, Array, float], Array] | None = None


@dataclass(frozen=True, kw_only=True)
class NoiseEffect(CatalogueEffect):
    """Adds power: S_k += sum_j parameter_j * density_j(k), amplitudes >= 0 per axis.

    `density(trace, omega, theta)` gives (p, K) on DCT frequencies `omega` (rad per sample, 0..pi), in variance of one
    sample for a unit parameter, averaged over the recording; `parameters` are 3 p: the amplitudes of each density on
    x, y, z. `variance(trace)`, if not None, gives (N,) of mean one: the effect's power follows it in time.
    """

    density: Callable[[Trace, Array, float], Array]
    variance: Callable[[Trace], Array] | None = None


@dataclass(frozen=True)
class LatticeEvidence:
    """Evidence in the sample lattice, exact before any statistics (GAP 3.0).

    `masked` rows are excluded from the likelihood.
    """

    values: tuple[float, ...]
    se: tuple[float, ...]
    two_delta_loglik: float
    masked: NDArray[np.bool_]
    text: str


@dataclass(frozen=True, kw_only=True)
class LatticeEffect(CatalogueEffect):
    """An effect that shows as repeated, clipped, zeroed or coarsely rounded samples."""

    detect: Callable[[Trace], LatticeEvidence | None]
