"""Progress of a computation as one line that a child process prints: its step, and the numbers of a bar."""

from __future__ import annotations

import re
from dataclasses import dataclass

_NUMBERS = re.compile(r"^(?P<text>.*) \[(?P<share>[01]\.\d{3}) (?P<left>-|\d+)\]$")


@dataclass(frozen=True)
class ProgressLine:
    """What is being done, the share of the work that is done (None: unknown), and the seconds left (None: unknown)."""

    text: str
    share: float | None = None
    left_s: float | None = None


def format_line(progress: ProgressLine) -> str:
    """One line, which :func:`parse_line` reads back to the thousandth and to the second."""
    if progress.share is None:
        return progress.text
    left = "-" if progress.left_s is None else f"{max(progress.left_s, 0.0):.0f}"
    return f"{progress.text} [{min(max(progress.share, 0.0), 1.0):.3f} {left}]"


def parse_line(line: str) -> ProgressLine:
    """The progress in a line; any other text becomes the step's name."""
    found = _NUMBERS.match(line)
    if found is None:
        return ProgressLine(line)
    left = None if found["left"] == "-" else float(found["left"])
    return ProgressLine(found["text"], float(found["share"]), left)
