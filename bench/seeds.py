"""Twenty demonstrations in a row: ``python -m bench.seeds [--autopilot ardupilot|px4] [--first 1] [--count 20]``.

Every run must end with every parameter proved and with honest uncertainties; the seeds are printed.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--autopilot", choices=["ardupilot", "px4"], default="ardupilot")
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument("--count", type=int, default=20)
    args = parser.parse_args()
    print("| seed | ok | s | largest abs(error)/sd | chi2 | dof | p |\n|---|---|---|---|---|---|---|", flush=True)
    good = 0
    for seed in range(args.first, args.first + args.count):
        command = [
            sys.executable,
            "-m",
            "service",
            "demo",
            "--autopilot",
            args.autopilot,
            "--seed",
            str(seed),
            "--json",
        ]
        done = subprocess.run(command, capture_output=True, text=True, timeout=600, check=False)
        good += done.returncode == 0
        print(row(seed, json.loads(done.stdout or "{}")), flush=True)
    print(f"\n{good} of {args.count} ended with everything proved")
    return 0 if good == args.count else 1


def row(seed: int, found: dict) -> str:
    """One line of the table, with the reasons of a run that failed."""
    numbers = [
        f"{found[name]:.3g}" if name in found else "-" for name in ("seconds", "largest_z", "chi2", "dof", "p_value")
    ]
    reasons = "; ".join(found.get("reasons", ["no answer"]))
    return f"| {seed} | {found.get('ok', False)} | {' | '.join(numbers)} | {reasons}"


if __name__ == "__main__":
    sys.exit(main())
