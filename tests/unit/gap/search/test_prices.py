"""Every price of the search stands in one table, with meaning, unit and source."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

GAP = Path(__file__).resolve().parents[4] / "calib" / "gap"
TABLE = GAP / "search" / "prices.py"
NUMERICAL = {"_STEPS", "_STEPS_FIXED", "_SEEN", "_LEAST", "_TINY", "_PASSING", "_MODES", "_SCREENED"}
"""What guards rounding, bounds an iteration or sets a resolution: no price."""


def numbers(source: str) -> dict[str, str]:
    """Constants at the top of a module whose values hold a number, and the text below each."""
    body = ast.parse(source).body
    found = {}
    for node, after in zip(body, [*body[1:], None], strict=True):
        if isinstance(node, ast.Assign) and any(_is_number(n) for n in ast.walk(node.value)):
            text = after.value.value if isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant) else ""
            found |= {n.id: text for target in node.targets for n in ast.walk(target) if isinstance(n, ast.Name)}
    return found


def _is_number(node: ast.AST) -> bool:
    return isinstance(node, ast.Constant) and isinstance(node.value, int | float)


def used(source: str) -> set[str]:
    """Names of the table that a module uses."""
    return {
        node.attr
        for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "prices"
    }


PRICES = numbers(TABLE.read_text(encoding="utf-8"))


@pytest.mark.parametrize("name", PRICES)
def test_a_price_has_a_meaning_a_unit_and_a_source(name):
    meaning, _, rest = PRICES[name].partition("\n\n")
    assert meaning.strip().endswith(".")
    unit, _, source = " ".join(rest.split()).removeprefix("Unit: ").partition(". Source: ")
    assert unit
    assert source.rstrip(".")


def test_every_price_is_used_and_every_use_is_in_the_table():
    modules = [p.read_text(encoding="utf-8") for p in GAP.rglob("*.py") if p != TABLE]
    assert set().union(*map(used, modules)) == set(PRICES)


def test_no_other_module_of_the_search_has_a_price_of_its_own():
    others = [p for p in (GAP / "search").glob("*.py") if p != TABLE]
    assert {name for p in others for name in numbers(p.read_text(encoding="utf-8"))} <= NUMERICAL


def test_a_price_beside_the_table_is_seen():
    assert numbers('_WORTH = 8.0\n"""Gain."""\nNAMES = ("a", "b")\n') == {"_WORTH": "Gain."}
