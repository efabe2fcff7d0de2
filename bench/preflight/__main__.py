"""``python -m bench.preflight [--runs 100] [--healthy 500] [--first 1] [--write]``.

Each fault in so many simulated vehicles of either autopilot, anywhere on Earth: the right check has to fail, alone, in
99 of 100, and what is blamed must hold the culprit; of healthy vehicles at most 1 of 200 may get anything but a pass.
Exit code 1: missed.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

from bench.preflight.campaign import Row, rows
from bench.preflight.page import checks, limits, put, table

PAGE = Path(__file__).resolve().parents[2] / "docs" / "preflight.md"


def main() -> int:
    parser = argparse.ArgumentParser(prog="bench.preflight", description=__doc__)
    parser.add_argument("--runs", type=int, default=100, help="vehicles of each fault and autopilot")
    parser.add_argument("--healthy", type=int, default=500, help="healthy vehicles of each autopilot")
    parser.add_argument("--first", type=int, default=1, help="first seed")
    parser.add_argument("--write", action="store_true", help="write the tables into docs/preflight.md")
    args = parser.parse_args()
    began = time.process_time()
    found: list[Row] = rows(args.runs, args.healthy, args.first)
    text = table(found)
    print(text)
    for row in found:
        if row.wrong:
            name = "healthy" if row.fault is None else row.fault.name
            print(f"{name}, {row.autopilot}: other seeds {', '.join(map(str, row.wrong[:20]))}", file=sys.stderr)
    print(f"\n{time.process_time() - began:.0f} s of processor time", file=sys.stderr)
    if args.write:
        PAGE.write_text(
            put(PAGE.read_text(encoding="utf-8"), checks=checks(), limits=limits(), bench=text), encoding="utf-8"
        )
    return 0 if all(row.met for row in found) else 1


if __name__ == "__main__":
    sys.exit(main())
