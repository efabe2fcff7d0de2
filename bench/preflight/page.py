"""The tables of docs/preflight.md, from what they are about."""

from __future__ import annotations

from collections.abc import Sequence

from bench.preflight.campaign import Row
from mavcal.calib.preflight import limits as named
from mavcal.calib.preflight.check import ASKS


def checks() -> str:
    """Every check with its question."""
    return _lines(("id", "what it asks"), [(f"`{of}`", asks) for of, asks in ASKS.items()])


def limits() -> str:
    """Every limit with its source."""
    rows = [(of, f"{limit.value:g} {limit.unit}".rstrip(), limit.source) for of, limit in named.ALL.items()]
    return _lines(("check", "limit", "why"), rows)


def table(found: Sequence[Row]) -> str:
    """The page of what the bench found."""
    rows = []
    for row in found:
        most = "; ".join(f"{checks} {count}" for checks, count in row.failed.most_common(3))
        name = "healthy" if row.fault is None else row.fault.words
        blamed = "; ".join(f"{who} {count}" for who, count in row.blamed.most_common()) or "-"
        advised = max(row.advised, key=lambda said: row.advised[said], default="-").split(". ")[0].rstrip(".")
        cells = (name, row.autopilot, f"{row.right} of {row.runs}", most, blamed, advised)
        rows.append((*cells, "yes" if row.met else "NO"))
    head = ("vehicle", "autopilot", "right, alone", "failed (of healthy: no pass)", "blamed", "advised first", "met")
    return _lines(head, rows)


def put(page: str, **tables: str) -> str:
    """`page` with the tables between their marks replaced."""
    for name, text in tables.items():
        begin, end = f"<!-- {name} -->\n", f"<!-- /{name} -->"
        before, _, rest = page.partition(begin)
        _, _, after = rest.partition(end)
        page = f"{before}{begin}{text}\n{end}{after}"
    return page


def _lines(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    return "\n".join(f"| {' | '.join(cells)} |" for cells in (head, ["---"] * len(head), *rows))
