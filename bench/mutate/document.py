"""The page of a run of mutants."""

from __future__ import annotations

import tomllib
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from bench.mutate.trial import Verdict

EQUIVALENT = Path(__file__).with_name("equivalent.toml")
"""Survivors that change nothing anybody could see, with the reason; the key is `path: text`."""


def written(rows: Sequence[Mapping[str, Any]], seed: int) -> str:
    """Killed by room and by module, and every survivor."""
    reasons: Mapping[str, str] = tomllib.loads(EQUIVALENT.read_text(encoding="utf-8")) if EQUIVALENT.exists() else {}
    killed = sum(row["verdict"] != Verdict.SURVIVED for row in rows)
    lines = [
        "# Mutations of the code",
        "",
        "One operator, constant, condition or statement is changed at a time. The tests of the module and of its room",
        f"run. `scripts/mutate --seed {seed} --count {len(rows)} --write` writes this page; the sample of all mutants",
        "is drawn with that seed. A mutant that takes four times the processor time of its tests is noticed.",
        "Only unit tests are asked: what `tests/link` and `tests/service` would notice does not count.",
        "",
        f"{killed} of {len(rows)} were killed ({100 * killed / max(len(rows), 1):.0f} %; the target is 90 %).",
        "",
        "| room | mutants | killed | of these by time | survived |",
        "|---|---|---|---|---|",
    ]
    for room in sorted({row["room"] for row in rows}):
        count = Counter(row["verdict"] for row in rows if row["room"] == room)
        late = count[Verdict.TIMED_OUT]
        lines.append(
            f"| {room} | {count.total()} | {count[Verdict.KILLED] + late} | {late} | {count[Verdict.SURVIVED]} |"
        )
    lines += ["", "## Survivors", "", "| where | change | why it lives |", "|---|---|---|"]
    for row in sorted((r for r in rows if r["verdict"] == Verdict.SURVIVED), key=lambda r: (r["path"], r["line"])):
        why = reasons.get(f"{row['path']}: {row['text']}", "no test notices it yet")
        text = row["text"].replace("|", "\\|")
        lines.append(f"| {row['path']}:{row['line']} | `{text}` | {why} |")
    return "\n".join(lines) + "\n"
