"""``scripts/lines``: lines of the program, of its instruments and of the tests, and the ratio of tests to program.

The program is `service` and `calib`. Its instruments are the simulated vehicle, the withheld cases and `bench`: they
measure the program and are no part of it. Tests of instruments are counted apart, so that they do not count as tests of
the program. A line of code has a Python token on it; blank lines and comments do not count. Docstrings count as code;
the last column leaves them out.
"""

from __future__ import annotations

import ast
import io
import subprocess
import sys
import tokenize
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "architecture.md"
TARGET = 0.8
PROGRAM = ("service/", "calib/")
INSTRUMENTS = ("service/simvehicle/", "calib/blind/", "bench/")
TESTS = ("tests/",)
OF_INSTRUMENTS = (
    "tests/unit/bench/",
    "tests/unit/simvehicle/",
    "tests/unit/blind/",
    "tests/campaign/",
    "tests/link/test_simvehicle",
)
"""Tests that try an instrument by itself."""
_BEGIN, _END = "<!-- scripts/lines -->", "<!-- /scripts/lines -->"
_NO_CODE = frozenset(
    {tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER}
)


@dataclass(frozen=True)
class Lines:
    """Number of files and of their lines."""

    files: int = 0
    all: int = 0
    code: int = 0
    """Without blank lines and comments."""
    bare: int = 0
    """Without docstrings too."""

    def __add__(self, other: Lines) -> Lines:
        return Lines(self.files + other.files, self.all + other.all, self.code + other.code, self.bare + other.bare)


def counted(source: str) -> Lines:
    """Lines of one module.

    >>> counted('\"\"\"Says what it is.\"\"\"\\n\\nx = 1  # one\\n# why\\n')
    Lines(files=1, all=4, code=2, bare=1)
    """
    lines = source.splitlines()
    code = {row for row in _rows(source) if lines[row - 1].strip()}
    return Lines(1, len(lines), len(code), len(code - set(_docstrings(source))))


def groups(modules: Mapping[str, str]) -> dict[str, Lines]:
    """Lines by group, of sources by their path in the repository."""
    found = {"program": Lines(), "instruments": Lines(), "tests": Lines(), "tests of instruments": Lines()}
    for path, source in modules.items():
        if (group := _group(path)) is not None:
            found[group] += counted(source)
    return found


def table(found: Mapping[str, Lines]) -> str:
    """The groups, and the lines of tests for one of the program, as a table of a page."""
    rows = ["| | files | lines | lines of code | without docstrings |", "|---|---|---|---|---|"]
    for name, n in found.items():
        rows.append(f"| {name} | {_spaced(n.files)} | {_spaced(n.all)} | {_spaced(n.code)} | {_spaced(n.bare)} |")
    program, tests = found["program"], found["tests"]
    ratios = (_ratio(tests.all, program.all), _ratio(tests.code, program.code), _ratio(tests.bare, program.bare))
    rows.append(f"| tests : program (target {TARGET}) | | {' | '.join(ratios)} |")
    return "\n".join(rows)


def written(page: str, text: str) -> str:
    """The page with `text` in the place of what an earlier run wrote there."""
    before, begin, rest = page.partition(_BEGIN)
    _, end, after = rest.partition(_END)
    if not begin or not end:
        raise ValueError(f"the page has no place for it between {_BEGIN} and {_END}")
    return f"{before}{_BEGIN}\n{text}\n{_END}{after}"


def tracked(root: Path = ROOT) -> dict[str, str]:
    """Every module that git knows, by its path. The links under `mavcal` are no files of their own."""
    listed = subprocess.run(["git", "ls-files", "-z", "*.py"], cwd=root, check=True, capture_output=True, text=True)
    paths = [root / name for name in listed.stdout.split("\0") if name]
    return {str(p.relative_to(root)): p.read_text(encoding="utf-8") for p in paths if p.is_file()}


def main() -> None:
    """Print the table; with ``--page`` write it into docs/architecture.md."""
    text = table(groups(tracked()))
    if sys.argv[1:] == ["--page"]:
        PAGE.write_text(written(PAGE.read_text(encoding="utf-8"), text), encoding="utf-8")
    print(text)


def _group(path: str) -> str | None:
    if path.startswith(INSTRUMENTS):
        return "instruments"
    if path.startswith(PROGRAM):
        return "program"
    if path.startswith(TESTS):
        return "tests of instruments" if path.startswith(OF_INSTRUMENTS) else "tests"
    return None


def _rows(source: str) -> Iterator[int]:
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type not in _NO_CODE:
            yield from range(token.start[0], token.end[0] + 1)


def _docstrings(source: str) -> Iterator[int]:
    """Lines of docstrings, those of attributes included."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            yield from range(node.lineno, (node.end_lineno or node.lineno) + 1)


def _ratio(tests: int, program: int) -> str:
    return f"{tests / program:.2f}" if program else "-"


def _spaced(number: int) -> str:
    return f"{number:,}".replace(",", " ")


if __name__ == "__main__":
    main()
