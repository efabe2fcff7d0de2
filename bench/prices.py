"""``python -m bench.prices``: changes each price of the search by 30 % down and up, and counts the answers that change.

Cases are development cases of the withheld-effect check: singles, mixtures, unknown errors and nulls in turn. An answer
is its verdict and the instances of every effect that it names. A price that changes none of them may go. A whole table
of 200 cases takes some hours; ``--cases`` and ``--only`` make a part of it, ``--page`` writes ``docs/prices.md``.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from mavcal.calib import gap, logs
from mavcal.calib.gap.search import prices
from mavcal.calib.withheld_check import Tier, make_case

PAGE = Path(__file__).resolve().parents[1] / "docs" / "prices.md"
CASES = 200
FIRST_SEED = 70_000
"""Development seeds; sealed ones begin at 1 000 000."""
TIERS = (Tier.SINGLE, Tier.MIXED, Tier.UNKNOWN, Tier.NULL)
FACTORS = (0.7, 1.3)

Answer = tuple[str, tuple[tuple[str, tuple[int, ...]], ...]]
"""Verdict, and the effects that are named with their instances."""


@dataclass(frozen=True)
class Changed:
    """How many answers a price changes, by factor, and how many name the true effects before and after."""

    name: str
    value: str
    answers: tuple[int, ...]
    right: tuple[int, ...]

    def row(self, cases: int, right: int) -> str:
        """A line of the table."""
        cells = [f"{n} of {cases} ({r - right:+d})" for n, r in zip(self.answers, self.right, strict=True)]
        return f"| `{self.name}` | {self.value} | {' | '.join(cells)} |"


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


def answered(tier: Tier, seed: int, name: str | None, factor: float) -> tuple[Answer, bool]:
    """The answer to a case with one price changed (None: none), and whether it names the true effects alone."""
    if name is not None:
        setattr(prices, name, scaled(getattr(prices, name), factor))
    case = make_case(tier, seed)
    with tempfile.TemporaryDirectory() as folder:
        paths = {side: Path(folder) / f"{side}.npz" for side in ("real", "sim")}
        for side, columns in (("real", case.real), ("sim", case.sim)):
            np.savez(paths[side], allow_pickle=False, **columns)
        report = gap.run(logs.read(paths["real"]), logs.read(paths["sim"]), nested=False, without=case.without)
    named = tuple(sorted((e.id, tuple(e.instances)) for e in report.effects))
    true = {e["id"] for e in case.label["effects"]}
    right = {i for i, _ in named} == true and report.unknown.flag == bool(case.label["unknown"])
    return (report.verdict.value, named), right


def chosen(cases: int) -> list[tuple[Tier, int]]:
    """Cases of every tier in turn."""
    return [(TIERS[k % len(TIERS)], FIRST_SEED + k) for k in range(cases)]


def changes(cases: Sequence[tuple[Tier, int]], only: Sequence[str], workers: int) -> Iterator[tuple[Changed, int]]:
    """Price by price what changes, and how many answers are right with the prices as they are."""
    context = get_context("spawn")
    with ProcessPoolExecutor(workers, mp_context=context, max_tasks_per_child=1) as pool:

        def run(name: str | None, factor: float) -> list[tuple[Answer, bool]]:
            return [f.result() for f in [pool.submit(answered, t, s, name, factor) for t, s in cases]]

        base = run(None, 1.0)
        right = sum(ok for _, ok in base)
        for name in only or names():
            other = [run(name, factor) for factor in FACTORS]
            answers = tuple(sum(a != b for (a, _), (b, _) in zip(base, new, strict=True)) for new in other)
            yield (
                Changed(name, shown(getattr(prices, name)), answers, tuple(sum(ok for _, ok in n) for n in other)),
                right,
            )


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
    parser.add_argument("--page", action="store_true", help="write docs/prices.md")
    args = parser.parse_args(argv)
    cases = chosen(args.cases)
    print(f"seeds {FIRST_SEED} to {FIRST_SEED + len(cases) - 1}", file=sys.stderr)
    header = "| price | value | 30 % less | 30 % more |\n|---|---|---|---|"
    print(header, flush=True)
    rows, right = [], 0
    for one, right in changes(cases, args.only, args.workers):
        rows.append(one.row(len(cases), right))
        print(rows[-1], flush=True)
    print(f"right with the prices as they are: {right} of {len(cases)}")
    if args.page:
        PAGE.write_text(page("\n".join([header, *rows]), len(cases), right), encoding="utf-8")
    return 0


def page(table: str, cases: int, right: int) -> str:
    """``docs/prices.md``."""
    return f"""# What the prices of the search do

Every prior, penalty and threshold of the search stands in `calib/gap/search/prices.py`, with its meaning, unit and
source. `python -m bench.prices --cases {cases} --page` changes one at a time by 30 % either way and diagnoses {cases}
development cases. They are single effects, mixtures, unknown errors and nulls in turn, seeds from {FIRST_SEED}. With
the prices as they are, {right} of {cases} answers name the true effects and no others.

A cell says how many answers change (verdict, or an effect with its instances). In brackets: how many more are right.

{table}
"""


if __name__ == "__main__":
    sys.exit(main())
