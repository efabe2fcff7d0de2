"""``python -m bench.prices``: changes each price of the search by 30 % down and up, and counts the answers that change.

Cases are development cases of the withheld-effect check: singles, mixtures, unknown errors and nulls in turn. An answer
is its verdict and the instances of every effect that it names. A diagnosis reads each price with all three of its
values, and its process forks where they lead to different steps (:mod:`bench.variants`). A variant whose search ends as
the plain one did ends there, unless its price is read later too. A price that changes no answer may go.

200 cases take about an hour. A case whose plain diagnosis takes more than eight seconds is left out, since it would
take as long again for each fork; the next of its kind comes in its place. ``--keep FILE`` holds a line a case: the same
command goes on where it was stopped. ``--page`` writes ``docs/prices.md`` from the cases that are there.
``--without`` tries each price at a value that charges and bars nothing as well, which takes half as long again.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from importlib import import_module
from itertools import count, islice
from multiprocessing import get_context
from pathlib import Path
from types import ModuleType
from typing import Any
from unittest.mock import patch

import numpy as np

from bench.variants import Variant, VariantNumber, VariantProcess, value_in
from mavcal.calib import gap, logs
from mavcal.calib.gap.model.hypotheses import Key
from mavcal.calib.gap.search import prices
from mavcal.calib.recording import Recording
from mavcal.calib.withheld_check import Case, Tier, make_case

PAGE = Path(__file__).resolve().parents[1] / "docs" / "prices.md"
CASES = 200
FIRST_SEED = 70_000
"""Development seeds; sealed ones begin at 1 000 000."""
TIERS = (Tier.SINGLE, Tier.MIXED, Tier.UNKNOWN, Tier.NULL)
FACTORS = (0.7, 1.3)
WITHOUT: Mapping[str, float] = {
    **dict.fromkeys(
        (
            *("SECOND_PRIOR_PRICE", "IDLE_AMPLITUDE_PRICE", "FINE_GRID", "DRIFT_PRICE", "SHAPE_PRICES"),
            *("SHAPE_PART_PRICE", "THERMAL_PRICE", "REPEATED_JUMP_PRICE", "REFERENCE_PRICE", "EFFECT_COUNT_PRICE"),
            *("SECOND_ORDER_SHARE", "FLIGHT_SECOND_ORDER_SHARE", "ENTRY_SHARE", "OTHER_SENSOR_SHARE", "RIVAL_SHARE"),
            *("FLIGHT_DIFFERENCE", "REFINEMENT_GAIN", "EXACT_FIT_GAIN", "ENVELOPE_GAIN", "FLIGHT_NOISE_RATIO"),
            *("LINE_UNSTEADINESS", "INSTANCE_SHARE", "FILTER_BAND_SHARE", "NOMINAL_TONE_SHARE", "LINE_TO_NEIGHBOURS"),
            *("EXCHANGE_GAIN", "SECOND_ORDER_LOSS", "WANDERING_NOISE_NUMBERS", "EVENT_GAIN_SHARE", "WANDER_MARGIN"),
        ),
        0,
    ),
    **dict.fromkeys(("COARSE_GRID", "FIXED_SHAPE_SIDES"), 1),
    **dict.fromkeys(("RIVALS_TRIED", "CANDIDATES_FITTED", "EXCHANGES_TRIED", "MOST_EXCHANGES"), 1000),
    **dict.fromkeys(("MOST_IN_A_ROW", "MOST_EVENTS", "MOST_EFFECTS"), 1000),
    **dict.fromkeys(("HIDING_GAIN", "SLOW_POWER_RATIO", "RIVAL_REACH", "WANDER_SLACK"), math.inf),
}
"""What a price is that charges nothing and bars nothing; grids and reaches have no such value."""
LONGEST_S = 8.0
"""Processor time of a plain diagnosis above which a case is left out."""


@dataclass(frozen=True)
class Varied:
    """One case: whether its answer is right, and for each price that it reads what 30 % less and 30 % more do.

    `prices` maps a name to one pair a factor, and one more where the case was tried without the price: whether the
    answer changes, and whether it is right then. None: the case takes too long.
    """

    tier: str
    seed: int
    right: bool
    prices: Mapping[str, Sequence[tuple[bool, bool]]] | None


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
    def changed(self) -> dict[str, list[tuple[bool, bool]]]:
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


def varied(tier: Tier, seed: int, only: Sequence[str] = (), *, without: bool = False) -> Varied:
    """Diagnose a case with the prices as they are, and with each price that is read changed by each factor.

    For a process of its own: it changes the table of prices.
    """
    case = make_case(tier, seed)
    real, sim = recordings(case)
    plain, began = _Plain(), time.process_time()
    with watched(plain):
        before = named(case, real, sim)
    if time.process_time() - began > LONGEST_S:
        return Varied(tier.value, seed, right(case, before), None)
    others = {name: other_values(name, without=without) for name in only or names()}
    varying = _Varying(others, plain, (False, right(case, before)))
    try:
        with watched(varying):
            after = named(case, real, sim)
        varying.process.end_child((after != before, right(case, after)))
    except BaseException:
        varying.process.fail_child()
        raise
    return Varied(tier.value, seed, right(case, before), varying.changed)


Answer = tuple[str, bool, tuple[tuple[str, tuple[int, ...]], ...]]
"""Verdict, whether something unknown is left, and the effects that are named with their instances."""


def recordings(case: Case) -> tuple[Recording, Recording]:
    """The real and the simulated recording of a case."""
    with tempfile.TemporaryDirectory() as folder:
        paths = {side: Path(folder) / f"{side}.npz" for side in ("real", "sim")}
        for side, columns in (("real", case.real), ("sim", case.sim)):
            np.savez(paths[side], allow_pickle=False, **columns)
        return logs.read(paths["real"]), logs.read(paths["sim"])


def named(case: Case, real: Recording, sim: Recording) -> Answer:
    """The answer to a case."""
    report = gap.run(real, sim, nested=False, without=case.without)
    effects = tuple(sorted((e.id, tuple(e.instances)) for e in report.effects))
    return report.verdict.value, report.unknown.flag, effects


def right(case: Case, answer: Answer) -> bool:
    """Whether an answer names the true effects alone, and an unknown error where there is one."""
    _, unknown, effects = answer
    return {name for name, _ in effects} == {e["id"] for e in case.label["effects"]} and unknown == bool(
        case.label["unknown"]
    )


def chosen(cases: int, done: Sequence[Varied]) -> list[tuple[Tier, int]]:
    """Cases of every tier in turn that are not `done`, more of a tier for those of it that took too long."""
    left = []
    for t, tier in enumerate(TIERS):
        own = {case.seed: case for case in done if case.tier == tier.value}
        wanted = len(range(t, cases, len(TIERS))) - sum(case.prices is not None for case in own.values())
        seeds = (seed for seed in count(FIRST_SEED + t, len(TIERS)) if seed not in own)
        left += [(tier, seed) for seed in islice(seeds, max(wanted, 0))]
    return sorted(left, key=lambda one: one[1])


def cases_in(path: Path | None) -> list[Varied]:
    """Cases that an earlier run has written."""
    if path is None or not path.exists():
        return []
    return [Varied(**json.loads(line)) for line in path.read_text(encoding="utf-8").splitlines() if line]


def all_varied(
    cases: Sequence[tuple[Tier, int]], only: Sequence[str], workers: int, *, without: bool = False
) -> Iterator[Varied]:
    """Case by case, each in a process of its own, as they are done."""
    context = get_context("spawn")
    with ProcessPoolExecutor(workers, mp_context=context, max_tasks_per_child=1) as pool:
        for done in as_completed([pool.submit(varied, tier, seed, only, without=without) for tier, seed in cases]):
            yield done.result()


def row(name: str, cases: Sequence[Varied]) -> str:
    """A line of the table: cases that read the price, answers that each factor changes, and how many more are right."""
    reading = [(case, case.prices[name]) for case in cases if case.prices and name in case.prices]
    cells = [f"| `{name}` | {shown(getattr(prices, name))} | {len(reading)} |"]
    for k, _ in enumerate(FACTORS):
        cells.append(f" {_changes(reading, k)} |")
    tried = [(case, answers) for case, answers in reading if len(answers) > len(FACTORS)]
    cells.append(f" {_changes(tried, len(FACTORS))} of {len(tried)} |" if tried else " |")
    return "".join(cells)


def _changes(reading: Sequence[tuple[Varied, Sequence[tuple[bool, bool]]]], k: int) -> str:
    """Answers that value `k` changes, and how many more are right."""
    gained = sum(answers[k][1] - case.right for case, answers in reading)
    return f"{sum(answers[k][0] for _, answers in reading)} ({gained:+d})"


def shown(value: Any) -> str:
    """A price in a cell."""
    if isinstance(value, Mapping):
        return ", ".join(f"{k} {v:g}" for k, v in value.items())
    if isinstance(value, np.ndarray | tuple):
        return f"{len(value)} from {value[0]:g} to {value[-1]:g}"
    return f"{value:g}"


def main(argv: Sequence[str] | None = None) -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="python -m bench.prices", description=__doc__)
    parser.add_argument("--cases", type=int, default=CASES)
    parser.add_argument("--only", nargs="*", default=[], choices=names(), metavar="NAME", help="only these prices")
    parser.add_argument("--without", action="store_true", help="try each case without each price as well")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--keep", type=Path, metavar="FILE", help="a JSON line a case; cases in it are not run again")
    parser.add_argument("--page", action="store_true", help="write docs/prices.md")
    args = parser.parse_args(argv)
    done = cases_in(args.keep)
    while left := chosen(args.cases, done):
        print(f"{len(left)} cases to run, seeds {left[0][1]} to {left[-1][1]}", file=sys.stderr)
        for case in all_varied(left, args.only, args.workers, without=args.without):
            done.append(case)
            if args.keep:
                with args.keep.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(asdict(case)) + "\n")
    varied_cases = [case for case in done if case.prices is not None]
    text = table(varied_cases, args.only or names())
    print(text)
    if args.page:
        PAGE.write_text(page(text, varied_cases, len(done) - len(varied_cases)), encoding="utf-8")
    return 0


def table(cases: Sequence[Varied], of: Sequence[str]) -> str:
    """The prices, one a line."""
    head = "| price | value | cases that read it | 30 % less | 30 % more | without it |\n|---|---|---|---|---|---|"
    return "\n".join([head, *(row(name, cases) for name in of)])


def page(text: str, cases: Sequence[Varied], left_out: int) -> str:
    """``docs/prices.md``; `left_out` cases took too long."""
    unchanged = [name for name in names() if not _changed(name, cases, len(FACTORS))]
    idle = [name for name in WITHOUT if not _changed(name, cases, len(FACTORS) + 1)]
    return f"""# Sensitivity of the search to its prices

Every prior, penalty and threshold of the search stands in `calib/gap/search/prices.py`, with its meaning, unit and
source. `python -m bench.prices` changes one at a time by 30 % either way and diagnoses development cases: single
effects, mixtures, unknown errors and nulls in turn, seeds from {FIRST_SEED}.

This table has {len(cases)} cases. {left_out} more are left out, most of them mixtures: one plain diagnosis took over
{LONGEST_S:g} s of processor time. With the prices as they are, {sum(c.right for c in cases)} answers name the true
effects and no others.

A cell counts the answers that change: verdict, unknown error, or an effect with its instances. In brackets: how many
more answers are right. The last column has the price at a value that charges and bars nothing, over the cases in which
that was tried. Grids and reaches have no such value.

{len(unchanged)} of {len(names())} prices change no answer of these cases by 30 % either way; {len(idle)} change none
without it. A price that few cases read, or none, is one of flights or of rare events: this table says nothing of it.

{text}
"""


def _changed(name: str, cases: Sequence[Varied], values: int) -> bool:
    """Whether one of the first `values` other values of a price changes an answer."""
    return any(changed for case in cases for changed, _ in (case.prices or {}).get(name, ())[:values])


if __name__ == "__main__":
    sys.exit(main())
