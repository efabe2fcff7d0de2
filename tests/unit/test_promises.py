"""Every test that a page names as the witness of a promise exists."""

from __future__ import annotations

import ast
import re
from functools import cache
from pathlib import Path

import pytest

TESTS = Path(__file__).resolve().parents[1]
DOCS = TESTS.parent / "docs"
PAGES = ("security.md", "trust.md")
NAMED = re.compile(r"`(?P<file>[\w/]*\w+\.py)?(?:::(?P<test>test_\w+))?`")


@cache
def names_in(path: Path) -> frozenset[str]:
    tree = ast.parse(path.read_text())
    return frozenset(n.name for n in ast.walk(tree) if isinstance(n, ast.FunctionDef | ast.AsyncFunctionDef))


@cache
def files(named: str) -> tuple[Path, ...]:
    """The files of the tests that a name means: a path below tests/, or the end of one."""
    named = named.removeprefix("tests/")
    return tuple(p for p in sorted(TESTS.rglob("*.py")) if f"/{p.relative_to(TESTS)}".endswith(f"/{named}"))


def witnesses(text: str) -> list[tuple[str, str | None]]:
    """File and test of every name; ``::test_x`` alone is of the file named before."""
    found: list[tuple[str, str | None]] = []
    file = ""
    for named in NAMED.finditer(text):
        file = named["file"] or file
        if named["test"] or (named["file"] and Path(named["file"]).name.startswith("test_")):
            found.append((file, named["test"]))
    return found


@pytest.mark.sampled
@pytest.mark.parametrize("page", PAGES)
def test_every_test_that_a_page_names_exists(page: str) -> None:
    named = witnesses((DOCS / page).read_text())
    assert len(named) > 10
    missing = [
        f"{file}::{test or ''}"
        for file, test in named
        if not any(test is None or test in names_in(path) for path in files(file))
    ]
    assert missing == []


def test_every_threat_has_a_witness() -> None:
    rows = (DOCS / "security.md").read_text().split("## Threats")[1].split("##")[0].splitlines()
    threats = [row for row in rows if row.startswith("| ")][1:]
    assert len(threats) > 10
    assert [row for row in threats if not witnesses(row)] == []


def test_a_name_that_is_not_there_is_noticed() -> None:
    assert witnesses("`unit/test_promises.py::test_x`, `::test_y`") == [
        ("unit/test_promises.py", "test_x"),
        ("unit/test_promises.py", "test_y"),
    ]
    assert files("unit/test_no_such.py") == ()
    assert "test_x" not in names_in(TESTS / "unit/test_promises.py")
