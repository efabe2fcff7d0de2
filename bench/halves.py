"""``python -m bench.halves DATA``: both halves of every nominal recording against each other, either way: no gap.

A hand-held recording has its other half as the nominal one, a vehicle's log as the simulated flight.
Exit code 1: something is named, or called unknown.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

from bench.airframes import Answer, row, told, unpacked
from bench.gap_recordings import nominal
from mavcal.calib import gap, logs
from mavcal.calib.recording import Recording
from mavcal.calib.withheld_check import halves

HEADER = "| half | of | verdict | named (probability) | | processor time |\n|---|---|---|---|---|---|"
FLIGHTS = ("sitl_flights/null.bin", "airframe_flights/d01.bin", "airframe_flights/p01.ulg", "px4_flights/null.ulg")


def recordings(data: Path, folder: Path) -> Iterator[tuple[str, Recording]]:
    """Every recording without an effect that the data folder has."""
    yield from nominal(data)
    for name in FLIGHTS:
        parent, _, file = name.rpartition("/")
        if (data / name).is_file():
            yield name, logs.read(data / name)
        elif (data / f"{name}.xz").is_file():
            yield name, logs.read(unpacked(data / parent, file, folder))


def answers(name: str, recording: Recording) -> Iterator[Answer]:
    """Either half against the other."""
    first, second = halves(recording)
    flown = recording.identity.autopilot is not None
    for real, other, which in ((first, second, "first"), (second, first, "second")):
        began = time.process_time()
        report = gap.run(real, other if flown else None, () if flown else (other,), nested=False)
        yield told(f"{which} half", (name,), {}, report, time.process_time() - began)


def main(argv: Sequence[str] | None = None) -> int:
    """Each half once, told as soon as it is diagnosed."""
    parser = argparse.ArgumentParser(prog="python -m bench.halves", description=__doc__)
    parser.add_argument("data", type=Path, help="folder of the recordings")
    parser.add_argument("--only", nargs="*", default=(), metavar="NAME", help="of these recordings")
    given = parser.parse_args(argv)
    print(HEADER, flush=True)
    right = True
    with tempfile.TemporaryDirectory(prefix="mavcal-halves-") as folder:
        for name, recording in recordings(given.data, Path(folder)):
            if given.only and name not in given.only:
                continue
            for one in answers(name, recording):
                print(row(one), flush=True)
                right = right and one.right
    return 0 if right else 1


if __name__ == "__main__":
    sys.exit(main())
