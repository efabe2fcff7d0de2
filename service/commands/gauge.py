"""The progress of a command on one line of a terminal; the answer replaces it."""

from __future__ import annotations

import sys
from types import TracebackType
from typing import TYPE_CHECKING, Self, TextIO

if TYPE_CHECKING:
    from mavcal.calib.gap import GapProgress

_WIDTH = 78
"""Columns of the line."""


class Gauge:
    """Writes to a terminal how far a diagnosis is; writes nothing where there is none.

    Parameters
    ----------
    stream
        Where to; None: stderr.
    """

    def __init__(self, stream: TextIO | None = None) -> None:
        self._stream = sys.stderr if stream is None else stream
        self._last = ""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._write("")

    def show(self, standing: GapProgress) -> None:
        """In the place of what was shown before."""
        self._write(sentence(standing))

    def _write(self, text: str) -> None:
        if text == self._last or not self._stream.isatty():
            return
        self._stream.write(f"\r{text[:_WIDTH]:{_WIDTH}}\r")
        self._stream.flush()
        self._last = text


def sentence(standing: GapProgress) -> str:
    """``selecting effects: 34 % done, about 20 s left``."""
    left = "" if standing.left_s is None else f", about {max(round(standing.left_s), 1)} s left"
    return f"{standing.text}: {100 * standing.share:.0f} % done{left}"
