"""What jobs have freed goes back to the system."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from mavcal.service.freed import give_back

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
    assert give_back()
    assert before - resident() > 20 * MB
    assert len(held) == 1
