"""``python -m bench.firmware --arducopter PATH --px4 PATH [--seed N]... [--only KIND]...``

Runs whole jobs against firmwares that somebody has built: random errors, every calibration fresh and on top of a first,
restarts, undo, kills in mid-write, preflights with faults. It prints error over sd of every number, whether each 95 %
interval holds the truth, what was said that is not true, and times. Without a binary there is nothing to run: exit 0.
Exit 1: a step did not end as it should, or a sentence is untrue.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from bench.firmware.rounds import KINDS, arducopter, px4
from bench.firmware.scoring import Row, table


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m bench.firmware", description=__doc__)
    parser.add_argument("--arducopter", type=Path, help="binary of ArduCopter's simulator (board sitl)")
    parser.add_argument("--px4", type=Path, help="build folder of px4_sitl, with bin/px4 and etc/")
    parser.add_argument("--seed", type=int, action="append", help="one set of errors each; default 1")
    parser.add_argument("--only", choices=KINDS, action="append", help="only these")
    parser.add_argument("--instance", type=int, default=30, help="which ports of loopback the firmwares take")
    parser.add_argument("--keep", type=Path, help="keep logs and recordings here")
    args = parser.parse_args(argv)
    rows: list[Row] = []

    def report(row: Row) -> None:
        rows.append(row)
        mark = "" if row.good else " NOT AS IT SHOULD BE"
        print(f"{row.autopilot} {row.round} {row.step}: {row.state} {row.proof}{mark}: {row.said}", file=sys.stderr)
        for sentence in row.untrue:
            print(f"    untrue: {sentence}", file=sys.stderr)

    with tempfile.TemporaryDirectory(prefix="mavcal-firmware-") as temporary:
        keep = args.keep or Path(temporary)
        for seed in args.seed or [1]:
            for binary, rounds in ((args.arducopter, arducopter), (args.px4, px4)):
                if binary is not None:
                    folder = keep / f"{rounds.__name__}-{seed}"
                    rounds(binary.resolve(), folder, seed, args.instance, args.only or KINDS, report)
    if not rows:
        print("nothing to run: give --arducopter PATH or --px4 PATH of a firmware that you have built")
        return 0
    print(f"seeds {args.seed or [1]}\n\n{table(rows)}")
    return 0 if all(row.good for row in rows) else 1


if __name__ == "__main__":
    sys.exit(main())
