"""``python -m bench.accuracy [mag six-face thermal ...] [--quick] [--seed 1] [--out docs/accuracy.md]``."""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

from bench.accuracy import page, rows_align, rows_allan, rows_imu, rows_mag, rows_order, rows_six_face, rows_thermal
from bench.accuracy.settings import Settings
from bench.accuracy.tables import Part

ROWS = {
    "mag": rows_mag.run,
    "order": rows_order.run,
    "align": rows_align.run,
    "imu": rows_imu.run,
    "six-face": rows_six_face.run,
    "thermal": rows_thermal.run,
    "allan": rows_allan.run,
}

PAGE = Path(__file__).resolve().parents[2] / "docs" / "accuracy.md"


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="bench.accuracy", description=__doc__)
    parser.add_argument("rows", nargs="*", choices=[*ROWS, []], help="which rows; none: all, and the page is written")
    parser.add_argument("--quick", action="store_true", help="a slice: small samples, few runs")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--budget", type=float, default=6.0, help="seconds a peer may take for a case")
    parser.add_argument("--alone", action="store_true", help="without the peers, in the row `order`")
    parser.add_argument("--out", type=Path, default=None, help="where to write; of all rows docs/accuracy.md")
    args = parser.parse_args(arguments)
    settings = Settings(quick=args.quick, seed=args.seed, budget=args.budget, alone=args.alone)
    before, begin = page.machine(), time.monotonic()
    parts: list[Part] = []
    for name in args.rows or ROWS:
        for part in ROWS[name](settings):
            parts.append(part)
            print(page.shown(part), flush=True)
    text = page.page(parts, settings, before, (time.monotonic() - begin) / 60.0)
    print(page.targets(parts))
    out = args.out or (PAGE if not args.rows and not args.quick else None)
    if out is not None:
        out.write_text(text, encoding="utf-8")
    return 0 if settings.quick or all(check.met for part in parts for check in part.checks) else 1


if __name__ == "__main__":
    sys.exit(main())
