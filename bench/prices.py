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
import sys
import tempfile
import textwrap
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass
from itertools import count, islice
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from bench.flights import ANSWERS, unpacked
from bench.varied_search import FACTORS, SHORTCUTS, WITHOUT, Answer, GapQuestion, changes, names, other_values
from mavcal.calib import logs
from mavcal.calib.gap.search import prices
from mavcal.calib.withheld_check import Case, Tier, make_case

PAGE = Path(__file__).resolve().parents[1] / "docs" / "prices.md"
CASES = 200
FIRST_SEED = 70_000
"""Development seeds; sealed ones begin at 1 000 000."""
TIERS = (Tier.SINGLE, Tier.MIXED, Tier.UNKNOWN, Tier.NULL)
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


def varied(tier: Tier, seed: int, only: Sequence[str] = (), *, without: bool = False) -> Varied:
    """Diagnose a case with the prices as they are, and with other values of each price that is read."""
    right, found = changes(question_of(make_case(tier, seed)), _others(only, without=without), LONGEST_S)
    return Varied(tier.value, seed, right, found)


def varied_flight(number: int, data: Path, only: Sequence[str] = (), *, without: bool = False) -> Varied:
    """The same of a flight of known answer, by its number among :func:`flights`."""
    right, found = changes(question_of_flight(number, data), _others(only, without=without))
    return Varied(flights()[number][0], number, right, found)


def _others(only: Sequence[str], *, without: bool) -> dict[str, list[Any]]:
    return {name: other_values(name, without=without) for name in only or names()}


def flights() -> list[tuple[str, Mapping[str, Any]]]:
    """Flights whose gap is known, by name."""
    answers = tomllib.loads(ANSWERS.read_text(encoding="utf-8"))["log"]
    return [(answer["name"], answer) for answer in answers if "gap" in answer]


def _as_known(answer: Answer, known: Mapping[str, Any]) -> bool:
    verdict, _, effects = answer
    named = {f"{name} {instance}" for name, instances in effects for instance in instances}
    return verdict in known["verdict"] and set(known["effects"]) <= named <= {*known["effects"], *known.get("also", ())}


def question_of(case: Case) -> GapQuestion:
    """The two recordings of a case; right is an answer that names the true effects alone, and an unknown error where
    there is one.
    """
    true, unknown = {e["id"] for e in case.label["effects"]}, bool(case.label["unknown"])
    with tempfile.TemporaryDirectory() as folder:
        paths = {side: Path(folder) / f"{side}.npz" for side in ("real", "sim")}
        for side, columns in (("real", case.real), ("sim", case.sim)):
            np.savez(paths[side], allow_pickle=False, **columns)
        real, sim = logs.read(paths["real"]), logs.read(paths["sim"])
    return GapQuestion(
        real, sim, lambda answer: {name for name, _ in answer[2]} == true and answer[1] == unknown, case.without
    )


def question_of_flight(number: int, data: Path) -> GapQuestion:
    """The two logs of a flight in the folder `data`; right is an answer with its known effects."""
    _, asked = flights()[number]
    with tempfile.TemporaryDirectory() as folder:
        real, sim = (logs.read(unpacked(data, file, Path(folder))) for file in (asked["file"], asked["gap"]["sim"]))
    return GapQuestion(real, sim, lambda answer: _as_known(answer, asked["gap"]))


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


Run = tuple[Callable[..., Varied], tuple[Any, ...]]
"""The function that varies one case, and its arguments."""


def all_varied(runs: Sequence[Run], only: Sequence[str], workers: int, *, without: bool = False) -> Iterator[Varied]:
    """Case by case, each in a process of its own, as they are done."""
    context = get_context("spawn")
    with ProcessPoolExecutor(workers, mp_context=context, max_tasks_per_child=1) as pool:
        for done in as_completed([pool.submit(run, *of, only, without=without) for run, of in runs]):
            yield done.result()


def left_of(cases: int, data: Path | None, done: Sequence[Varied]) -> list[Run]:
    """Runs that are left: development cases, and the flights if their folder `data` is given."""
    known = {case.tier for case in done}
    flown = [(varied_flight, (k, data)) for k, (name, _) in enumerate(flights()) if data and name not in known]
    return [*flown, *((varied, one) for one in chosen(cases, done))]


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
    parser.add_argument("--flights", type=Path, metavar="DATA", help="the flights of known answer in this folder too")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--keep", type=Path, metavar="FILE", help="a JSON line a case; cases in it are not run again")
    parser.add_argument("--page", action="store_true", help="write docs/prices.md")
    args = parser.parse_args(argv)
    done = cases_in(args.keep)
    while left := left_of(args.cases, args.flights, done):
        print(f"{len(left)} cases to run", file=sys.stderr)
        for case in all_varied(left, args.only, args.workers, without=args.without):
            done.append(case)
            if args.keep:
                with args.keep.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(asdict(case)) + "\n")
    print(table(_development(done), args.only or names()))
    print(table(_flown(done), args.only or names()))
    if args.page:
        PAGE.write_text(page(done), encoding="utf-8")
    return 0


def _development(done: Sequence[Varied]) -> list[Varied]:
    return [case for case in done if case.prices is not None and case.tier in {tier.value for tier in TIERS}]


def _flown(done: Sequence[Varied]) -> list[Varied]:
    return [case for case in done if case.tier not in {tier.value for tier in TIERS}]


def table(cases: Sequence[Varied], of: Sequence[str]) -> str:
    """The prices, one a line."""
    head = "| price | value | cases that read it | 30 % less | 30 % more | without it |\n|---|---|---|---|---|---|"
    return "\n".join([head, *(row(name, cases) for name in of)])


def page(done: Sequence[Varied]) -> str:
    """``docs/prices.md``."""
    cases, flown = _development(done), _flown(done)
    return f"""# Sensitivity of the search to its prices

Every prior, penalty and threshold of the search stands in `calib/gap/search/prices.py`, with its meaning, unit and
source. `python -m bench.prices` changes one at a time by 30 % either way and diagnoses development cases: single
effects, mixtures, unknown errors and nulls in turn, seeds from {FIRST_SEED}.

The first table has {len(cases)} cases; {sum(c.right for c in cases)} answers name the true effects and no others.
{sum(case.prices is None for case in done)} more cases are left out, most of them mixtures: one plain diagnosis
took over {LONGEST_S:g} s of processor time. The second table has the {len(flown)} flights of known answer in
`bench/flights.toml`; {sum(c.right for c in flown)} answers are right.

A cell counts the answers that change: verdict, unknown error, or an effect with its instances. In brackets: how many
more answers are right. The last column has the price at a value that charges and bars nothing, over the cases in which
that was tried. Grids and reaches have no such value. With `--only`, prices that were not tried do not count as read.

{_summary([*cases, *flown])}

## Development cases

{table(cases, names())}

## Flights

{table(flown, names())}
"""


def _summary(cases: Sequence[Varied]) -> str:
    """How many prices change nothing, and which of them are no shortcuts."""
    unchanged = sum(not _changed(name, cases, len(FACTORS)) for name in names())
    others = [name for name in WITHOUT if name not in SHORTCUTS and not _changed(name, cases, len(FACTORS) + 1)]
    text = f"""Changed by 30 % either way, {unchanged} of {len(names())} prices change no answer. The {len(SHORTCUTS)}
shortcuts among them save time, and are there to change nothing (`python -m bench.shortcuts`). None of the
answers below changes without these {len(others)} others either:"""
    listed = textwrap.indent(textwrap.fill(", ".join(others), 110), "    ")
    why = "[Decision 43](decisions/0043-when-a-price-goes.md) says why they stay, and when a price goes."
    return f"{textwrap.fill(text, 119, break_on_hyphens=False)}\n\n{listed}\n\n{why}"


def _changed(name: str, cases: Sequence[Varied], values: int) -> bool:
    """Whether one of the first `values` other values of a price changes an answer."""
    return any(changed for case in cases for changed, _ in (case.prices or {}).get(name, ())[:values])


if __name__ == "__main__":
    sys.exit(main())
