"""The page of a run of mutants."""

from __future__ import annotations

import tomllib
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bench.mutate.trial import Verdict

EQUIVALENT = Path(__file__).with_name("equivalent.toml")
"""Survivors that change nothing anybody could see, with the reason; the key is `path: text`."""


LAST_COUNTS = (
    "Tests were written for survivors of the first seed. Nobody worked on those of the last: its figure counts."
)
FLATTERED = "Tests may have been written for survivors of this sample: a fresh seed says more than its figure."


@dataclass(frozen=True)
class Drawn:
    """A sample and what became of it."""

    seed: int
    rows: tuple[Mapping[str, Any], ...]

    @property
    def survivors(self) -> list[Mapping[str, Any]]:
        """In the order of the code."""
        return sorted((r for r in self.rows if r["verdict"] == Verdict.SURVIVED), key=lambda r: (r["path"], r["line"]))

    @property
    def killed(self) -> int:
        """What is equivalent counts as a survivor."""
        return len(self.rows) - len(self.survivors)

    @property
    def share(self) -> float:
        """Share of the whole sample that was killed."""
        return self.killed / max(len(self.rows), 1)


def written(drawn: Sequence[Drawn], there: Mapping[str, int], commit: str) -> str:
    """Killed by room and sample, and every survivor; `there` has the number of all mutants of each room."""
    reasons: Mapping[str, str] = tomllib.loads(EQUIVALENT.read_text(encoding="utf-8")) if EQUIVALENT.exists() else {}
    seeds = " ".join(f"--seed {one.seed}" for one in drawn)
    each = max(len([r for r in one.rows if r["room"] == room]) for one in drawn for room in there)
    lines = [
        "# Mutations of the code",
        "",
        "One operator, constant, condition or statement is changed at a time, and the unit tests that reach its lines",
        "run, cheap ones first. Link and service tests are not asked. Constants are moved by one, time-outs included.",
        "A mutant that takes four times the processor time of its tests is noticed; a failing test must fail twice.",
        f"`scripts/mutate --each {each} {seeds} --write` draws the same number of mutants in each room and writes this",
        f"page; this one is of {commit}. Equivalent mutants count as survivors.",
        "",
        LAST_COUNTS if len(drawn) > 1 else FLATTERED,
        f"The target is 90 %. {_of_those_that_matter(drawn[-1], reasons)}",
        "",
        "| seed | room | mutants there | sampled | killed | killed by time | survived | equivalent |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for one in drawn:
        for room, number in there.items():
            lines.append(_row(f"{one.seed} | {room} | {number}", [r for r in one.rows if r["room"] == room], reasons))
        lines.append(_row(f"{one.seed} | **all** | {sum(there.values())}", one.rows, reasons))
    for one in drawn:
        lines += ["", f"## Survivors of seed {one.seed}", "", "| where | change | why it lives |", "|---|---|---|"]
        lines += _survivors(one, reasons)
    return "\n".join(lines) + "\n"


def _of_those_that_matter(one: Drawn, reasons: Mapping[str, str]) -> str:
    same = sum(_key(row) in reasons for row in one.survivors)
    matter = len(one.rows) - same
    share = f"{100 * one.killed / max(matter, 1):.0f} %"
    return (
        f"Without the {same} equivalent ones, {one.killed} of {matter} mutants of the last sample are killed ({share})."
    )


def _row(begin: str, rows: Sequence[Mapping[str, Any]], reasons: Mapping[str, str]) -> str:
    count = Counter(row["verdict"] for row in rows)
    late, alive = count[Verdict.TIMED_OUT], count[Verdict.SURVIVED]
    same = sum(row["verdict"] == Verdict.SURVIVED and _key(row) in reasons for row in rows)
    share = f"{100 * (len(rows) - alive) / max(len(rows), 1):.0f} %"
    return f"| {begin} | {len(rows)} | {len(rows) - alive} ({share}) | {late} | {alive} | {same} |"


def _survivors(one: Drawn, reasons: Mapping[str, str]) -> Iterator[str]:
    for row in one.survivors:
        why = reasons.get(_key(row)) or ("no test notices it yet" if row["asked"] else "no test reaches it")
        text = row["text"].replace("|", "\\|")
        yield f"| {row['path']}:{row['line']} | `{text}` | {why} |"


def _key(row: Mapping[str, Any]) -> str:
    return f"{row['path']}: {row['text']}"
