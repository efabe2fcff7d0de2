"""Has glibc reuse the memory that jobs have freed, or return it to the system.

By itself glibc gives each thread a heap of its own, up to eight a processor, and no other thread uses what is freed
there. A service whose jobs run in changing threads therefore held more and more free memory. ``MALLOC_ARENA_MAX=2``
sets the same limit, but only from outside before the process starts, and it gives nothing back.
"""

from __future__ import annotations

import asyncio
import ctypes
import sys
from collections.abc import Callable

PERIOD_S = 60.0
HEAPS = 2
_M_ARENA_MAX = -8
"""Constant of glibc's ``malloc.h``."""


def share_heaps() -> bool:
    """Have the threads that begin from now on share :data:`HEAPS` heaps; whether that is so."""
    mallopt = _of_glibc("mallopt")
    return mallopt is not None and bool(mallopt(_M_ARENA_MAX, HEAPS))


def trim() -> bool:
    """Return free memory to the system; whether there was any. Without glibc nothing happens."""
    malloc_trim = _of_glibc("malloc_trim")
    return malloc_trim is not None and bool(malloc_trim(0))


def _of_glibc(name: str) -> Callable[..., int] | None:
    if sys.platform != "linux":
        return None
    library = ctypes.CDLL(None)
    return getattr(library, name) if hasattr(library, "gnu_get_libc_version") else None


async def trim_for_ever() -> None:
    """Trim the heap once a minute."""
    while True:
        await asyncio.sleep(PERIOD_S)
        await asyncio.to_thread(trim)
