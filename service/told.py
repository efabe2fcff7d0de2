"""The progress of a computation as the one line that a child process prints: what it does, and the numbers of a bar."""

from __future__ import annotations

import re
from dataclasses import dataclass

_NUMBERS = re.compile(r"^(?P<text>.*) \[(?P<share>[01]\.\d{3}) (?P<left>-|\d+)\]$")


@dataclass(frozen=True)
class ToldProgress:
    """What is being done, the share of the work that is done (None: unknown), and the seconds left (None: unknown)."""

    text: str
    share: float | None = None
    left_s: float | None = None


def line_of(told: ToldProgress) -> str:
    """One line, which :func:`read_line` reads back to the thousandth and to the second."""
    if told.share is None:
        return told.text
    left = "-" if told.left_s is None else f"{max(told.left_s, 0.0):.0f}"
    return f"{told.text} [{min(max(told.share, 0.0), 1.0):.3f} {left}]"


def read_line(line: str) -> ToldProgress:
    """What a line says; any other text stands for itself."""
    found = _NUMBERS.match(line)
    if found is None:
        return ToldProgress(line)
    left = None if found["left"] == "-" else float(found["left"])
    return ToldProgress(found["text"], float(found["share"]), left)
