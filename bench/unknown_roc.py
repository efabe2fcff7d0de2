"""``python -m bench.unknown_roc``: what is rejected as unknown against what is falsely so, over every limit.

Unknown errors of the withheld-effect check (T5) are to be rejected; nulls (T0), single effects (T1) and mixtures (T3)
are not. *Before* ranks a case by the share that has no name, *after* also by the bets on what is left over
(:mod:`calib.gap.unknown.discrepancy`). Both are read off one diagnosis: the bets change nothing but what is called
unknown.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from mavcal.calib import gap, logs
from mavcal.calib.converter import make_converter
from mavcal.calib.gap.unknown.discrepancy import BURSTS, WAVES
from mavcal.calib.withheld_check import Tier, make_case

PICTURE = Path(__file__).resolve().parents[1] / "docs" / "pictures" / "unknown-roc.svg"
_FLAGGED = 1e3
"""Added to the share of what was flagged before: it comes first after, too."""
_NOTHING = -1e3
_FALSE = (0.0, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5)
"""Shares of false unknowns at which a curve is read."""


@dataclass(frozen=True)
class Rejected:
    """One case: what was put in with its lambdas, what was named, and what was said to be unknown, by what share."""

    tier: str
    seed: int
    true: tuple[str, ...]
    severity: float
    net: float
    named: tuple[str, ...]
    flag: bool
    share: float
    shape: str
    log_odds: float | None

    @property
    def flag_before(self) -> bool:
        """Whether it was flagged for anything but a bet."""
        return self.flag and any(not part.startswith((BURSTS, WAVES)) for part in self.shape.split("; "))

    @property
    def before(self) -> float:
        """Rank without the bets."""
        return self.share if self.flag_before else 0.0

    @property
    def after(self) -> float:
        """Rank with them."""
        odds = _NOTHING if self.log_odds is None else self.log_odds
        return _FLAGGED + self.share if self.flag_before else odds

    @property
    def strange(self) -> bool:
        """Whether an unknown error was put in."""
        return self.tier == Tier.UNKNOWN.value


def diagnosed(tier: str, seed: int) -> Rejected:
    """A case made, written as two logs, and diagnosed from them."""
    case = make_case(Tier(tier), seed)
    with tempfile.TemporaryDirectory(prefix="mavcal-roc-") as folder:
        paths = [Path(folder) / f"{side}.npz" for side in ("real", "sim")]
        for path, columns in zip(paths, (case.real, case.sim), strict=True):
            np.savez(path, allow_pickle=False, **columns)
        real, sim = map(logs.read, paths)
    report = gap.run(real, sim, nested=False)
    entries: list[Mapping[str, Any]] = [*case.label["effects"], *case.label["unknown"]]
    own = case.label["unknown"] or case.label["effects"]
    unknown = report.unknown
    return Rejected(
        tier,
        seed,
        tuple(e["id"] for e in entries),
        sum(e["lambda"] for e in own),
        sum(e["net_lambda"] for e in own),
        tuple(e.id for e in report.effects),
        unknown.flag,
        unknown.share,
        unknown.shape,
        unknown.log_odds,
    )


def curve(rows: Sequence[Rejected], rank: Callable[[Rejected], float]) -> list[tuple[float, float]]:
    """Points (false, rejected) for every limit of a rank, from the strictest on."""
    strange = np.array([rank(r) for r in rows if r.strange])
    known = np.array([rank(r) for r in rows if not r.strange])
    limits = np.unique([*strange, *known])[::-1]
    return [(0.0, 0.0), *((float((known >= x).mean()), float((strange >= x).mean())) for x in limits)]


def area(points: Sequence[tuple[float, float]]) -> float:
    """Under a curve: the chance that an unknown error ranks above what is none."""
    x, y = np.array(points).T
    return float(np.trapezoid(y, x))


def at_most(points: Sequence[tuple[float, float]], false: float) -> float:
    """The largest share that is rejected at no more than `false`."""
    return max(y for x, y in points if x <= false)


def table(rows: Sequence[Rejected]) -> list[str]:
    """Lines of a table of both curves, and of the flags as they are."""
    before, after = curve(rows, lambda r: r.before), curve(rows, lambda r: r.after)
    strange, known = [r for r in rows if r.strange], [r for r in rows if not r.strange]
    lines = ["| | before | after |", "|---|---|---|"]
    for name, mine in (("unknown errors rejected", strange), ("falsely called unknown", known)):
        old, new = sum(r.flag_before for r in mine), sum(r.flag for r in mine)
        lines.append(f"| {name}, of {len(mine)} | {old} | {new} |")
    lines += [f"| rejected at false <= {x:g} | {at_most(before, x):.3f} | {at_most(after, x):.3f} |" for x in _FALSE]
    return [*lines, f"| area | {area(before):.3f} | {area(after):.3f} |"]


def drawn(rows: Sequence[Rejected]) -> str:
    """Both curves as SVG."""
    size, margin = 300.0, 46.0

    def line(rank: Callable[[Rejected], float], colour: str) -> str:
        points = " ".join(f"{margin + x * size:.1f},{margin + (1.0 - y) * size:.1f}" for x, y in curve(rows, rank))
        return f'<polyline points="{points}" fill="none" stroke="{colour}" stroke-width="2"/>'

    def text(x: float, y: float, words: str, *, colour: str = "#333", turn: str = "") -> str:
        return f'<text x="{x:g}" y="{y:g}" fill="{colour}" text-anchor="middle"{turn}>{words}</text>'

    end, middle = margin + size, margin + 0.5 * size
    ticks = [text(margin + x * size, end + 16, f"{x:g}") for x in (0.0, 0.5, 1.0)]
    ticks += [text(margin - 16, end - y * size + 4, f"{y:g}") for y in (0.5, 1.0)]
    parts = [
        f'<rect x="{margin}" y="{margin}" width="{size}" height="{size}" fill="#fff" stroke="#999"/>',
        *ticks,
        line(lambda r: r.before, "#c60"),
        line(lambda r: r.after, "#06c"),
        text(middle, end + 34, "falsely called unknown"),
        text(14, middle, "unknown errors rejected", turn=f' transform="rotate(-90 14 {middle})"'),
        text(middle - 40, margin - 12, "before", colour="#c60"),
        text(middle + 40, margin - 12, "after", colour="#06c"),
    ]
    whole = size + 2.0 * margin
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {whole:g} {whole:g}" '
        f'font-family="sans-serif" font-size="12">{"".join(parts)}</svg>\n'
    )


def measured(cases: Sequence[tuple[str, int]], processes: int, keep: Path | None) -> list[Rejected]:
    """Every case diagnosed; each is kept as a JSON line as soon as it is there."""
    rows: list[Rejected] = []
    with ProcessPoolExecutor(processes, mp_context=get_context("spawn")) as pool:
        for done in as_completed([pool.submit(diagnosed, *case) for case in cases]):
            rows.append(done.result())
            if keep is not None:
                with keep.open("a", encoding="utf-8") as out:
                    out.write(json.dumps(asdict(rows[-1])) + "\n")
            print(f"{len(rows)} of {len(cases)}", file=sys.stderr, flush=True)
    return rows


def read(path: Path) -> list[Rejected]:
    """What was kept."""
    made = make_converter()
    return [made.structure(json.loads(line), Rejected) for line in path.read_text(encoding="utf-8").splitlines()]


def main(argv: Sequence[str] | None = None) -> int:
    """Run the cases, or score those that were kept; print the table."""
    parser = argparse.ArgumentParser(prog="python -m bench.unknown_roc", description=__doc__)
    parser.add_argument("--seed", type=int, default=97001, help="first of each tier; sealed from 1000000")
    for tier, count in (("unknown", 20), ("nulls", 10), ("singles", 10), ("mixtures", 0)):
        parser.add_argument(f"--{tier}", type=int, default=count)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--answers", type=Path, help="keep a JSON line a case here")
    parser.add_argument("--score-only", action="store_true", help="score what --answers holds")
    parser.add_argument("--picture", action="store_true", help=f"write {PICTURE.name}")
    asked = parser.parse_args(argv)
    counts = {"T5": asked.unknown, "T0": asked.nulls, "T1": asked.singles, "T3": asked.mixtures}
    cases = [(tier, seed) for tier, count in counts.items() for seed in range(asked.seed, asked.seed + count)]
    rows = read(asked.answers) if asked.score_only else measured(cases, asked.processes, asked.answers)
    for tier in counts:
        if mine := [r.seed for r in rows if r.tier == tier]:
            print(f"{tier}: {len(mine)} cases, seeds {min(mine)} to {max(mine)}")
    print("\n".join(table(rows)))
    for r in rows:
        if r.flag != r.flag_before or (r.flag and not r.strange):
            print(f"{r.tier} {r.seed} {', '.join(r.true)} lambda {r.severity:.0f}: {r.shape}")
    if asked.picture:
        PICTURE.write_text(drawn(rows), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
