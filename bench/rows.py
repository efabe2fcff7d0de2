"""One measured figure beside its target, tables of them, and the way in which everything here takes a time."""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from typing import Any

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


def shown(section: Section) -> str:
    """One section as Markdown."""
    return "\n\n".join((f"## {section.title}", table(section.rows), *section.notes))


def table(rows: Sequence[Row]) -> str:
    """Markdown that also reads well on a terminal."""
    met = {None: "", True: "yes", False: "**no**"}
    return grid(("what", "target", "measured", "met"), [(r.what, r.target, r.measured, met[r.met]) for r in rows])


def grid(head: Sequence[object], rows: Sequence[Sequence[object]]) -> str:
    """The same of any columns."""
    cells = [[str(cell) for cell in row] for row in (head, *rows)]
    widths = [max(len(row[i]) for row in cells) for i in range(len(head))]
    lines = ["| " + " | ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)) + " |" for row in cells]
    return "\n".join([lines[0], "|" + "|".join("-" * (w + 2) for w in widths) + "|", *lines[1:]])


def best_of(times: int, action: Callable[[], Any]) -> float:
    """Least processor time of `action` over some repeats, s: what other work on the machine disturbs least."""
    found = []
    for _ in range(times):
        began = time.process_time()
        action()
        found.append(time.process_time() - began)
    return min(found)


def beside(what: str, ours: Callable[[], Any], theirs: Callable[[], Any], least: float | None = None) -> Row:
    """How many times as fast as a peer, both in this process: ours the best of five, the peer's of one run."""
    own, peer = best_of(5, ours), best_of(1, theirs)
    times = peer / own
    target, met = ("", None) if least is None else (f">= {least:g} x", times >= least)
    return Row(what, target, f"{own * 1e3:.1f} ms, the peer {peer * 1e3:.0f} ms: {times:.0f} x", met)


def percentile(values: Sequence[float], share: float) -> float:
    """The smallest of `values` that at least `share` (0..1) of them do not exceed; NaN of nothing."""
    if not len(values):
        return float("nan")
    return float(np.quantile(np.asarray(values), share, method="inverted_cdf"))


def milliseconds(values_s: Sequence[float]) -> str:
    """Median, 99th percentile and largest of durations in seconds."""
    found = [f"{percentile(values_s, share) * 1e3:.2f}" for share in (0.5, 0.99, 1.0)]
    return f"median {found[0]}, p99 {found[1]}, max {found[2]} ms"


def machine() -> str:
    """What the figures depend on, without names."""
    load = " ".join(f"{value:.1f}" for value in os.getloadavg())
    return (
        f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores, load average {load}, Python "
        f"{platform.python_version()}, numpy {version('numpy')}, scipy {version('scipy')}, "
        f"pymavlink {version('pymavlink')}"
    )
