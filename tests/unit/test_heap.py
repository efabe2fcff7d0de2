"""What jobs have freed goes back to the system."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from mavcal.service.heap import HEAPS, trim

MB = 2**20


def resident() -> int:
    line = next(x for x in Path("/proc/self/smaps_rollup").read_text().splitlines() if x.startswith("Rss"))
    return int(line.split()[1]) * 1024


@pytest.mark.skipif(sys.platform != "linux", reason="glibc alone keeps what is free")
def test_memory_between_two_things_that_stay_goes_back() -> None:
    held = [bytearray(8000) for _ in range(8000)]  # below the size that glibc maps by itself
    del held[:-1:2]
    del held[: len(held) - 1]  # one at the end keeps the heap from shrinking
    before = resident()
    assert trim()
    assert before - resident() > 20 * MB
    assert len(held) == 1


@pytest.mark.skipif(sys.platform != "linux", reason="glibc alone has a heap for each thread")
def test_threads_share_a_few_heaps() -> None:
    """Heaps beside the main one are mapped at multiples of 64 MiB (glibc's HEAP_MAX_SIZE)."""
    asked = """
import re, sys, threading, time
from pathlib import Path
from mavcal.service.heap import share_heaps
if sys.argv[1] == "shared":
    assert share_heaps()
held, go = [], threading.Event()
def work():
    held.append(bytearray(1000))
    go.wait()
threads = [threading.Thread(target=work) for _ in range(8)]
for thread in threads:
    thread.start()
while len(held) < 8:
    time.sleep(0.01)
starts = [int(line.partition("-")[0], 16) for line in Path("/proc/self/maps").read_text().splitlines()]
print(sum(start % 2**26 == 0 for start in starts))
go.set()
"""
    heaps = [
        int(subprocess.run([sys.executable, "-c", asked, how], capture_output=True, text=True, check=True).stdout)
        for how in ("shared", "each")
    ]
    assert heaps[0] <= HEAPS < heaps[1]
