"""Limits of time that grow with how crowded the machine is: what waits for a processor is not slow.

The measure is how many processes want each processor, at this instant and in the mean of the last minute. A limit is
for a machine of one's own; alone it is doubled, since no limit here measures speed.
"""

from __future__ import annotations

import os
import threading
import time
from pathlib import Path

_ALONE = 2.0
_MOST = 20.0
"""By which a limit grows at most: on a machine more crowded than that nothing can be told."""
_LOAD = Path("/proc/loadavg")


def crowding() -> float:
    """How many processes want each processor, from 1 on."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    try:
        mean, _, _, running, *_ = _LOAD.read_text().split()
        wanting = max(float(mean), float(running.partition("/")[0]))
    except (OSError, ValueError):
        return 1.0
    return min(max(1.0, wanting / cores), _MOST)


def scaled(seconds: float) -> float:
    """A limit on the clock, in s, for an interface that takes nothing else; `seconds` are those of an idle machine."""
    return seconds * _ALONE * crowding()


class patience:  # noqa: N801 - reads as a verb where it is used
    """A limit whose seconds are longer while the machine is crowded, however that changes; for loops that ask.

    >>> patience(5.0).over
    False
    """

    def __init__(self, seconds: float) -> None:
        self._left = seconds
        self._last = time.monotonic()
        self._lock = threading.Lock()

    @property
    def over(self) -> bool:
        """Whether it has passed; to be asked every second or oftener."""
        with self._lock:
            now = time.monotonic()
            self._left -= (now - self._last) / (_ALONE * crowding())
            self._last = now
            return self._left < 0.0
