"""The register of seals: every seal that is here or ever was is in it, and no row of it was ever changed."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
REGISTER = ROOT / "bench" / "seals" / "README.md"
REGISTERS = ("docs/seals.md", "bench/seals/README.md")
"""Where it stood until b778323c, and where it stands."""
Sealed = tuple[int, str, int]


def rows(text: str) -> list[list[str]]:
    """Cells of the register's table."""
    lines = [line for line in text.splitlines() if line.startswith("|")]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines[2:]]


def registered(text: str) -> list[Sealed]:
    return [(int(first), tier, int(cases)) for _, first, tier, cases, *_ in rows(text)]


def sealed_in(document: str) -> Iterator[Sealed]:
    """Cases of a seal, or of a file that keeps several by their names."""
    found = json.loads(document)
    for seal in [found] if "first_seed" in found else found.values():
        yield from ((seal["first_seed"], tier, count) for tier, count in seal["cases"].items())


def git(*arguments: str) -> str:
    done = subprocess.run(["git", "-C", str(ROOT), *arguments], capture_output=True, text=True, check=False)
    if done.returncode:
        pytest.skip("there is no history here")
    return done.stdout


@pytest.mark.parametrize("path", sorted((ROOT / "bench" / "seals").glob("*.json")), ids=lambda p: p.name)
def test_every_seal_here_is_registered(path):
    known = registered(REGISTER.read_text())
    assert [s for s in sealed_in(path.read_text()) if s not in known] == []


def test_every_seal_that_ever_was_is_registered():
    known = registered(REGISTER.read_text())
    files = "docs/gap-seal*.json", "bench/seals/*.json"
    for commit in git("log", "--format=%h", "--diff-filter=AMR", "--", *files).split():
        for path in git("show", "--name-only", "--format=", "--diff-filter=AMR", commit, "--", *files).split():
            missing = [s for s in sealed_in(git("show", f"{commit}:{path}")) if s not in known]
            assert missing == [], f"{path} of {commit}"


def test_no_row_was_changed_or_removed():
    present = rows(REGISTER.read_text())
    for register in REGISTERS:
        for commit in git("log", "--format=%h", "--diff-filter=AMR", "--", register).split():
            earlier = rows(git("show", f"{commit}:{register}"))
            assert present[: len(earlier)] == earlier, f"the register at {commit}"


def test_every_row_says_what_became_of_its_cases():
    for sealed, *_, said in rows(REGISTER.read_text()):
        assert said.startswith(("run", "abandoned", "open", *(f"{n} run" for n in NUMBERS), "first sealed")), sealed


NUMBERS = ("second", "third", "fourth", "fifth", "sixth", "seventh", "eighth", "ninth", "tenth")


def test_no_case_was_run_under_two_seals():
    spent: dict[str, list[range]] = {}
    for _, first, tier, cases, *_, said in rows(REGISTER.read_text()):
        if said.startswith(("abandoned", "open")):  # what became of an open seal is a row of its own
            continue
        mine = range(int(first), int(first) + int(cases))
        for other in spent.setdefault(tier, []):
            assert mine.start >= other.stop or other.start >= mine.stop, f"{tier} from {first}"
        spent[tier].append(mine)
