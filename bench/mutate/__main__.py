"""``python -m bench.mutate``: a sample of the mutants of three rooms, and how many of them the tests kill.

A mutant meets the unit tests that reach its lines, cheap ones first. Which those are, `scripts/coverage` has measured.
Tests that start processes of their own do not see the change in those. Answers are kept line by line: an interrupted
run goes on, and `--again` asks those that survived once more.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import subprocess
import sys
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any

from bench.mutate.document import Drawn, written
from bench.mutate.operators import Mutant, mutants
from bench.mutate.patch import Ask, UnpatchableError, session
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
        ranked: dict[str, Mutant] = {}
        for mutant in mine:
            what = f"{mutant.path} {mutant.text} {mutant.choice}"
            times[what] += 1
            ranked[hashlib.sha256(f"{seed} {what} {times[what]}".encode()).hexdigest()] = mutant
        drawn += [(place, room, ranked[key]) for place, key in enumerate(sorted(ranked)[:each])]
    return [(room, mutant) for _, room, mutant in sorted(drawn, key=lambda item: item[0])]


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
    samples = {seed: sample(found, args.each, seed) for seed in args.seed or [1]}
    everyone = [pair for drawn in samples.values() for pair in drawn]
    quick = [(room, mutant) for room, mutant in everyone if _patchable(mutant, reach)]

    def work(ask: Ask) -> None:
        for room, mutant in quick:
            with suppress(UnpatchableError):
                answers.of(room, mutant, reach, ask)

    _in_a_process(lambda: session(_files(quick, reach), work))
    answers.read()
    drawn = [
        Drawn(seed, tuple(answers.of(room, mutant, reach, answer_of) for room, mutant in pairs))
        for seed, pairs in samples.items()
    ]
    text = written(drawn, {room: len(mine) for room, mine in found.items()}, _commit())
    print(text)
    if args.write:
        (ROOT / "docs" / "mutation.md").write_text(text, encoding="utf-8")
    return 0 if drawn[-1].share >= args.least else 1


class _Answers:
    """Rows by mutant, and the file that keeps them."""

    def __init__(self, path: Path, *, again: bool) -> None:
        self._path = path
        self._rows: dict[str, Mapping[str, Any]] = {}
        self.read()
        if again:
            self._rows = {key: row for key, row in self._rows.items() if row["verdict"] != Verdict.SURVIVED}

    def read(self) -> None:
        """Take what the file holds; a later line replaces an earlier one."""
        lines = self._path.read_text().splitlines() if self._path.exists() else []
        self._rows |= {row["key"]: row for row in map(json.loads, lines)}

    def of(self, room: str, mutant: Mutant, reach: Reach, ask: Ask) -> Mapping[str, Any]:
        """What is known of a mutant, or what the tests say now."""
        key = f"{mutant.path}:{mutant.line}:{mutant.node}:{mutant.choice}:{mutant.text}"
        known = self._rows.get(key)
        if known is None:
            answer, asked = _asked(mutant, reach, ask)
            known = {"key": key, "room": room, **asdict(mutant), **asdict(answer), "asked": asked}
            self._rows[key] = known
            with self._path.open("a") as file:
                file.write(json.dumps(known) + "\n")
            told = f"{len(self._rows)}: {known['verdict']:9} {mutant.path}:{mutant.line} {mutant.text}"
            print(told, file=sys.__stderr__, flush=True)
        return known


def _patchable(mutant: Mutant, reach: Reach) -> bool:
    lines = range(mutant.first, mutant.last + 1)
    return mutant.inside and reach.loading.get(mutant.path, frozenset()).isdisjoint(lines)


def _files(pairs: Sequence[tuple[str, Mutant]], reach: Reach) -> list[str]:
    """Where the tests are that these mutants meet."""
    stages = (stage for _, m in pairs for stage in reach.stages(m.path, range(m.first, m.last + 1)))
    return sorted({test.partition("::")[0] for stage in stages for test in stage})


def _in_a_process(work: Callable[[], None]) -> None:
    """This process loads nothing that a mutant changes."""
    pid = os.fork()
    if pid == 0:
        try:
            os.chdir(ROOT)
            work()
        finally:
            os._exit(0)
    os.waitpid(pid, 0)


def _asked(mutant: Mutant, reach: Reach, ask: Ask) -> tuple[Answer, int]:
    """The answer, and the number of tests that were asked."""
    asked = 0
    for tests in reach.stages(mutant.path, range(mutant.first, mutant.last + 1)):
        left = list(tests)
        while left:
            answer = ask(mutant, left, _limits(left, reach))
            if answer.verdict is Verdict.SURVIVED:
                break
            if not answer.by or ask(mutant, [answer.by], _limits([answer.by], reach)).verdict != Verdict.SURVIVED:
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
