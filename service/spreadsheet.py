"""Tables as CSV that a spreadsheet opens without computing what stands in them."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable

_FORMULA = ("=", "+", "-", "@", "\t", "\r")
"""How a cell begins that a spreadsheet would compute."""


def inert(text: str) -> str:
    """`text`, marked as text where a spreadsheet would run it as a formula: names come from whoever uploads."""
    return f"'{text}" if text.startswith(_FORMULA) else text


def csv_text(rows: Iterable[Iterable[str]]) -> str:
    """The rows as CSV, lines ended by CR LF (RFC 4180)."""
    text = io.StringIO()
    csv.writer(text).writerows(rows)
    return text.getvalue()
