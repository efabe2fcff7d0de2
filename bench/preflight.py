"""``python -m bench.preflight [--runs 100] [--healthy 500] [--first 1]``.

Each fault in so many simulated vehicles of either autopilot, anywhere on Earth: the right check has to fail, alone, in
99 of 100, and what is blamed must hold the culprit; of healthy vehicles at most 1 of 200 may get anything but a pass.
Exit code 1: missed.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections import Counter

from mavcal.calib.preflight.check import Verdict
from tests.unit.preflight.faults import FAULTS, Fault, looked_at

RIGHT_SHARE = 0.99
FALSE_SHARE = 1.0 / 200.0
AUTOPILOTS = ("ardupilot", "px4")


def run(fault: Fault | None, autopilot: str, first: int, runs: int) -> bool:
    """One row: so many vehicles of this autopilot, from the seed `first` on; whether the target is reached.

    A run is right if exactly one check failed, and it was a right one; of healthy vehicles (None), if all passed.
    """
    failed: Counter[str] = Counter()
    blamed: Counter[str] = Counter()
    wrong = []
    start = first + (first % 2 != AUTOPILOTS.index(autopilot))
    for seed in range(start, start + 2 * runs, 2):
        vehicle, report = looked_at(fault, seed)
        counted = (Verdict.FAIL,) if fault is not None else (Verdict.FAIL, Verdict.WARN, Verdict.UNKNOWN)
        found = [check for check in report.checks if check.verdict in counted]
        failed[", ".join(check.id for check in found) or "none"] += 1
        if not (not found if fault is None else len(found) == 1 and found[0].id in fault.right):
            wrong.append(seed)
        elif fault is not None:
            blamed[whom(vehicle.culprit, found[0].suspects)] += 1
    if fault is None:
        met = len(wrong) <= FALSE_SHARE * runs
    else:
        met = runs - len(wrong) >= RIGHT_SHARE * runs and not blamed["another"]
    most = "; ".join(f"{checks} {count}" for checks, count in failed.most_common(3))
    who = "; ".join(f"{said} {count}" for said, count in blamed.most_common()) or "-"
    name = "healthy" if fault is None else fault.words
    right = f"{runs - len(wrong)} of {runs}"
    print(f"| {name} | {autopilot} | {right} | {most} | {who} | {'yes' if met else 'NO'} |", flush=True)
    if wrong:
        print(f"{name}, {autopilot}: other seeds {', '.join(map(str, wrong[:20]))}", file=sys.stderr)
    return met


def whom(culprit: str, suspects: tuple[str, ...]) -> str:
    """How well the blame fits."""
    if not suspects or not culprit:
        return "none"
    if culprit not in suspects:
        return "another"
    return "it alone" if len(suspects) == 1 else "it or another"


def main() -> int:
    parser = argparse.ArgumentParser(prog="bench.preflight", description=__doc__)
    parser.add_argument("--runs", type=int, default=100, help="vehicles of each fault and autopilot")
    parser.add_argument("--healthy", type=int, default=500, help="healthy vehicles of each autopilot")
    parser.add_argument("--first", type=int, default=1, help="first seed")
    args = parser.parse_args()
    began = time.process_time()
    print("| vehicle | autopilot | right, alone | failed (of healthy: no pass) | blamed | met |")
    print("|---|---|---|---|---|---|")
    met = [run(None, autopilot, args.first, args.healthy) for autopilot in AUTOPILOTS]
    met += [run(fault, autopilot, args.first, args.runs) for fault in FAULTS for autopilot in AUTOPILOTS]
    print(f"\n{time.process_time() - began:.0f} s of processor time", file=sys.stderr)
    return 0 if all(met) else 1


if __name__ == "__main__":
    sys.exit(main())
