"""``python -m bench.prices``: changes each price of the search by 30 % down and up, and counts the answers that change.

Cases are development cases of the withheld-effect check: singles, mixtures, unknown errors and nulls in turn. An answer
is its verdict and the instances of every effect that it names. Where a diagnosis reads a price for the first time, its
process forks: one child goes on with less, one with more. A child whose search ends as its parent's did ends there,
unless its price is read later too. A price that changes no answer may go.

200 cases take many hours. A case whose plain diagnosis takes more than eight seconds is left out, since it would take
as long again for each price; the next of its kind comes in its place. ``--keep FILE`` holds a line a case: the same
command goes on where it was stopped. ``--page`` writes ``docs/prices.md`` from the cases that are there.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import time
import traceback
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
LONGEST_S = 8.0
"""Processor time of a plain diagnosis above which a case is left out."""


@dataclass(frozen=True)
class Varied:
    """One case: whether its answer is right, and for each price that it reads what 30 % less and 30 % more do.

    `prices` maps a name to one pair a factor: whether the answer changes, and whether it is right then. None: the
    case takes too long.
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

    def read(self, name: str) -> None:
        if self.end is not None:
            self.late.add(name)

    def searched(self, end: SearchEnd) -> None:
        self.end = end


class _Fork:
    """Divides a diagnosis at the first reading of each price: what comes before is the same for every value of it.

    `unchanged` is what a child says whose diagnosis must end as the `plain` one did.
    """

    def __init__(self, only: Sequence[str], plain: _Plain, unchanged: tuple[bool, bool]) -> None:
        self._open = set(only or names())
        self._plain, self._unchanged = plain, unchanged
        self._pipe: int | None = None
        """Where a child's answer goes; None in the parent."""
        self._varied = ""
        self.changed: dict[str, list[tuple[bool, bool]]] = {}

    def read(self, name: str) -> None:
        """A price is about to be read: the parent comes back with it as it was, each child with another one."""
        if name not in self._open:
            return
        self._open.remove(name)
        value = vars(prices)[name]
        for factor in FACTORS:
            answer = self._answer_of_child()
            if self._pipe is not None:
                self._open.clear()
                self._varied = name
                setattr(prices, name, scaled(value, factor))
                return
            self.changed.setdefault(name, []).append(answer)

    def searched(self, end: SearchEnd) -> None:
        """A child ends here if nothing can be different any more."""
        if end == self._plain.end and self._varied not in self._plain.late:
            self.end_child(self._unchanged)

    def _answer_of_child(self) -> Any:
        reading, writing = os.pipe()
        child = os.fork()
        if child == 0:
            os.close(reading)
            self._pipe = writing
            return None
        os.close(writing)
        with os.fdopen(reading) as pipe:
            text = pipe.read()
        if os.waitpid(child, 0)[1] != 0:
            raise RuntimeError("a diagnosis with another price failed: its traceback stands above")
        return tuple(json.loads(text))

    def end_child(self, answer: tuple[bool, bool]) -> None:
        """A child hands its answer on and ends; the parent goes on."""
        if self._pipe is not None:
            os.write(self._pipe, json.dumps(answer).encode())
            os._exit(0)

    def fail_child(self) -> None:
        """The same for a child that failed."""
        if self._pipe is not None:
            traceback.print_exc()
            os._exit(1)


class _ReadPrices(ModuleType):
    """The module of prices, which says when one is read."""

    def __getattribute__(self, name: str) -> Any:
        if name.isupper():
            super().__getattribute__("watch").read(name)
        return super().__getattribute__(name)


@contextmanager
def watched(watch: _Plain | _Fork) -> Iterator[None]:
    """In here `watch` hears of every price that is read, and of the end of a search."""
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


def scaled(value: Any, factor: float) -> Any:
    """A price times `factor`: counts are rounded away from what they were, tables and grids scaled as a whole."""
    if isinstance(value, int):
        return max(0, int(np.floor(value * factor)) if factor < 1.0 else int(np.ceil(value * factor)))
    if isinstance(value, Mapping):
        return {key: scaled(one, factor) for key, one in value.items()}
    if isinstance(value, tuple):
        return tuple(scaled(one, factor) for one in value)
    return value * factor


def varied(tier: Tier, seed: int, only: Sequence[str] = ()) -> Varied:
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
    fork = _Fork(only, plain, (False, right(case, before)))
    try:
        with watched(fork):
            after = named(case, real, sim)
        fork.end_child((after != before, right(case, after)))
    except BaseException:
        fork.fail_child()
        raise
    return Varied(tier.value, seed, right(case, before), fork.changed)


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


def all_varied(cases: Sequence[tuple[Tier, int]], only: Sequence[str], workers: int) -> Iterator[Varied]:
    """Case by case, each in a process of its own, as they are done."""
    context = get_context("spawn")
    with ProcessPoolExecutor(workers, mp_context=context, max_tasks_per_child=1) as pool:
        for done in as_completed([pool.submit(varied, tier, seed, only) for tier, seed in cases]):
            yield done.result()


def row(name: str, cases: Sequence[Varied]) -> str:
    """A line of the table: cases that read the price, answers that each factor changes, and how many more are right."""
    reading = [(case, case.prices[name]) for case in cases if case.prices and name in case.prices]
    cells = [f"| `{name}` | {shown(getattr(prices, name))} | {len(reading)} |"]
    for k, _ in enumerate(FACTORS):
        changed = sum(answers[k][0] for _, answers in reading)
        gained = sum(answers[k][1] - case.right for case, answers in reading)
        cells.append(f" {changed} ({gained:+d}) |")
    return "".join(cells)


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
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--keep", type=Path, metavar="FILE", help="a JSON line a case; cases in it are not run again")
    parser.add_argument("--page", action="store_true", help="write docs/prices.md")
    args = parser.parse_args(argv)
    done = cases_in(args.keep)
    while left := chosen(args.cases, done):
        print(f"{len(left)} cases to run, seeds {left[0][1]} to {left[-1][1]}", file=sys.stderr)
        for case in all_varied(left, args.only, args.workers):
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
    head = "| price | value | cases that read it | 30 % less | 30 % more |\n|---|---|---|---|---|"
    return "\n".join([head, *(row(name, cases) for name in of)])


def page(text: str, cases: Sequence[Varied], left_out: int) -> str:
    """``docs/prices.md``; `left_out` cases took too long."""
    unchanged = sum(not any(a for c in cases for a, _ in (c.prices or {}).get(name, ())) for name in names())
    return f"""# Sensitivity of the search to its prices

Every prior, penalty and threshold of the search stands in `calib/gap/search/prices.py`, with its meaning, unit and
source. `python -m bench.prices` changes one at a time by 30 % either way and diagnoses development cases: single
effects, mixtures, unknown errors and nulls in turn, seeds from {FIRST_SEED}.

This table has {len(cases)} cases. {left_out} more are left out, most of them mixtures: one plain diagnosis took over
{LONGEST_S:g} s of processor time. With the prices as they are, {sum(c.right for c in cases)} answers name the true
effects and no others.

A cell counts the answers that change: verdict, unknown error, or an effect with its instances. In brackets: how many
more answers are right. {unchanged} of {len(names())} prices change no answer of these cases. Where few cases read
a price, or none, it is one of flights or of rare events: this table says nothing of it.

{text}
"""


if __name__ == "__main__":
    sys.exit(main())
