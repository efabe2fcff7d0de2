"""``python -m bench.coverage``: which branches of some rooms no test takes; writes docs/coverage.md.

Reads what ``coverage json --branch`` left behind. A branch is a line and where it goes on; those that are not taken are
listed with their line and, where ``bench/coverage.toml`` has one, with the reason.
"""

from __future__ import annotations

import argparse
import json
import sys
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
REASONS = Path(__file__).with_suffix(".toml")
ROOMS = ("calib/firmware", "service/jobs", "service/vehicle")


def page(measured: Mapping[str, Any], reasons: Mapping[str, str], read: Mapping[str, Sequence[str]]) -> str:
    """The page of a measurement; `read` has the lines of each file, `reasons` the key ``path: line's text``."""
    files = {name: entry for name, entry in sorted(measured["files"].items()) if name.startswith(ROOMS)}
    lines = [
        "# Branches that the tests take",
        "",
        "`scripts/coverage` measures which branches of three rooms the unit tests take in their own process, and",
        "writes this page. Counted are the unit tests of these rooms, of logs, of the command line and of the HTTP",
        "face. Link and service tests take a quarter of an hour more and are not counted; the last table names them",
        "where they were seen to take a branch.",
        "",
        "| room | branches | taken | |",
        "|---|---|---|---|",
    ]
    for room in ROOMS:
        mine = [entry["summary"] for name, entry in files.items() if name.startswith(f"{room}/")]
        total, taken = sum(s["num_branches"] for s in mine), sum(s["covered_branches"] for s in mine)
        lines.append(f"| {room} | {total} | {taken} | {_percent(taken, total)} |")
    lines += ["", "| file | branches | taken | |", "|---|---|---|---|"]
    for name, entry in files.items():
        summary = entry["summary"]
        if total := summary["num_branches"]:
            taken = summary["covered_branches"]
            lines.append(f"| {name} | {total} | {taken} | {_percent(taken, total)} |")
    lines += ["", "## Not taken", "", "| where | branch | why |", "|---|---|---|"]
    for name, entry in files.items():
        lines += _rows(name, entry["missing_branches"], reasons, read[name])
    return "\n".join(lines) + "\n"


def _rows(
    name: str, missing: Sequence[Sequence[int]], reasons: Mapping[str, str], source: Sequence[str]
) -> Iterator[str]:
    for begin, end in sorted(map(tuple, missing)):
        text = source[begin - 1].strip()
        goes = "leaves the function" if end < 0 else f"goes to line {end}"
        why = reasons.get(f"{name}: {text}", "no test takes it yet")
        yield f"| {name}:{begin} | `{text.replace('|', chr(92) + '|')}` {goes} | {why} |"


def _percent(part: int, whole: int) -> str:
    return f"{100 * part / whole:.1f} %" if whole else ""


def main() -> int:
    """Exit code 0 once the page is written."""
    parser = argparse.ArgumentParser(prog="scripts/coverage", description=__doc__.splitlines()[0])
    parser.add_argument("measured", type=Path)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "coverage.md")
    args = parser.parse_args()
    measured = json.loads(args.measured.read_text(encoding="utf-8"))
    reasons = tomllib.loads(REASONS.read_text(encoding="utf-8")) if REASONS.exists() else {}
    read = {name: (ROOT / name).read_text(encoding="utf-8").splitlines() for name in measured["files"]}
    args.out.write_text(page(measured, reasons, read), encoding="utf-8")
    print(f"written: {args.out}", file=sys.stderr)
    return 0


if __name__ == "__main__":
    sys.exit(main())
