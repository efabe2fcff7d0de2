"""``scripts/checks``: the tables of ``docs/preflight.md``, read from the code."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from mavcal.calib.preflight import limits
from mavcal.calib.preflight.check import ASKS, CheckId

PAGE = Path(__file__).resolve().parents[1] / "docs" / "preflight.md"


def page(text: str) -> str:
    """`text` with the tables of checks and limits as the code has them."""
    checks = [(f"`{of}`", ASKS[of]) for of in CheckId]
    found = [(limit.of, f"{limit.value:g} {limit.unit}".rstrip(), limit.source) for limit in limits.ALL]
    text = _with_table(text, "checks", ("id", "what it asks"), checks)
    return _with_table(text, "limits", ("check", "limit", "why"), found)


def _with_table(text: str, name: str, head: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> str:
    begin, end = f"<!-- {name} -->\n", f"<!-- /{name} -->"
    before, _, rest = text.partition(begin)
    _, _, after = rest.partition(end)
    table = "".join(f"| {' | '.join(row)} |\n" for row in (head, ("---",) * len(head), *rows))
    return f"{before}{begin}{table}{end}{after}"


def main() -> None:
    """Write the tables into docs/preflight.md."""
    PAGE.write_text(page(PAGE.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main()
