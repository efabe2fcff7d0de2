"""One measured figure beside its target, and tables of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Row:
    """`met` is None where there is no target: a figure to know, or the peer's."""

    what: str
    target: str
    measured: str
    met: bool | None = None


@dataclass(frozen=True)
class Section:
    """The figures of one part, and sentences about them."""

    title: str
    rows: tuple[Row, ...]
    notes: tuple[str, ...] = ()

    @property
    def met(self) -> bool:
        """Whether no target is missed."""
        return all(row.met is not False for row in self.rows)


def table(rows: Sequence[Row]) -> str:
    """Markdown that also reads well on a terminal."""
    met = {None: "", True: "yes", False: "**no**"}
    cells = [("what", "target", "measured", "met"), *((r.what, r.target, r.measured, met[r.met]) for r in rows)]
    widths = [max(len(row[i]) for row in cells) for i in range(4)]
    lines = ["| " + " | ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)) + " |" for row in cells]
    return "\n".join([lines[0], "|" + "|".join("-" * (w + 2) for w in widths) + "|", *lines[1:]])


def percentile(values: Sequence[float], share: float) -> float:
    """The smallest of `values` that at least `share` (0..1) of them do not exceed; NaN of nothing."""
    if not len(values):
        return float("nan")
    return float(np.quantile(np.asarray(values), share, method="inverted_cdf"))


def milliseconds(values_s: Sequence[float]) -> str:
    """Median, 99th percentile and largest of durations in seconds."""
    shown = [f"{percentile(values_s, share) * 1e3:.2f}" for share in (0.5, 0.99, 1.0)]
    return f"median {shown[0]}, p99 {shown[1]}, max {shown[2]} ms"
