"""``python -m bench.mutate``: a sample of the mutants of three rooms, and how many of them the tests kill.

A mutant meets the tests that reach its lines: cheap unit tests first, the other unit tests then, and link and service
tests if none of those noticed. Tests that start processes of their own do not see the change in those. Answers are kept
line by line: an interrupted run goes on, and `--again` asks those that survived once more.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import subprocess
import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from bench.mutate.document import Drawn, written
from bench.mutate.operators import Mutant, mutants
from bench.mutate.reach import Reach
from bench.mutate.trial import ROOT, Answer, Limits, Verdict, answer_of, warm_up

ROOMS = ("calib/firmware", "service/jobs", "service/vehicle")
MEASURED = ROOT / ".measured" / "coverage"
"""What `scripts/coverage` leaves behind."""
SLOWER = 4.0
"""Times the processor time of the tests of the code as it is, beyond which a mutant counts as noticed."""
WALL = 15.0
"""Times the same by the clock: the machine may be busy."""


def everything() -> Mapping[str, list[Mutant]]:
    """All mutants by room."""
    return {
        room: [
            mutant
            for path in sorted((ROOT / room).rglob("*.py"))
            for mutant in mutants(path.read_text(encoding="utf-8"), path.relative_to(ROOT).as_posix())
        ]
        for room in ROOMS
    }


def sample(found: Mapping[str, list[Mutant]], each: int, seed: int) -> list[tuple[str, Mutant]]:
    """`each` mutants of every room, each of a room with the same chance; a change of the code elsewhere moves few."""
    drawn = []
    for room, mine in found.items():
        times: Counter[str] = Counter()
        ranked = []
        for mutant in mine:
            what = f"{mutant.path} {mutant.text} {mutant.choice}"
            times[what] += 1
            ranked.append((hashlib.sha256(f"{seed} {what} {times[what]}".encode()).hexdigest(), mutant))
        drawn += [(room, mutant) for _, mutant in sorted(ranked, key=lambda item: item[0])[:each]]
    return drawn


def main() -> int:
    """Exit code 1 if fewer are killed than asked for."""
    parser = argparse.ArgumentParser(prog="scripts/mutate", description=__doc__.splitlines()[0])
    parser.add_argument("--room", action="append", choices=ROOMS, help="only this one; repeated")
    parser.add_argument("--each", type=int, default=50, help="mutants of each room")
    parser.add_argument("--seed", type=int, action="append", help="of a sample; repeated. The last is the one judged")
    parser.add_argument(
        "--answers", type=Path, default=ROOT / ".measured" / "mutants.jsonl", help="kept, and gone on from"
    )
    parser.add_argument("--again", action="store_true", help="ask once more those that survived")
    parser.add_argument("--least", type=float, default=0.9, help="share that must be killed")
    parser.add_argument("--write", action="store_true", help="write docs/mutation.md")
    args = parser.parse_args()
    warm_up()
    reach = Reach.read(MEASURED, ROOT)
    found = {room: mine for room, mine in everything().items() if room in (args.room or ROOMS)}
    answers = _Answers(args.answers, again=args.again)
    drawn = []
    for seed in args.seed or [1]:
        rows = []
        for room, mutant in sample(found, args.each, seed):
            rows.append(answers.of(room, mutant, reach))
            print(
                f"seed {seed}, {len(rows)}: {rows[-1]['verdict']:9} {mutant.path}:{mutant.line} {mutant.text}",
                file=sys.stderr,
            )
        drawn.append(Drawn(seed, tuple(rows)))
    text = written(drawn, {room: len(mine) for room, mine in found.items()}, _commit())
    print(text)
    if args.write:
        (ROOT / "docs" / "mutation.md").write_text(text, encoding="utf-8")
    return 0 if drawn[-1].share >= args.least else 1


class _Answers:
    """Rows by mutant, and the file that keeps them."""

    def __init__(self, path: Path, *, again: bool) -> None:
        self._path = path
        self._again = again
        lines = path.read_text().splitlines() if path.exists() else []
        self._rows: dict[str, Mapping[str, Any]] = {row["key"]: row for row in map(json.loads, lines)}

    def of(self, room: str, mutant: Mutant, reach: Reach) -> Mapping[str, Any]:
        key = f"{mutant.path}:{mutant.line}:{mutant.node}:{mutant.choice}:{mutant.text}"
        known = self._rows.get(key)
        if known is None or (self._again and known["verdict"] == Verdict.SURVIVED):
            answer, asked = _asked(mutant, reach)
            known = {"key": key, "room": room, **asdict(mutant), **asdict(answer), "asked": asked}
            self._rows[key] = known
            with self._path.open("a") as file:
                file.write(json.dumps(known) + "\n")
        return known


def _asked(mutant: Mutant, reach: Reach) -> tuple[Answer, int]:
    """The answer, and the number of tests that were asked."""
    asked = 0
    for tests in reach.stages(mutant.path, range(mutant.first, mutant.last + 1)):
        left = list(tests)
        while left:
            answer = answer_of(mutant, left, _limits(left, reach))
            if answer.verdict is Verdict.SURVIVED:
                break
            if not answer.by or answer_of(mutant, [answer.by], _limits([answer.by], reach)).verdict != Verdict.SURVIVED:
                return answer, asked + len(left)
            left = left[left.index(answer.by) + 1 :]  # it failed once, and by itself not: the machine was busy
        asked += len(tests)
    return Answer(Verdict.SURVIVED), asked


def _limits(tests: Sequence[str], reach: Reach) -> Limits:
    """From what the tests take without any change."""
    spent = sum(reach.seconds[test] for test in tests)
    longest = max(reach.seconds[test] for test in tests)
    return Limits(SLOWER * spent + 20.0, WALL * spent + 60.0, WALL * longest + 20.0)


def _commit() -> str:
    return subprocess.run(
        ["git", "rev-parse", "--short", "HEAD"],
        cwd=ROOT,
        check=True,
        capture_output=True,
        text=True,
    ).stdout.strip()


if __name__ == "__main__":
    sys.exit(main())
