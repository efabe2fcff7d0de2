"""The comparison with other panels names only tests that exist, and one in every row."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
ROWS = (
    "pose picture", "coverage shown", "told where to turn", "order free", "live chart", "status", "log in the page",
    "review", "proof", "undo", "survives a reload", "temperature", "phone", "many vehicles",
)  # fmt: skip


def rows() -> dict[str, str]:
    """What the table says of ours, by row."""
    text = (ROOT / "docs" / "panel-peers.md").read_text(encoding="utf-8")
    cells = [[cell.strip() for cell in line.split("|")[1:-1]] for line in text.splitlines() if line.startswith("| ")]
    return {cell[0]: cell[1] for cell in cells if len(cell) == 5 and cell[0]}


def test_every_row_is_there_and_ours_is_yes_with_a_test_that_exists() -> None:
    found = rows()
    assert tuple(found) == ROWS
    for row, ours in found.items():
        named = re.fullmatch(r"yes: `([\w/.]+)::(\w+)`", ours)
        assert named, row
        source = (ROOT / "tests" / named[1]).read_text(encoding="utf-8")
        assert re.search(rf"^(async )?def {named[2]}\(", source, re.MULTILINE), ours


def test_every_picture_of_the_panel_is_there_and_small_and_none_is_left_over() -> None:
    pages = (ROOT / "docs" / "panel.md").read_text(encoding="utf-8")
    named = set(re.findall(r"\(pictures/([\w.-]+)\)", pages))
    there = {path.name for path in (ROOT / "docs" / "pictures").glob("panel-*.png")}
    assert named == there
    assert all((ROOT / "docs" / "pictures" / name).stat().st_size <= 600_000 for name in named)
