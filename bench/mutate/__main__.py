"""``python -m bench.mutate``: a sample of the mutants of some rooms, and how many of them the tests kill.

A mutant meets its module's own tests first and those of its whole room then; the first that fails ends it. Tests that
start processes of their own do not see the change in those. Answers are kept line by line: an interrupted run goes on.
"""

from __future__ import annotations

import argparse
import json
import random
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path

from bench.mutate.document import written
from bench.mutate.operators import Mutant, mutants
from bench.mutate.trial import ROOT, Limits, Verdict, verdict_of, warm_up

ROOMS: Mapping[str, tuple[str, ...]] = {
    "service/jobs": ("tests/unit/jobs",),
    "service/vehicle": ("tests/unit/vehicle", "tests/unit/jobs"),
    "calib/firmware": ("tests/unit/firmware", "tests/unit/jobs/test_verify.py", "tests/unit/jobs/test_planning.py"),
}
SLOWER = 4.0
"""Times the processor time of the tests of the code as it is, beyond which a mutant counts as noticed."""
WALL = 15.0
"""Times the same by the clock: the machine may be busy."""


def sample(rooms: Sequence[str], count: int, seed: int) -> list[tuple[str, Mutant]]:
    """`count` mutants of all rooms together, each with the same chance."""
    everything = [
        (room, mutant)
        for room in rooms
        for path in sorted((ROOT / room).rglob("*.py"))
        for mutant in mutants(path.read_text(encoding="utf-8"), path.relative_to(ROOT).as_posix())
    ]
    print(f"{len(everything)} mutants in {', '.join(rooms)}; a sample of {count} with seed {seed}", file=sys.stderr)
    return random.Random(seed).sample(everything, min(count, len(everything)))


def stages(room: str, path: str) -> list[list[str]]:
    """Tests of the module alone, if there are any, and those of the room."""
    own = ROOT / "tests" / "unit" / Path(room).name / f"test_{Path(path).stem}.py"
    first = [[own.relative_to(ROOT).as_posix()]] if own.exists() else []
    return [*first, list(ROOMS[room])]


def main() -> int:
    """Exit code 1 if fewer are killed than asked for."""
    parser = argparse.ArgumentParser(prog="scripts/mutate", description=__doc__.splitlines()[0])
    parser.add_argument("--room", action="append", choices=tuple(ROOMS), help="only this one; repeated")
    parser.add_argument("--count", type=int, default=150)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--answers", type=Path, default=Path("mutation.jsonl"), help="kept here, and gone on from")
    parser.add_argument("--least", type=float, default=0.9, help="share that must be killed")
    parser.add_argument("--write", action="store_true", help="write docs/mutation.md")
    args = parser.parse_args()
    rooms = args.room or list(ROOMS)
    warm_up()
    known = {}
    if args.answers.exists():
        known = {row["key"]: row for row in map(json.loads, args.answers.read_text().splitlines())}
    limits: dict[tuple[str, ...], Limits] = {}
    rows = []
    for room, mutant in sample(rooms, args.count, args.seed):
        key = f"{mutant.path}:{mutant.line}:{mutant.node}:{mutant.choice}:{mutant.text}"
        if key not in known:
            known[key] = {"key": key, "room": room, **asdict(mutant), "verdict": _verdict(room, mutant, limits)}
            with args.answers.open("a") as file:
                file.write(json.dumps(known[key]) + "\n")
        rows.append(known[key])
        print(f"{len(rows)}: {known[key]['verdict']:9} {mutant.path}:{mutant.line} {mutant.text}", file=sys.stderr)
    killed = sum(row["verdict"] != Verdict.SURVIVED for row in rows)
    text = written(rows, args.seed)
    print(text)
    if args.write:
        (ROOT / "docs" / "mutation.md").write_text(text, encoding="utf-8")
    return 0 if killed >= args.least * len(rows) else 1


def _verdict(room: str, mutant: Mutant, limits: dict[tuple[str, ...], Limits]) -> str:
    for tests in stages(room, mutant.path):
        if tuple(tests) not in limits:
            limits[tuple(tests)] = _limits(tests)
        verdict, _ = verdict_of(mutant, tests, limits[tuple(tests)])
        if verdict is not Verdict.SURVIVED:
            return verdict.value
    return Verdict.SURVIVED.value


def _limits(tests: Sequence[str]) -> Limits:
    """From what the tests take without any change, which they must pass."""
    verdict, spent = verdict_of(None, tests, Limits(1200.0, 3600.0))
    if verdict is not Verdict.SURVIVED:
        raise SystemExit(f"{', '.join(tests)}: fails on the code as it is")
    return Limits(SLOWER * spent + 5.0, WALL * spent + 60.0)


if __name__ == "__main__":
    sys.exit(main())
