"""A call says what it passes, nobody counts to the seventh argument; and who makes a fit's result does little else."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
MOST = 6
"""Arguments that a call may pass by their place."""

Function = ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda


def by_place(function: Function) -> list[str]:
    """Names of the arguments that may be passed by their place, `self` and `cls` not counted."""
    names = [a.arg for a in (*function.args.posonlyargs, *function.args.args)]
    return names[1:] if names[:1] in (["self"], ["cls"]) else names


def crowded(source: str) -> Iterator[str]:
    """Functions of `source` with more than :data:`MOST` arguments by place, with their lines."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, Function) and len(names := by_place(node)) > MOST:
            yield f"line {node.lineno}, {getattr(node, 'name', 'lambda')}: {', '.join(names)}"


@pytest.mark.parametrize("package", ["calib", "client", "service"])
def test_no_function_takes_more_than_six_arguments_by_place(package):
    found = {
        str(path.relative_to(ROOT)): bad
        for path in sorted((ROOT / package).rglob("*.py"))
        if (bad := list(crowded(path.read_text(encoding="utf-8"))))
    }
    assert found == {}


@pytest.mark.parametrize(
    ("source", "count"),
    [
        ("def f(a, b, c, d, e, g): ...", 0),
        ("def f(a, b, c, d, e, g, h): ...", 1),
        ("async def f(a, b, c, /, d, e, g, h=0): ...", 1),
        ("def f(a, b, c, d, e, g, *, h): ...", 0),
        ("class A:\n    def f(self, a, b, c, d, e, g): ...", 0),
        ("class A:\n    def f(self, a, b, c, d, e, g, h): ...", 1),
        ("f = lambda a, b, c, d, e, g, h: 0", 1),
    ],
)
def test_the_rule_sees_a_violation(source, count):
    assert len(list(crowded(source))) == count


LONGEST = 50
"""Lines of code of a function that makes the result of a fit, its signature and its docstring not counted."""


def makes_a_result(function: Function) -> bool:
    names = (getattr(c.func, "id", getattr(c.func, "attr", "")) for c in ast.walk(function) if isinstance(c, ast.Call))
    return bool({"FitResult", "FitBuilder", "fitted"} & set(names))


def long_fits(source: str) -> Iterator[str]:
    """Functions that make the result of a fit and have more than :data:`LONGEST` lines of code."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and makes_a_result(node):
            code = node.body[1:] if ast.get_docstring(node) is not None else node.body
            lines = (code[-1].end_lineno or 0) - code[0].lineno + 1 if code else 0
            if lines > LONGEST:
                yield f"line {node.lineno}, {node.name}: {lines} lines"


def test_a_result_is_made_by_the_builder_in_a_short_function():
    sources = {p.relative_to(ROOT).as_posix(): p.read_text(encoding="utf-8") for p in (ROOT / "calib").rglob("*.py")}
    assert {name: found for name, source in sources.items() if (found := list(long_fits(source)))} == {}
    by_hand = [name for name, source in sources.items() if re.search(r"\bFitResult\(", source)]
    assert by_hand == ["calib/fit.py"]


def test_a_long_fit_is_seen():
    body = "\n".join(f"    x{i} = {i}" for i in range(LONGEST))
    assert list(long_fits(f"def fit():\n{body}\n    return made.fitted(x0)"))
    assert not list(long_fits(f"def fit():\n{body}\n    return x0"))
