"""The limits of a child process, and the message when it exceeds one."""

from __future__ import annotations

import contextlib
import ctypes
import os
import resource
import signal
import sys
from dataclasses import dataclass

OUT_OF_MEMORY = 70
"""Exit code of a child that asked for more memory than it may have."""
DEFECT = 71
"""Exit code of a child that ended by an unexpected exception; its stderr has the trace."""
NICENESS = 5
"""Niceness of children, which yield to the service and so to live calibrations."""
LARGEST_RESULT = 1 << 28
"""Largest file that a child may write, bytes."""
MOST_FILES = 64
_PR_SET_PDEATHSIG = 1
_LIBC = ctypes.CDLL(None, use_errno=True) if sys.platform == "linux" else None


@dataclass(frozen=True)
class Limits:
    """Limits of one child: bytes of memory, seconds of processor time, seconds by the clock."""

    memory_bytes: int
    cpu_s: float
    wall_s: float


def confine(limits: Limits) -> None:
    """Apply `limits` to this process, except the time by the clock, which the service enforces."""
    seconds = max(1, round(limits.cpu_s))
    _lower(resource.RLIMIT_DATA, limits.memory_bytes)  # what is mapped from files does not count
    _lower(resource.RLIMIT_CPU, seconds, seconds + 5)
    _lower(resource.RLIMIT_FSIZE, LARGEST_RESULT)
    _lower(resource.RLIMIT_NOFILE, MOST_FILES)
    _lower(resource.RLIMIT_CORE, 0)
    with contextlib.suppress(OSError):
        os.nice(NICENESS)


def die_with_parent(parent: int) -> None:
    """Let the kernel kill this process when `parent` ends (Linux; elsewhere its processor time bounds it)."""
    if _LIBC is not None:
        _LIBC.prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:
        os._exit(DEFECT)


def cause_of(status: int, limits: Limits) -> str:
    """Why a child with this wait status left no result."""
    if not os.WIFSIGNALED(status):
        if os.waitstatus_to_exitcode(status) == OUT_OF_MEMORY:
            return f"it needed more than {size_text(limits.memory_bytes)} of memory"
        return "it ended by an unexpected error; the log of the service has it"
    number = os.WTERMSIG(status)
    if number == signal.SIGXCPU:
        return f"it needed more than {limits.cpu_s:g} s of processor time"
    if number == signal.SIGKILL:
        return "the system killed its reader (signal 9), most likely for want of memory"
    with contextlib.suppress(ValueError):
        return f"its reader ended with signal {number} ({signal.Signals(number).name})"
    return f"its reader ended with signal {number}"


def size_text(size: int) -> str:
    """`size` bytes in words: ``1 GiB``, ``300 MiB``."""
    return f"{size / 2**30:g} GiB" if size >= 2**30 and size % 2**29 == 0 else f"{size / 2**20:.0f} MiB"


def _lower(what: int, soft: int, hard: int | None = None) -> None:
    ceiling = resource.getrlimit(what)[1]
    wanted = soft if hard is None else hard
    top = wanted if ceiling == resource.RLIM_INFINITY else min(wanted, ceiling)
    resource.setrlimit(what, (min(soft, top), top))
