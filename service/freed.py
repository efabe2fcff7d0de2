"""Memory that jobs have freed goes back to the system; glibc keeps it for the threads that may ask for it again."""

from __future__ import annotations

import asyncio
import ctypes
import sys

PERIOD_S = 60.0


def give_back() -> bool:
    """Give back what is free; whether there was anything. Without glibc nothing happens."""
    if sys.platform != "linux":
        return False
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    return trim is not None and bool(trim(0))


async def give_back_for_ever() -> None:
    """Give back now and then."""
    while True:
        await asyncio.sleep(PERIOD_S)
        await asyncio.to_thread(give_back)
