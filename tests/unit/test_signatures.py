"""A call says what it passes: nobody counts to the seventh argument."""

from __future__ import annotations

import ast
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


@pytest.mark.parametrize("package", ["calib", "service"])
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
