"""``python -m bench [PART|all]``: measure, print tables, exit 1 if a target is missed."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from bench import api, gap, ingest, latency, logs, memory, startup
from bench.page import machine, page, shown
from bench.rows import Section

PAGE = Path(__file__).resolve().parents[1] / "docs" / "bench.md"
PARTS: Mapping[str, Callable[[], Section]] = {
    "ingest": ingest.run,
    "api": api.run,
    "latency": latency.run,
    "memory": memory.run,
    "logs": logs.run,
    "gap": gap.run,
    "startup": startup.run,
}


def main(argv: Sequence[str] | None = None) -> int:
    """Run what is asked for; the whole also writes the page. Exit code 1: a target is missed."""
    parser = argparse.ArgumentParser(prog="scripts/bench", description=__doc__)
    parser.add_argument("part", nargs="?", choices=(*PARTS, "all"), default="all")
    asked = parser.parse_args(argv).part
    began, load_before = time.monotonic(), machine()
    sections = []
    for name, run in PARTS.items():
        if asked in (name, "all"):
            print(f"{name} ...", file=sys.stderr, flush=True)
            sections.append(run())
            print(f"\n{shown(sections[-1])}", flush=True)
    minutes = (time.monotonic() - began) / 60
    print(f"\n{minutes:.1f} min; before: {load_before}; after: {machine()}")
    if asked == "all":
        PAGE.write_text(page(sections, load_before, machine(), minutes), encoding="utf-8")
    return 0 if all(section.met for section in sections) else 1


if __name__ == "__main__":
    sys.exit(main())
