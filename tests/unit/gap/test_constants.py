"""Every number of the diagnosis says where it comes from; prices have a table and a test of their own."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

GAP = Path(__file__).resolve().parents[3] / "calib" / "gap"
TABLE = GAP / "search" / "prices.py"
LAYOUT = {
    "effects/affine.py": {"OFF_DIAGONAL"},
    "effects/magnetic.py": {"GRADIENT", "SYMMETRIC"},
    "reference/align.py": {"_IDENTITY"},
    "reference/posed.py": {"_CONVENTIONS"},
    "reference/trajectory.py": {
        *("NODE", "OFFSET", "PER_AMPERE", "EARTH", "LATE_GPS", "LATE_MAG", "SOFT_IRON", "GYRO", "ACCEL"),
        *("ACCEL_SCALE", "GYRO_DRIFT", "ACCEL_DRIFT", "CONSTANTS"),
    },
    "unknown/discrepancy.py": {"_AXES"},
    "unknown/misattributed_noise.py": {"_AXIS_GROUPS"},
    "worth/attitude_error.py": {"_TILTS", "_MATRIX", "_FIELD", "_SCALES", "_ERRORS"},
}
"""Positions in an array, and tables of names: numbers that could be no other."""
PROVENANCE = re.compile(r"Source: [\w`:]|\b[Cc]hosen, not measured: \w")


def constants(source: str) -> Iterator[tuple[str, str]]:
    """Names at the top of a module whose values hold a number, and the text below each."""
    body = ast.parse(source).body
    for node, after in zip(body, [*body[1:], None], strict=True):
        if not isinstance(node, ast.Assign | ast.AnnAssign) or node.value is None or not _holds_a_number(node.value):
            continue
        below = after.value.value if isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant) else ""
        targets = node.targets if isinstance(node, ast.Assign) else [node.target]
        for name in (n for target in targets for n in ast.walk(target) if isinstance(n, ast.Name)):
            yield name.id, " ".join(str(below).split())


def _holds_a_number(value: ast.AST) -> bool:
    return any(isinstance(n, ast.Constant) and type(n.value) in (int, float) for n in ast.walk(value))


def without_source(source: str) -> set[str]:
    """Names of the numbers that do not say where they come from."""
    return {name for name, text in constants(source) if not PROVENANCE.search(text)}


def test_every_number_says_where_it_comes_from() -> None:
    paths = [p for p in sorted(GAP.rglob("*.py")) if p != TABLE]
    found = {p.relative_to(GAP).as_posix(): p.read_text(encoding="utf-8") for p in paths}
    assert sum(1 for source in found.values() for _ in constants(source)) > 300
    left = {path: without_source(source) - LAYOUT.get(path, set()) for path, source in found.items()}
    left = {path: names for path, names in left.items() if names}
    assert not left, f"the docstring below says 'Source: …' or 'Chosen, not measured: why': {left}"


def test_the_list_of_layouts_has_no_more_than_there_are() -> None:
    for path, names in LAYOUT.items():
        assert names <= without_source((GAP / path).read_text(encoding="utf-8")), path


@pytest.mark.parametrize(
    ("source", "left"),
    [
        ("_WORTH = 8.0", {"_WORTH"}),
        ("_WORTH = 8.0  # deviance", {"_WORTH"}),
        ('_WORTH: float = 8.0\n"""Gain."""', {"_WORTH"}),
        ('_LOW, _HIGH = 1.0, 2.0\n"""Ends."""', {"_LOW", "_HIGH"}),
        ('_WORTH = 8.0\n"""Gain. Source: decision 5."""', set()),
        ('_WORTH = 8.0\n"""Gain. Chosen, not measured:\nit bounds the time."""', set()),
        ('_NAMES = ("a", "b")\n_LOUD = True', set()),
    ],
)
def test_a_number_without_a_source_is_seen(source: str, left: set[str]) -> None:
    assert without_source(source) == left
