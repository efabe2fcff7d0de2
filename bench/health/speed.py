"""``python -m bench.health.speed LOG [--megabytes 250]``: how long the health of a long log takes beside reading it.

The log is repeated, its clock going on, until it is that long. Both times are processor time of one run: reading every
column of a recording is the bound, the whole document of ``mavcal inspect`` is what is measured.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np

from mavcal.calib import logs
from mavcal.calib.health.overview import overview
from mavcal.calib.logs import DataFlash

TARGET = 3.0
CLOCKS = ("TimeUS", "SampleUS", "S")
PAUSE_US = 1_000_000
HEADER = 3


def repeated(source: Path, target: Path, size: int) -> None:
    """Write the DataFlash log of `source` to `target` again and again, until that holds `size` bytes."""
    data = np.fromfile(source, dtype=np.uint8)
    log = DataFlash(source)
    stamps = []
    last = 0
    for name in log:
        table = log[name]
        for column in CLOCKS:
            if column in table and table.format.letter(column) == "Q":
                fields = table.format.dtype.fields
                assert fields is not None
                offset = HEADER + fields[column][1]
                stamps.append(table.offsets[:, None] + offset + np.arange(8))
                if column == "TimeUS":
                    last = max(last, int(table[column].max()))
    first = min(int(log[name]["TimeUS"].min()) for name in log if "TimeUS" in log[name])
    where = np.concatenate(stamps)
    clock = np.ascontiguousarray(data[where]).view("<u8")[:, 0]
    with target.open("wb") as out:
        for number in range(-(-size // len(data))):
            shifted = clock + np.uint64(number * (last - first + PAUSE_US))
            data[where] = shifted[:, None].view(np.uint8)
            data.tofile(out)


def main() -> None:
    """Print both times and their ratio."""
    parser = argparse.ArgumentParser(prog="python -m bench.health.speed", description=(__doc__ or "").split("\n")[0])
    parser.add_argument("log", type=Path)
    parser.add_argument("--megabytes", type=int, default=250)
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        long = Path(folder) / "long.bin"
        repeated(asked.log, long, asked.megabytes * 1_000_000)
        overview(logs.read(asked.log))  # what is imported on first use counts for neither
        start = time.process_time()
        recording = logs.read(long)
        read = time.process_time()
        document = overview(recording)
        done = time.process_time()
        size = long.stat().st_size
    samples = sum(len(channel) for channel in recording.channels)
    print(f"{size / 1e6:.0f} MB, {document['duration']:.0f} s, {samples} samples in {len(recording.channels)} channels")
    print(document["health"]["summary"])
    whole, bound = done - start, read - start
    print(f"read {bound:.2f} s, inspect {whole:.2f} s: {whole / bound:.2f} times the read (target {TARGET:.1f})")


if __name__ == "__main__":
    main()
