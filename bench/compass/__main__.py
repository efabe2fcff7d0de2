"""``python -m bench.compass [--fits] [--runs 100] [--first 1] [--rates 0,15,55,90] [--noise 0.003,0.05,0.5]``.

Prints a share in per cent for every rate of turn and every noise: how many of the 95 % intervals of offset, DIA and ODI
hold the truth. A job ends when its uncertainty is small enough; `--fits` fits a stretch of fixed length instead, in a
fifth of the time. Exit code 1: a share of all intervals lies outside 93 to 97 % by more than two standard deviations.
"""

from __future__ import annotations

import argparse
import sys
import time

from bench.compass.campaign import Cell, Tally, fit_cell, run_cell, table

LOW, HIGH = 0.93, 0.97


def main() -> int:
    parser = argparse.ArgumentParser(prog="bench.compass", description=__doc__)
    parser.add_argument("--fits", action="store_true", help="fits of a fixed length instead of whole jobs")
    parser.add_argument("--runs", type=int, default=100, help="vehicles of each cell; each has three compasses")
    parser.add_argument("--first", type=int, default=1, help="first seed")
    parser.add_argument("--rates", default="0,15,55,90", help="deg/s; 0: held in one attitude after the other")
    parser.add_argument("--noise", default="0.003,0.05,0.5", help="of a reading, uT")
    args = parser.parse_args()
    seeds = range(args.first, args.first + args.runs)
    tallies: list[Tally] = []
    began = time.process_time()
    for rate in map(float, args.rates.split(",")):
        for noise in map(float, args.noise.split(",")):
            tallies += (fit_cell if args.fits else run_cell)(Cell(rate, noise), seeds)
            print(table(tallies[-2:]).splitlines()[2:], file=sys.stderr, flush=True)
    print(table(tallies))
    print(f"\nseeds {seeds.start} to {seeds.stop - 1}, {time.process_time() - began:.0f} s of processor time")
    wrong = [t for t in tallies if t.deviations and not _true(t)]
    return 1 if wrong else 0


def _true(tally: Tally) -> bool:
    return LOW - 2.0 * tally.held_sd() <= tally.held() <= HIGH + 2.0 * tally.held_sd()


if __name__ == "__main__":
    sys.exit(main())
