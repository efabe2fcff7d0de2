"""One word, one thing: a public class has a name that no other one of ``calib`` and ``service`` has."""

from __future__ import annotations

import ast
from collections import defaultdict
from collections.abc import Mapping
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def sources() -> dict[str, str]:
    paths = [p for folder in ("calib", "service") for p in sorted((ROOT / folder).rglob("*.py"))]
    return {p.relative_to(ROOT).as_posix(): p.read_text(encoding="utf-8") for p in paths}


def shared(modules: Mapping[str, str]) -> dict[str, list[str]]:
    """Names of public classes that are defined more than once, with where; classes inside others count too."""
    where: dict[str, list[str]] = defaultdict(list)
    for path, source in modules.items():
        for node in ast.walk(ast.parse(source)):
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                where[node.name].append(path)
    return {name: paths for name, paths in where.items() if len(paths) > 1}


def test_no_two_public_classes_share_a_name() -> None:
    modules = sources()
    assert {"calib/recording.py", "service/vehicle/vehicle.py"} <= set(modules)
    assert shared(modules) == {}


def test_a_shared_name_is_seen() -> None:
    assert shared(
        {"a": "class Verdict: pass", "b": "class Verdict: pass\nclass _Own: pass", "c": "class _Own: pass"}
    ) == {"Verdict": ["a", "b"]}
