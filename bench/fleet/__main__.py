"""``python -m bench.fleet [--runs 400] [--groups 1500] [--seed 1] [--limits] [--write]``.

Simulates sensors whose bias wanders in a known way, and counts how often the intervals of their drift hold the truth.
It also counts how often a group of healthy sensors is called odd, and how often one that is off is found. Exit code 1:
fewer than stated.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from bench.fleet.drift import WANDERS, Held, run
from bench.fleet.odd import SIZES, alarms, limit
from bench.preflight.page import put
from mavcal.calib.fleet.odd import FALSE_ALARMS
from mavcal.calib.fleet.trend import COVERAGE

PAGE = Path(__file__).resolve().parents[2] / "docs" / "fleet.md"
CALIBRATIONS = (4, 6, 12)
GROUPS = (6, 12, 31, 101)


def main() -> int:
    parser = argparse.ArgumentParser(prog="bench.fleet", description=__doc__)
    parser.add_argument("--runs", type=int, default=400, help="sensors of each kind")
    parser.add_argument("--groups", type=int, default=1500, help="groups of each size")
    parser.add_argument("--seed", type=int, default=1, help="first seed")
    parser.add_argument("--limits", action="store_true", help="print the limits by size of a group, and nothing else")
    parser.add_argument("--write", action="store_true", help="write the tables into docs/fleet.md")
    args = parser.parse_args()
    if args.limits:
        print(", ".join(f"{n}: {limit(n, 40_000, args.seed):.2f}" for n in SIZES))
        return 0
    began = time.process_time()
    print(f"seeds {args.seed} to {args.seed + args.runs - 1}", file=sys.stderr)
    drifts, held = drift_table(args.runs, args.seed)
    odd, rare = odd_table(args.groups, args.seed)
    print(f"{drifts}\n\n{odd}")
    print(f"\n{time.process_time() - began:.0f} s of processor time", file=sys.stderr)
    if args.write:
        PAGE.write_text(put(PAGE.read_text(encoding="utf-8"), drift=drifts, odd=odd), encoding="utf-8")
    return 0 if held and rare else 1


def drift_table(runs: int, seed: int) -> tuple[str, bool]:
    """The page of the drifts, and whether every date is held as often as stated, within 3 binomial deviations."""
    rows, met = [], True
    least = COVERAGE - 3.0 * np.sqrt(COVERAGE * (1.0 - COVERAGE) / runs)
    for wander in WANDERS:
        for n in CALIBRATIONS:
            found = [run(wander, n, seed + i) for i in range(runs)]
            met &= bool(np.mean([one.date for one in found]) >= least)
            rows.append((wander.name, str(n), *_shares(found)))
    head = ("bias", "calibrations", "date held", "left before it", "drift held", "slope held", "end within ten years")
    return _lines(head, rows), met


def _shares(found: Sequence[Held]) -> tuple[str, ...]:
    slopes = [one.slope for one in found if one.slope is not None]
    return (
        _percent([one.date for one in found]),
        _percent([one.early for one in found]),
        _percent([one.drift for one in found]),
        _percent(slopes) if slopes else "",
        _percent([one.dated for one in found]),
    )


def odd_table(groups: int, seed: int) -> tuple[str, bool]:
    """The page of odd sensors, and whether healthy groups are called odd as rarely as stated."""
    rows, met = [], True
    most = FALSE_ALARMS + 3.0 * np.sqrt(FALSE_ALARMS / groups)
    for n in GROUPS:
        healthy, _ = alarms(n, groups, seed)
        heavy, _ = alarms(n, groups, seed, tail=5.0)
        found = [alarms(n, groups // 4, seed, fault=off)[1] / (groups // 4) for off in (5.0, 10.0, 20.0)]
        met &= healthy / groups <= most
        rows.append((str(n), f"{healthy / groups:.2%}", f"{heavy / groups:.1%}", *(f"{x:.0%}" for x in found)))
    head = ("sensors", "healthy groups called odd", "the same, t with 5 degrees", "5 sd off: found", "10 sd", "20 sd")
    return _lines(head, rows), met


def _percent(shares: Sequence[float]) -> str:
    return f"{np.mean(shares):.1%}"


def _lines(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    return "\n".join(f"| {' | '.join(cells)} |" for cells in (head, ["---"] * len(head), *rows))


if __name__ == "__main__":
    sys.exit(main())
