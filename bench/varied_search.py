"""A diagnosis that reads the prices of the search with several values at once, and how its answer depends on them.

It reads each price with all its values, and its process forks where they lead to different steps
(:mod:`bench.variants`). A variant whose search ends as the plain one did ends there, unless its price is read later.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from types import ModuleType
from typing import Any
from unittest.mock import patch

import numpy as np

from bench.variants import Variant, VariantNumber, VariantProcess, value_in
from mavcal.calib import gap
from mavcal.calib.gap.model.hypotheses import Key
from mavcal.calib.gap.search import prices
from mavcal.calib.recording import Recording

FACTORS = (0.7, 1.3)
WITHOUT: Mapping[str, float] = {
    **dict.fromkeys(
        (
            *("SECOND_PRIOR_PRICE", "DRIFT_PRICE", "SHAPE_PRICES", "SHAPE_PART_PRICE", "THERMAL_PRICE"),
            *("REPEATED_JUMP_PRICE", "REFERENCE_PRICE", "EFFECT_COUNT_PRICE", "SECOND_ORDER_SHARE"),
            *("FLIGHT_SECOND_ORDER_SHARE", "ENTRY_SHARE", "OTHER_SENSOR_SHARE", "RIVAL_SHARE", "FLIGHT_DIFFERENCE"),
            *("REFINEMENT_GAIN", "EXACT_FIT_GAIN", "ENVELOPE_GAIN", "FLIGHT_NOISE_RATIO", "LINE_UNSTEADINESS"),
            *("INSTANCE_SHARE", "FILTER_BAND_SHARE", "NOMINAL_TONE_SHARE", "LINE_TO_NEIGHBOURS"),
            *("SECOND_ORDER_LOSS", "EVENT_GAIN_SHARE"),
        ),
        0,
    ),
    "FIXED_SHAPE_SIDES": 1,
    **dict.fromkeys(("RIVALS_TRIED", "CANDIDATES_FITTED", "EXCHANGES_TRIED", "MOST_EXCHANGES"), 1000),
    **dict.fromkeys(("MOST_IN_A_ROW", "MOST_EVENTS"), 1000),
    **dict.fromkeys(("HIDING_GAIN", "SLOW_POWER_RATIO", "RIVAL_REACH", "WANDER_SLACK"), math.inf),
}
"""The value at which a price charges and excludes nothing; grids and reaches have no such value."""
SHORTCUTS = (
    *("REFINEMENT_GAIN", "EXACT_FIT_GAIN", "ENVELOPE_GAIN", "RIVALS_TRIED", "CANDIDATES_FITTED", "MOST_IN_A_ROW"),
    *("MOST_EVENTS", "RIVAL_REACH", "MOST_EXCHANGES", "EXCHANGES_TRIED", "WANDER_SLACK"),
)
"""Prices that save time: candidates that are not refined, exchanges that are not tried."""

Answer = tuple[str, bool, tuple[tuple[str, tuple[int, ...]], ...]]
"""Verdict, whether something unknown is left, and the effects that are named with their instances."""


@dataclass(frozen=True, eq=False)
class GapQuestion:
    """Two recordings, the effects that the catalogue must do without, and which answers are right."""

    real: Recording
    sim: Recording
    right: Callable[[Answer], bool]
    without: tuple[str, ...] = ()

    def answer(self) -> Answer:
        """The answer with the prices as they are read."""
        report = gap.run(self.real, self.sim, nested=False, without=self.without)
        effects = tuple(sorted((e.id, tuple(e.instances)) for e in report.effects))
        return report.verdict.value, report.unknown.flag, effects


Changes = dict[str, list[tuple[bool, bool]]]
"""By price that was read, for each other value: whether the answer changes, and whether it is right then."""


SearchEnd = tuple[tuple[tuple[Key, float], ...], frozenset[Key]]
"""The effects that a search chose with their gains, and those that are no gap."""


_DIAGNOSIS = import_module("mavcal.calib.gap.diagnose")
"""The module; its package shows the function of the same name."""


class _Plain:
    """Notes how the search of a diagnosis ends, and which prices are read after it."""

    def __init__(self) -> None:
        self.end: SearchEnd | None = None
        self.late: set[str] = set()

    def read(self, name: str, value: Any) -> Any:
        if self.end is not None:
            self.late.add(name)
        return value

    def searched(self, end: SearchEnd) -> None:
        self.end = end


class _Varying:
    """Reads every price of `only` with its other values as well, see :mod:`bench.variants`.

    `unchanged` is the answer of a variant whose diagnosis must end as the `plain` one did.
    """

    def __init__(self, only: Mapping[str, Sequence[Any]], plain: _Plain, unchanged: tuple[bool, bool]) -> None:
        self.process = VariantProcess((name, k) for name, others in only.items() for k, _ in enumerate(others))
        self._only, self._plain, self._unchanged = only, plain, unchanged
        self._prices: dict[str, Any] = {}

    def read(self, name: str, value: Any) -> Any:
        """A price with its other values; what is no number is read by one process a variant."""
        if name not in self._only:
            return value
        if name not in self._prices:
            self._prices[name] = self._varied(name, value, self._only[name])
        found = self._prices[name]
        if isinstance(found, list):
            self.process.divide((name, k) for k, _ in enumerate(found))
            own = self.process.own
            return found[own[1]] if own is not None and own[0] == name else value
        return found

    def _varied(self, name: str, value: Any, others: Sequence[Any]) -> Any:
        if isinstance(value, Mapping):
            return {key: self._number(name, one, [other[key] for other in others]) for key, one in value.items()}
        return self._number(name, value, others) if isinstance(value, int | float) else others

    def _number(self, name: str, plain: Any, others: Sequence[Any]) -> VariantNumber:
        return VariantNumber(plain, {(name, k): other for k, other in enumerate(others)}, self.process)

    def searched(self, end: SearchEnd) -> None:
        """A variant ends here if nothing can be different any more."""
        process = self.process
        if process.own is not None:
            if self._ends_alike(process.own, end):
                process.end_child(self._unchanged)
            return
        for variant in sorted(process.open):
            if self._ends_alike(variant, end):
                process.close(variant, self._unchanged)

    def _ends_alike(self, variant: Variant, end: SearchEnd) -> bool:
        gains, tolerated = end
        own = (tuple((key, value_in(variant, gain)) for key, gain in gains), tolerated)
        return variant[0] not in self._plain.late and own == self._plain.end

    @property
    def changed(self) -> Changes:
        """By price that was read: whether the answer changes and is right, for each factor."""
        answers = {(name, k): self._unchanged for name in self._prices for k, _ in enumerate(self._only[name])}
        answers.update((v, tuple(answer)) for v, answer in self.process.answers.items())
        return {name: [answer for v, answer in sorted(answers.items()) if v[0] == name] for name in self._prices}


class _ReadPrices(ModuleType):
    """The module of prices, which says when one is read."""

    def __getattribute__(self, name: str) -> Any:
        value = super().__getattribute__(name)
        return super().__getattribute__("watch").read(name, value) if name.isupper() else value


@contextmanager
def watched(watch: _Plain | _Varying) -> Iterator[None]:
    """In here `watch` gives out every price that is read, and hears of the end of a search."""
    settled = _DIAGNOSIS._settled

    def noted(*args: Any) -> Any:
        answer = settled(*args)
        gains = tuple((score.hypothesis.key, score.gain) for score in answer.chosen.scores)
        watch.searched((gains, answer.tolerated))
        return answer

    vars(prices)["watch"] = watch
    prices.__class__ = _ReadPrices
    with patch.object(_DIAGNOSIS, "_settled", noted):
        yield


def names() -> tuple[str, ...]:
    """The prices of the table, in its order."""
    return tuple(name for name in vars(prices) if name.isupper())


def other_values(name: str, *, without: bool) -> list[Any]:
    """The values that a price is changed to: times each factor, and the one that does nothing where there is one."""
    value = vars(prices)[name]
    found = [scaled(value, factor) for factor in FACTORS]
    if without and name in WITHOUT:
        nothing = WITHOUT[name]
        found.append(dict.fromkeys(value, nothing) if isinstance(value, Mapping) else nothing)
    return found


def scaled(value: Any, factor: float) -> Any:
    """A price times `factor`: counts are rounded away from what they were, tables and grids scaled as a whole."""
    if isinstance(value, int):
        return max(0, int(np.floor(value * factor)) if factor < 1.0 else int(np.ceil(value * factor)))
    if isinstance(value, Mapping):
        return {key: scaled(one, factor) for key, one in value.items()}
    if isinstance(value, tuple):
        return tuple(scaled(one, factor) for one in value)
    return value * factor


def changes(
    question: GapQuestion, others: Mapping[str, Sequence[Any]], longest_s: float = math.inf
) -> tuple[bool, Changes | None]:
    """Whether the answer is right with the prices as they are, and what `others` of each price change.

    None: one diagnosis takes more than `longest_s` of processor time. For a process of its own: it changes the table of
    prices.
    """
    plain, began = _Plain(), time.process_time()
    with watched(plain):
        before = question.answer()
    right = question.right(before)
    if time.process_time() - began > longest_s:
        return right, None
    varying = _Varying(others, plain, (False, right))
    try:
        with watched(varying):
            after = question.answer()
        varying.process.end_child((after != before, question.right(after)))
    except BaseException:
        varying.process.fail_child()
        raise
    return right, varying.changed
