"""``python -m bench.shortcuts``: how much longer a diagnosis takes without each shortcut of the search.

A shortcut leaves work out: candidates that are not refined, exchanges that are not tried. It should change no answer,
so the rule of decision 43 does not apply to it. The table divides the processor time without it by the time with it.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from unittest.mock import patch

from bench.prices import FIRST_SEED, LONGEST_S, TIERS, flights, question_of, question_of_flight
from bench.varied_search import SHORTCUTS, WITHOUT, Answer, GapQuestion
from mavcal.calib.gap.search import prices
from mavcal.calib.withheld_check import make_case


@dataclass(frozen=True)
class TimedAnswer:
    """One diagnosis: its answer, and the processor time that it took."""

    answer: Answer
    seconds: float


Timed = tuple[TimedAnswer, tuple[TimedAnswer, ...]]
"""A case with all shortcuts, and without each of :data:`SHORTCUTS`."""


def timed(number: int) -> Timed | None:
    """Diagnose a development case with all shortcuts and without each; None if it takes more than `LONGEST_S`."""
    return _timed(question_of(make_case(TIERS[number % len(TIERS)], FIRST_SEED + number)), LONGEST_S)


def timed_flight(number: int, data: Path) -> Timed | None:
    """The same of a flight of known answer, however long it takes."""
    return _timed(question_of_flight(number, data), math.inf)


def _timed(question: GapQuestion, longest_s: float) -> Timed | None:
    _diagnosed(question)  # what is computed once a process belongs to none of them
    plain = _diagnosed(question)
    if plain.seconds > longest_s:
        return None
    found = []
    for name in SHORTCUTS:
        with absent(name):
            found.append(_diagnosed(question))
    return plain, tuple(found)


@contextmanager
def absent(name: str) -> Iterator[None]:
    """In here the shortcut `name` is not taken."""
    with patch.object(prices, name, WITHOUT[name]):
        yield


def _diagnosed(question: GapQuestion) -> TimedAnswer:
    began = time.process_time()
    answer = question.answer()
    return TimedAnswer(answer, time.process_time() - began)


def table(cases: Sequence[Timed]) -> str:
    """One shortcut a line: the ratio of times over all cases, the largest ratio of one case, and changed answers."""
    rows = ["| shortcut | time without it | at most | answers that change |", "|---|---|---|---|"]
    for k, name in enumerate(SHORTCUTS):
        ratios = [without[k].seconds / plain.seconds for plain, without in cases]
        total = sum(without[k].seconds for _, without in cases) / sum(plain.seconds for plain, _ in cases)
        changed = sum(without[k].answer != plain.answer for plain, without in cases)
        rows.append(f"| `{name}` | {total:.2f} | {max(ratios):.2f} | {changed} of {len(cases)} |")
    return "\n".join(rows)


def main(argv: Sequence[str] | None = None) -> int:
    """Print the table."""
    names = [name for name, _ in flights()]
    parser = argparse.ArgumentParser(prog="python -m bench.shortcuts", description=__doc__)
    parser.add_argument("--cases", type=int, default=40, help="cases of every tier in turn; long ones are left out")
    parser.add_argument("--flights", type=Path, metavar="DATA", help="flights of known answer in this folder instead")
    parser.add_argument("--only", nargs="*", default=names, choices=names, metavar="FLIGHT", help="only these flights")
    parser.add_argument("--workers", type=int, default=2)
    args = parser.parse_args(argv)
    with ProcessPoolExecutor(args.workers, mp_context=get_context("spawn")) as pool:
        if args.flights:
            runs = [pool.submit(timed_flight, names.index(name), args.flights) for name in args.only]
        else:
            runs = [pool.submit(timed, number) for number in range(args.cases)]
        cases = [case for run in runs if (case := run.result()) is not None]
    what = ", ".join(args.only) if args.flights else f"cases from seed {FIRST_SEED}"
    print(f"{len(cases)} of {len(runs)} {what}; {len(runs) - len(cases)} take too long")
    if cases:
        print(table(cases))
    return 0 if cases else 1


if __name__ == "__main__":
    sys.exit(main())
