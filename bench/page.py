"""``docs/bench.md``: what is measured, how, and what came out last."""

from __future__ import annotations

import os
import platform
from collections.abc import Sequence
from importlib.metadata import version

from bench.rows import Section, table

_TEXT = """# Speed and memory

`scripts/bench` measures everything below in one run, prints it, writes this file and exits 1 if a target is missed;
`scripts/bench ingest` (or `api`, `latency`, `memory`, `logs`, `gap`) measures one part. Nothing leaves the machine. A
figure on a busy machine says as much about the machine: the load is stated, and peers are measured in the same run.

Measured on: {before}; after {minutes:.0f} minutes: {after}.

{sections}
"""


def page(sections: Sequence[Section], before: str, after: str, minutes: float) -> str:
    """The whole page."""
    body = "\n\n".join(shown(section) for section in sections)
    return _TEXT.format(before=before, after=after, minutes=minutes, sections=body)


def shown(section: Section) -> str:
    """One section as Markdown."""
    return "\n\n".join((f"## {section.title}", table(section.rows), *section.notes))


def machine() -> str:
    """What the figures depend on, without names."""
    load = " ".join(f"{value:.1f}" for value in os.getloadavg())
    return (
        f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores, load average {load}, "
        f"Python {platform.python_version()}, pymavlink {version('pymavlink')}"
    )
