"""``python -m bench.speed [PART]``: measure, print tables, exit 1 if a target is missed.

Nothing leaves the machine. A figure on a busy machine says as much about the machine: the load is stated, and peers are
measured in the same run.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Mapping, Sequence

from bench import endurance
from bench.rows import Section, machine, shown
from bench.speed import answers, gap, ingest, logs, startup

PARTS: Mapping[str, Callable[[], Section]] = {
    "ingest": ingest.run,
    "answers": answers.run,
    "logs": logs.run,
    "gap": gap.run,
    "startup": startup.run,
    "memory": endurance.run,
}


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m bench.speed", description=__doc__)
    parser.add_argument("part", nargs="?", choices=(*PARTS, "all"), default="all")
    asked = parser.parse_args(argv).part
    began, before, met = time.monotonic(), machine(), True
    for name, run in PARTS.items():
        if asked in (name, "all"):
            print(f"{name} ...", file=sys.stderr, flush=True)
            section = run()
            met = met and section.met
            print(f"\n{shown(section)}", flush=True)
    print(f"\n{(time.monotonic() - began) / 60:.1f} min; before: {before}; after: {machine()}")
    return 0 if met else 1


if __name__ == "__main__":
    sys.exit(main())
