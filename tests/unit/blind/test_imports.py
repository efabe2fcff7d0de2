"""Two authors: the generator shares no code with what it checks."""

from __future__ import annotations

import ast
from pathlib import Path

ROOT = Path(__file__).resolve().parents[3]
DOOR = "mavcal.calib.withheld_check"
MAY = {"mavcal.calib.blind", "mavcal.calib.errors", "mavcal.calib.recording"}
SHOWN = {"mavcal.calib.summary", "mavcal.calib.plots", "mavcal.calib.drawing"}
"""By which a recording shows itself; nothing of them is in its samples."""


def imported(path: Path) -> set[str]:
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0
            found.add(str(node.module))
    return {name for name in found if name.split(".")[0] == "mavcal"}


def graph(start: str) -> set[str]:
    """Every module of the project that importing `start` reaches."""
    todo, seen = {start}, set[str]()
    while todo:
        name = todo.pop()
        seen.add(name)
        base = ROOT.joinpath(*name.split(".")[1:])
        paths = (
            [*base.rglob("*.py")] if name == "mavcal.calib.blind" else [base.with_suffix(".py"), base / "__init__.py"]
        )
        for path in paths:
            if path.is_file():
                todo |= imported(path) - seen
    return seen


def test_the_generator_reaches_neither_the_diagnosis_nor_the_forward_model():
    reached = graph("mavcal.calib.blind")
    assert "mavcal.calib.recording" in reached
    assert not {name for name in reached if not name.startswith((*MAY, *SHOWN))}


def test_the_diagnosis_does_not_know_the_generator():
    for path in (ROOT / "calib").rglob("*.py"):
        if "blind" not in path.parts and path.name != "withheld_check.py":
            assert not any(name.startswith(("mavcal.calib.blind", DOOR)) for name in imported(path)), path
