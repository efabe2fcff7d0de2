"""``scripts/rooms``: how large each room of the program is, and which modules have a single importer.

Docstrings, comments and blank lines are no code. An importer may import in a function or for type checkers alone.
"""

from __future__ import annotations

import argparse
import ast
import io
import tokenize
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
SIDES = ("calib", "service", "client")
NO_CODE = {tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER}
DOCUMENTED = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)


@dataclass(frozen=True)
class Room:
    name: str
    lines: int
    files: int
    one_importer: int


def code_lines(source: str) -> int:
    """Lines of code without docstrings, those of attributes included, comments and blank lines."""
    lines: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type not in NO_CODE:
            lines.update(range(token.start[0], token.end[0] + 1))
    for node in ast.walk(ast.parse(source)):
        for said in node.body if isinstance(node, DOCUMENTED) else ():
            if isinstance(said, ast.Expr) and isinstance(getattr(said.value, "value", None), str):
                lines.difference_update(_lines_of(said))
    return len(lines)


def _lines_of(node: ast.stmt) -> range:
    return range(node.lineno, (node.end_lineno or node.lineno) + 1)


def modules(root: Path = ROOT) -> dict[str, str]:
    """The source of every module of the program by its dotted name below ``mavcal``."""
    found = {}
    for path in sorted(path for side in SIDES for path in (root / side).rglob("*.py")):
        parts = path.relative_to(root).with_suffix("").parts
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path.read_text(encoding="utf-8")
    return found


def importers(known: Mapping[str, str]) -> dict[str, set[str]]:
    found: dict[str, set[str]] = defaultdict(set)
    for name, source in known.items():
        for imported in _imported(source):
            inside = next((of for of in imported if of in known), name)
            if inside != name:
                found[inside].add(name)
    return found


def _imported(source: str) -> Iterator[tuple[str, ...]]:
    """Each imported name, as a module and, if it is none, as something of a module."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            yield from ((alias.name.removeprefix("mavcal."),) for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            module = node.module.removeprefix("mavcal.")
            yield from ((f"{module}.{alias.name}", module) for alias in node.names)


def room_of(name: str, known: Mapping[str, str]) -> str:
    """The folder that a module lies in, at most one below its side; what lies in the side itself is that side."""
    side, *rest = name.split(".")
    is_folder = len(rest) > 1 or (bool(rest) and any(other.startswith(f"{name}.") for other in known))
    return f"{side}/{rest[0]}" if is_folder else side


def rooms(known: Mapping[str, str]) -> list[Room]:
    """Every room, the largest first, and last the whole program."""
    by_room: dict[str, list[str]] = defaultdict(list)
    for name in known:
        by_room[room_of(name, known)].append(name)
    used, lines = importers(known), {name: code_lines(source) for name, source in known.items()}

    def room(of: str, names: Sequence[str]) -> Room:
        return Room(of, sum(lines[name] for name in names), len(names), sum(len(used[name]) == 1 for name in names))

    found = [room(of, names) for of, names in by_room.items()]
    return [*sorted(found, key=lambda room: -room.lines), room("**program**", list(known))]


def kinds(known: Mapping[str, str]) -> str:
    nodes = [node for source in known.values() for node in ast.walk(ast.parse(source))]
    imports = sum(len(_lines_of(node)) for node in nodes if isinstance(node, ast.Import | ast.ImportFrom))
    functions = [n for n in nodes if isinstance(n, ast.FunctionDef | ast.AsyncFunctionDef)]
    heads = sum(max(1, function.body[0].lineno - function.lineno) for function in functions)
    return f"Imports take {imports} lines; {len(functions)} functions begin with {heads} lines of name and arguments."


def main() -> None:
    parser = argparse.ArgumentParser(prog="scripts/rooms", description="How large each room of the program is.")
    parser.add_argument("--single", action="store_true", help="list modules with exactly one importer")
    known = modules()
    if parser.parse_args().single:
        single = sorted((code_lines(known[name]), name, *by) for name, by in importers(known).items() if len(by) == 1)
        print("\n".join(f"{lines:4} {name} <- {by}" for lines, name, by in single))
    else:
        print("| room | code lines | files | modules with one importer |\n|---|---|---|---|")
        print("\n".join(f"| {r.name} | {r.lines} | {r.files} | {r.one_importer} |" for r in rooms(known)))
        print(f"\n{kinds(known)}")


if __name__ == "__main__":
    main()
