"""Tables as CSV whose cells a spreadsheet does not evaluate."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable

_FORMULA = ("=", "+", "-", "@", "\t", "\r")
"""First characters of a cell that a spreadsheet would evaluate."""


def inert(text: str) -> str:
    """`text`, marked as text if a spreadsheet would evaluate it as a formula: names come from uploaders."""
    return f"'{text}" if text.startswith(_FORMULA) else text


def csv_text(rows: Iterable[Iterable[str]]) -> str:
    """The rows as CSV, lines ended by CR LF (RFC 4180)."""
    text = io.StringIO()
    csv.writer(text).writerows(rows)
    return text.getvalue()
