"""``scripts/house [FOLDER]``: files, lines, arrows and circles of the packages, room by room, as the imports say.

With a folder, such as ``calib/gap``, it counts the rooms of that folder, its floors, and its longest walk. A *room* is
a subfolder, a module beside the subfolders, or the folder's own ``__init__``. An *arrow* leads from an importing module
to the imported one; a *circle* is a set of modules that import each other. *Floors* are the rooms on the longest chain
of imports. The *walk* is the longest chain of imports, counted in files.
"""

from __future__ import annotations

import ast
import sys
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from graphlib import TopologicalSorter
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("calib", "client", "service")
Graph = Mapping[str, frozenset[str]]


def sources(package: str) -> dict[str, str]:
    """Text of every module, by its dotted name; a folder's ``__init__`` has the name of the folder."""
    paths = sorted((ROOT / package).rglob("*.py"))
    names = {".".join(p.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): p for p in paths}
    return {f"mavcal.{name}": path.read_text(encoding="utf-8") for name, path in names.items()}


def arrows(modules: Mapping[str, str]) -> Graph:
    """Each module with those that it imports, imports for type checkers included; only modules of `modules` count."""
    return {name: frozenset(_imported(name, text, modules)) - {name} for name, text in modules.items()}


def circles(graph: Graph) -> list[list[str]]:
    """Sets of modules that import each other in a circle (strongly connected components), each sorted.

    >>> circles({"a": frozenset("b"), "b": frozenset("a"), "c": frozenset("a")})
    [['a', 'b']]
    """
    reached = {name: _reached(graph, name) for name in graph}
    groups = {frozenset(o for o in reached[name] if name in reached[o]) for name in graph}
    return sorted(sorted(group) for group in groups if len(group) > 1)


def rooms_of(graph: Graph, folder: str) -> Graph:
    """Each room of a folder (dotted name) with the rooms that its modules import.

    >>> rooms_of({"p.a.x": frozenset(["p.a.y", "p.b"]), "p.a.y": frozenset(), "p.b": frozenset()}, "p")
    {'a': frozenset({'b'}), 'b': frozenset()}
    """
    found: dict[str, frozenset[str]] = {}
    for name, imported in graph.items():
        own = _below(name, folder)
        found[own] = found.get(own, frozenset()) | {_below(other, folder) for other in imported} - {own}
    return found


def longest(graph: Graph) -> int:
    """Nodes of the longest chain of arrows.

    Raises
    ------
    graphlib.CycleError
        If there is a circle: a chain through it has no end.

    >>> longest({"a": frozenset("b"), "b": frozenset("c"), "c": frozenset(), "d": frozenset("c")})
    3
    """
    height: dict[str, int] = {}
    for name in TopologicalSorter(graph).static_order():
        height[name] = 1 + max((height[other] for other in graph[name]), default=0)
    return max(height.values(), default=0)


def folder_report(folder: str, modules: Mapping[str, str]) -> str:
    """What one folder (dotted name) looks like: a line of figures, then a line a room."""
    graph = arrows(modules)
    rooms = rooms_of(graph, folder)
    files = Counter(_below(name, folder) for name in modules)
    figures = (
        f"{folder}: {len(modules)} files, {len(rooms)} rooms, {longest(rooms)} floors, "
        f"{sum(map(len, rooms.values()))} arrows between rooms, longest walk {longest(graph)} files"
    )
    order = TopologicalSorter(rooms).static_order()
    lines = (
        f"  {room:16} {files[room]:3} files, imports {', '.join(sorted(rooms[room])) or 'no other'}" for room in order
    )
    return "\n".join([figures, *lines])


def report(package: str, modules: Mapping[str, str]) -> str:
    """What the package looks like, a line a room."""
    graph = arrows(modules)
    lines: Counter[str] = Counter()
    files: Counter[str] = Counter()
    for name, text in modules.items():
        lines[_room(name)] += len(text.splitlines())
        files[_room(name)] += 1
    found = circles(graph)
    head = (
        f"{package}: {len(modules)} files, {sum(lines.values())} lines, "
        f"{sum(map(len, graph.values()))} arrows, {len(found)} circles"
    )
    rooms = [f"  {room:24} {files[room]:4} files {count:6} lines" for room, count in lines.most_common()]
    rings = [f"  circle: {', '.join(circle)}" for circle in found]
    return "\n".join([head, *rooms, *rings])


def main(folders: Sequence[str] = ()) -> None:
    """Print the packages one after the other, or the folders that are asked for."""
    for folder in folders:
        print(folder_report(f"mavcal.{folder.strip('/').replace('/', '.')}", sources(folder)))
    for package in () if folders else PACKAGES:
        print(report(package, sources(package)))


def _below(name: str, folder: str) -> str:
    """The room of a folder in which a module lies."""
    return name.removeprefix(folder).lstrip(".").partition(".")[0] or "__init__"


def _room(name: str) -> str:
    parts = name.split(".")
    return ".".join(parts[1:3])


def _imported(importer: str, text: str, modules: Mapping[str, str]) -> Iterator[str]:
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name in modules)
        elif isinstance(node, ast.ImportFrom):
            base = _base(importer, node, modules)
            whole = [f"{base}.{alias.name}" for alias in node.names]
            yield from (name for name in whole if name in modules)  # a name, or a module of that name
            if base in modules and any(name not in modules for name in whole):
                yield base


def _base(importer: str, node: ast.ImportFrom, modules: Mapping[str, str]) -> str:
    """The module that names are imported from; a relative import counts from the importer's folder."""
    if not node.level:
        return node.module or ""
    folder = any(name.startswith(f"{importer}.") for name in modules)
    parts = importer.split(".")
    own = parts[: len(parts) - node.level + folder]
    return ".".join([*own, *([node.module] if node.module else [])])


def _reached(graph: Graph, start: str) -> frozenset[str]:
    seen: set[str] = set()
    waiting = [start]
    while waiting:
        for other in graph[waiting.pop()]:
            if other not in seen:
                seen.add(other)
                waiting.append(other)
    return frozenset(seen)


if __name__ == "__main__":
    main(sys.argv[1:])
