"""``python -m bench.accuracy [mag six-face thermal ...] [--quick] [--seed 1]``: tables, and which targets are met.

The error of an estimate is compared with the Cramer-Rao bound: ``sqrt(mean of e^T F e / p)`` over the runs, e the error
of the p parameters, F their Fisher information by code that shares nothing with the estimators. 1 is the bound. A
promise is kept if the ratio is at most the target + 2/sqrt(2 R p) over R runs, and if the 95 % intervals hold 95 %
within two standard deviations. All contenders get the same draws. Exit code 1: a target is missed.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from bench.accuracy import rows_align, rows_allan, rows_imu, rows_mag, rows_six_face, rows_thermal
from bench.accuracy.campaign import Settings
from bench.rows import machine, table

ROWS = {
    "mag": rows_mag.run,
    "align": rows_align.run,
    "imu": rows_imu.run,
    "six-face": rows_six_face.run,
    "thermal": rows_thermal.run,
    "allan": rows_allan.run,
}


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="bench.accuracy", description=__doc__)
    parser.add_argument("rows", nargs="*", choices=[*ROWS, []], help="which rows; none: all")
    parser.add_argument("--quick", action="store_true", help="a slice: small samples, few runs")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--budget", type=float, default=6.0, help="seconds a peer may take for a case")
    args = parser.parse_args(arguments)
    settings = Settings(quick=args.quick, seed=args.seed, budget=args.budget)
    checks = []
    for name in args.rows or ROWS:
        for part in ROWS[name](settings):
            print(f"## {part.title}\n\n{part.body}\n", flush=True)
            checks += part.checks
    print(f"{table(checks)}\n\n{machine()}; seed {args.seed}")
    return 0 if settings.quick or all(check.met for check in checks) else 1


if __name__ == "__main__":
    sys.exit(main())
