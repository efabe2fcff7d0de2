"""Draws, contenders and tallies: error over bound with its own standard error, intervals, time, memory."""

from __future__ import annotations

import math
import sys
import time
import warnings
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

FAILURES = (ArithmeticError, ValueError, RuntimeError, TypeError, LookupError, AttributeError, np.linalg.LinAlgError)
"""What a contender may die of; a crash counts as a failed run."""


@dataclass(frozen=True, eq=False)
class Drawn:
    """One draw: what a contender is given, the truth of its parameters, and their Fisher information."""

    data: Any
    truth: Array
    information: Array
    stored: Array | None = None
    """Truth of the numbers whose intervals are counted; None: `truth`."""


@dataclass(frozen=True, eq=False)
class Answer:
    """What a contender found: the parameters of the bound, and its stored numbers with their sd if it gives any.

    NaN: this one is declined, by name; it counts neither as an error nor as an interval.
    """

    values: Array
    stored: Array | None = None
    stored_sd: Array | None = None
    bound: Callable[[], Array] | None = None
    """Fisher information of what was used, where that is for the contender to choose; None: that of the draw."""


@dataclass(frozen=True)
class Contender:
    """A way to estimate; `fit` returns None where it refuses. `ours`: makes every run, whatever it takes."""

    name: str
    fit: Callable[[Any], Answer | None]
    ours: bool = False
    target: float | None = None
    """Largest error over bound that is promised; None: none is."""
    exact: bool = True
    """Whether the intervals are to hold 95 %; False: 95 % or more."""
    honest: bool = False
    """Whether the intervals are judged where no ratio is promised."""


@dataclass(frozen=True)
class Case:
    """One cell of the tables: `draw` makes the data of a run."""

    title: str
    size: int
    draw: Callable[[np.random.Generator], Drawn]
    runs: int
    seed: int


@dataclass
class Tally:
    """What came of a contender in a case."""

    contender: Contender
    case: Case
    squares: list[float] = field(default_factory=list)
    held: list[float] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)
    independent: int = 0
    failed: int = 0
    refused: int = 0
    declined: int = 0
    """Parameters that were declined by name, over all runs."""

    @property
    def runs(self) -> int:
        """Runs that were made."""
        return len(self.squares) + self.failed + self.refused

    @property
    def ratio(self) -> float:
        """Root of the mean of ``e^T F e / p``: 1 is the bound."""
        return math.sqrt(float(np.mean(self.squares))) if self.squares else math.nan

    @property
    def ratio_sd(self) -> float:
        """Standard error of the ratio, from the scatter of the runs."""
        if len(self.squares) < 2:
            return math.nan
        return float(np.std(self.squares, ddof=1)) / math.sqrt(len(self.squares)) / (2.0 * self.ratio)

    @property
    def coverage(self) -> float | None:
        """Share of the 95 % intervals that held the truth; None: no uncertainty is given."""
        return float(np.mean(self.held)) if self.held else None

    @property
    def coverage_sd(self) -> float:
        """Standard deviation of the share: binomial, or from the scatter of the runs where that is larger.

        The intervals of one run are not independent: after a tilted movement a few directions are behind all of them.
        """
        if not self.held:
            return math.nan
        binomial = math.sqrt(0.95 * 0.05 / max(len(self.held) * self.independent, 1))
        scatter = float(np.std(self.held, ddof=1)) / math.sqrt(len(self.held)) if len(self.held) > 1 else 0.0
        return max(binomial, scatter)

    @property
    def milliseconds(self) -> float:
        """Median processor time of a run."""
        return 1e3 * float(np.median(self.seconds)) if self.seconds else math.nan

    @property
    def allowance(self) -> float:
        """Chance of the ratio, two standard deviations: ``2 / sqrt(2 R p)``."""
        return 2.0 / math.sqrt(2.0 * max(len(self.squares), 1) * self.independent) if self.independent else math.nan

    @property
    def met(self) -> bool | None:
        """Whether the promise was kept; None: none was made."""
        if self.contender.target is None and not self.contender.honest:
            return None
        reached = self.contender.target is None or self.ratio <= self.contender.target + self.allowance
        return bool(reached and self.holds and not self.failed and not self.refused)

    @property
    def holds(self) -> bool:
        """Whether the intervals hold what they say within two standard deviations; True without intervals."""
        if self.coverage is None:
            return True
        low = self.coverage - 0.95 >= -2.0 * self.coverage_sd
        return low and (not self.contender.exact or self.coverage - 0.95 <= 2.0 * self.coverage_sd)


def run_case(case: Case, contenders: Sequence[Contender], budget: float = 6.0) -> list[Tally]:
    """All contenders on the same draws."""
    rng = np.random.default_rng(case.seed)
    tallies = [Tally(contender, case) for contender in contenders]
    spent = dict.fromkeys((c.name for c in contenders), 0.0)
    for _ in range(case.runs):
        drawn = case.draw(rng)
        for tally in tallies:
            name = tally.contender.name
            if not tally.contender.ours and spent[name] > budget:
                continue
            spent[name] += _one(tally, drawn)
    return tallies


def _one(tally: Tally, drawn: Drawn) -> float:
    begin = time.process_time()
    try:
        answer = quietly(tally.contender.fit, drawn.data)
    except FAILURES:
        answer, taken = None, time.process_time() - begin
        tally.failed += 1
        return taken
    taken = time.process_time() - begin
    if answer is None:
        tally.refused += 1
        return taken
    given = ~np.isnan(answer.values)
    error = (answer.values - drawn.truth)[given]
    information = drawn.information if answer.bound is None else answer.bound()
    square = float(error @ information[np.ix_(given, given)] @ error) / max(len(error), 1)
    if not math.isfinite(square) or not given.any():
        tally.failed += 1
        return taken
    tally.squares.append(square)
    tally.seconds.append(taken)
    tally.independent = len(given)
    tally.declined += int(np.count_nonzero(~given))
    if answer.stored_sd is not None and answer.stored is not None:
        truth = drawn.truth if drawn.stored is None else drawn.stored
        inside = np.abs(answer.stored - truth) <= 1.959964 * answer.stored_sd
        tally.held.append(float(np.mean(inside[~np.isnan(answer.stored)])))
    return taken


def quietly(fit: Callable[[Any], Answer | None], data: Any) -> Answer | None:
    """The answer, without the warnings of others."""
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        return fit(data)


QUICK_SIZES = 1000
QUICK_RUNS = 12


@dataclass(frozen=True)
class Settings:
    """`quick` is a slice for tests: small samples, few runs, no promise judged by it."""

    quick: bool = False
    seed: int = 1
    budget: float = 6.0
    silent: bool = False

    def sizes(self, wanted: list[int]) -> list[int]:
        """Those of `wanted` that are measured, the smallest at least."""
        return [n for n in wanted if not self.quick or n <= QUICK_SIZES] or wanted[:1]

    def runs(self, size: int) -> int:
        """Repeats at that number of samples."""
        if self.quick:
            return QUICK_RUNS
        return 200 if size < 100_000 else 60 if size < 1_000_000 else 40

    @property
    def largest(self) -> int:
        """Samples on which time is taken."""
        return 20_000 if self.quick else 1_000_000

    def seed_of(self, title: str, size: int) -> int:
        """A seed of its own for every case, the same on every machine."""
        return zlib.crc32(f"{self.seed} {title} {size}".encode())

    def say(self, what: str) -> None:
        """Progress, on the error stream."""
        if not self.silent:
            print(what, file=sys.stderr, flush=True)
