"""Every example in a docstring is run: what a page of documentation shows is what happens."""

from __future__ import annotations

import doctest
import importlib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
SHOWN = sorted(
    path.relative_to(ROOT)
    for package in ("calib", "client", "service")
    for path in (ROOT / package).rglob("*.py")
    if ">>> " in path.read_text(encoding="utf-8")
)
PAGES = sorted(path for path in (ROOT / "docs").glob("*.md") if ">>> " in path.read_text(encoding="utf-8"))


def test_there_are_examples():
    assert len(SHOWN) >= 20


@pytest.mark.parametrize("path", SHOWN, ids=str)
def test_examples_are_true(path):
    parts = path.with_suffix("").parts
    module = importlib.import_module("mavcal." + ".".join(parts[:-1] if parts[-1] == "__init__" else parts))
    said: list[str] = []
    tests = [t for t in doctest.DocTestFinder(exclude_empty=True).find(module) if t.examples]
    runner = doctest.DocTestRunner()
    for test in tests:
        runner.run(test, out=said.append)
    assert tests, f"{path} shows examples in no docstring"
    assert not runner.summarize(verbose=False).failed, "".join(said)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_examples_of_pages_are_true(page):
    failed, tried = doctest.testfile(str(page), module_relative=False)
    assert tried > 0
    assert failed == 0
