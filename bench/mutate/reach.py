"""Which tests reach a line: what `scripts/coverage` measured, each test as a context."""

from __future__ import annotations

import ast
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import coverage

from bench.mutate.contexts import SECONDS_SUFFIX

UNIT = "tests/unit/"
FIRST = 40
"""Tests that a mutant meets first: those that it is likeliest to fail, and cheap ones."""
FIRST_S = 10.0
"""Seconds of them together."""
REST_S = 25.0
"""Seconds of the other unit tests together, the cheapest first."""


@dataclass(frozen=True)
class Reach:
    """For each file its lines with the tests that ran them, and the processor time of each test."""

    lines: Mapping[str, Mapping[int, frozenset[str]]]
    seconds: Mapping[str, float]
    loading: Mapping[str, frozenset[int]]
    """For each file the lines that also run while modules are loaded, before any test."""

    @classmethod
    def read(cls, measured: Path, root: Path) -> Reach:
        """Raises FileNotFoundError where nothing was measured."""
        seconds = json.loads(Path(str(measured) + SECONDS_SUFFIX).read_text())
        data = coverage.CoverageData(str(measured))
        data.read()
        found = {
            Path(name).relative_to(root).as_posix(): {
                line: frozenset(tests) for line, tests in data.contexts_by_lineno(name).items()
            }
            for name in data.measured_files()
        }
        loading = {name: frozenset(n for n, tests in lines.items() if "" in tests) for name, lines in found.items()}
        lines = {name: {n: tests - {""} for n, tests in lines.items()} for name, lines in found.items()}
        return cls(lines, seconds, loading)

    def stages(self, path: str, span: Sequence[int]) -> list[list[str]]:
        """Unit tests that reach lines of a file, in the order in which a mutant there meets them."""
        own = f"test_{Path(path).stem}.py"
        unit = sorted(
            (test for test in self._tests(path, span) if test.startswith(UNIT)),
            key=lambda t: (own not in t or self.seconds[t] > 1.0, self.seconds[t], t),
        )
        first = self._within(unit[:FIRST], FIRST_S)
        rest = self._within(sorted(unit[len(first) :], key=lambda t: (self.seconds[t], t)), REST_S)
        return [stage for stage in (first, rest) if stage]

    def _tests(self, path: str, span: Sequence[int]) -> frozenset[str]:
        lines = self.lines.get(path, {})
        reading: frozenset[str] = frozenset()
        if not self.loading.get(path, frozenset()).isdisjoint(span):
            span = tuple(lines)  # what came of it while the module was loaded may matter anywhere
            own = f"/test_{Path(path).stem}"
            reading = frozenset(test for test in self.seconds if own in test)  # a table is read without running a line
        return reading.union(*(lines.get(line, frozenset()) for line in span)).intersection(self.seconds)

    def _within(self, tests: Sequence[str], limit_s: float) -> list[str]:
        chosen: list[str] = []
        spent = 0.0
        for test in tests:
            spent += self.seconds[test]
            if chosen and spent > limit_s:
                break
            chosen.append(test)
        return chosen


@dataclass(frozen=True)
class Place:
    """The lines by which it is known that a node was run, and whether it is in the body of a function.

    Inside a function these are the lines of the statement, without the statements that it contains. What runs while
    the module is loaded may matter to every test of the module; defaults of a function, to those of the function.
    """

    lines: range
    inside: bool


def places(tree: ast.Module) -> Mapping[int, Place]:
    """For each node, by its identity."""
    found: dict[int, Place] = {}
    whole = range(1, 1 + max((getattr(n, "end_lineno", 0) or 0 for n in ast.walk(tree)), default=0))
    _fill(tree, whole, whole, found, inside=False)
    return found


def _fill(node: ast.AST, span: range, outside: range, found: dict[int, Place], *, inside: bool) -> None:
    found[id(node)] = Place(span, inside)
    for child in ast.iter_child_nodes(node):
        lines, deeper = span, inside
        if isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef):
            lines = range(child.body[0].lineno, (child.end_lineno or child.lineno) + 1)
            for part in child.body:
                _fill(part, _own_lines(part), outside, found, inside=True)
            for part in (child.args, *child.decorator_list):
                _fill(part, lines, outside, found, inside=False)
            found[id(child)] = Place(lines, inside=False)
            continue
        if isinstance(child, ast.stmt):
            lines = _own_lines(child) if inside else outside
        _fill(child, lines, outside, found, inside=deeper)


def _own_lines(statement: ast.stmt) -> range:
    """A compound statement counts with its head alone."""
    body = getattr(statement, "body", None) or getattr(statement, "cases", None)
    last = statement.end_lineno or statement.lineno
    if body:
        first = body[0].pattern.lineno if isinstance(body[0], ast.match_case) else body[0].lineno
        last = max(statement.lineno, first - 1)
    return range(statement.lineno, last + 1)
