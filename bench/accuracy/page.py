"""``docs/accuracy.md``: what is measured, how, and what came out last."""

from __future__ import annotations

import os
import platform
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path

from bench.accuracy.peers import DISTRIBUTIONS, version_of
from bench.accuracy.settings import Settings
from bench.accuracy.tables import Part
from bench.rows import table

REASONS = Path(__file__).with_name("reasons.md")
"""Why a target is missed, written by hand; part of the page."""

_TEXT = """# Accuracy

`scripts/accuracy` installs the peers (extra `bench`; none of them is needed to run mavcal), measures everything below
in one run, writes this file and exits 1 if a target is missed. `scripts/accuracy mag` measures one row,
`scripts/accuracy --quick` a slice.

The error of an estimate is compared with the Cramer-Rao bound: `sqrt(mean of e^T F e / p)` over the runs. Here e is the
error of the p parameters and F their Fisher information. `bench/accuracy/bounds.py` computes F by code that shares
nothing with the estimators. 1.00 is the bound; in brackets stands the standard error of the figure, from the scatter of
its runs.

A promise is kept under two conditions. The ratio is at most the target + 2/sqrt(2 R p) over R runs. The 95 % intervals
hold 95 % within two standard deviations: for the ellipsoid exactly, elsewhere 95 % or more. The standard deviation is
binomial, or from the scatter of the runs where that is larger: the intervals of one run are not independent. With that
many figures some lie beyond two standard deviations by chance. All contenders get the same draws; a peer whose runs of
a case take more than {budget:.0f} s of processor time makes fewer, and the number is stated. Times are processor time,
one thread.

Measured on: {machine}; {minutes:.0f} minutes; seed {seed}. Peers: {peers}.

## Targets

{checks}

{reasons}

{parts}
"""


def page(parts: Sequence[Part], settings: Settings, before: str, minutes: float) -> str:
    """The whole page."""
    missed = any(not check.met for part in parts for check in part.checks)
    return _TEXT.format(
        budget=settings.budget,
        machine=before,
        minutes=minutes,
        seed=settings.seed,
        peers=", ".join(f"{name} {version_of(name) or '(not installed)'}" for name in DISTRIBUTIONS),
        checks=targets(parts),
        reasons=REASONS.read_text(encoding="utf-8").strip() if missed else "All are met.",
        parts="\n\n".join(shown(part) for part in parts),
    )


def targets(parts: Sequence[Part]) -> str:
    """All promises of the parts in one table."""
    return table([check for part in parts for check in part.checks])


def shown(part: Part) -> str:
    """One part as Markdown."""
    return f"## {part.title}\n\n{part.body}\n"


def machine() -> str:
    """What the figures depend on, without names."""
    load = " ".join(f"{value:.1f}" for value in os.getloadavg())
    return (
        f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores, load average {load}, "
        f"Python {platform.python_version()}, numpy {version('numpy')}, scipy {version('scipy')}"
    )
