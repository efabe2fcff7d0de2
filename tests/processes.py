"""Processes that a test session starts: found by a mark in their environment, or as descendants of this one."""

from __future__ import annotations

import contextlib
import os
import signal
import time
from dataclasses import dataclass
from pathlib import Path

from mavcal.service.lifetime import ENDS_WITH
from tests.patience import patience

PROC = Path("/proc")
_PYTHONS_OWN = ("multiprocessing.resource_tracker", "multiprocessing.forkserver")
"""Helpers of the interpreter, which end with it."""


@dataclass(frozen=True)
class Left:
    """A process, and the test that started it if its environment says so."""

    pid: int
    command: str
    test: str

    def __str__(self) -> str:
        return f"{self.pid} {self.command[:160]!r}" + (f", started in {self.test}" if self.test else "")


def mark() -> None:
    """Let everything that this process starts from now on end with it, and bear its number."""
    os.environ[ENDS_WITH] = str(os.getpid())


def left_over(owner: int | None = None) -> list[Left]:
    """Living processes that bear the number of `owner` (default: ours) or descend from it; zombies live no more."""
    owner = os.getpid() if owner is None else owner
    parents = {pid: parent for pid in _pids() if (parent := _parent(pid)) is not None}
    found = []
    for pid in sorted(parents.keys() - {owner, os.getpid()}):
        environment = _read(pid, "environ")
        marked = f"{ENDS_WITH}={owner}" in environment
        if marked or _descends(pid, owner, parents):
            command = " ".join(_read(pid, "cmdline"))
            test = next((e.partition("=")[2] for e in environment if e.startswith("PYTEST_CURRENT_TEST=")), "")
            if command and not any(own in command for own in _PYTHONS_OWN):
                found.append(Left(pid, command, test.partition(" (")[0]))
    return found


def ended(grace_s: float = 5.0, owner: int | None = None) -> list[Left]:
    """Those that still live after a grace; they are killed."""
    limit = patience(grace_s)
    while (left := left_over(owner)) and not limit.over:
        time.sleep(0.05)
    for one in left:
        with contextlib.suppress(ProcessLookupError):
            os.kill(one.pid, signal.SIGKILL)
    return left


def _pids() -> list[int]:
    return [int(entry.name) for entry in PROC.iterdir() if entry.name.isdigit()] if PROC.is_dir() else []


def _parent(pid: int) -> int | None:
    """None of a process that is gone, or a zombie."""
    try:
        state, parent = (PROC / str(pid) / "stat").read_text().rpartition(")")[2].split()[:2]
    except (OSError, ValueError):
        return None
    return None if state in {"Z", "X"} else int(parent)


def _descends(pid: int, owner: int, parents: dict[int, int]) -> bool:
    while pid in parents:
        pid = parents[pid]
        if pid == owner:
            return True
    return False


def _read(pid: int, name: str) -> list[str]:
    try:
        return (PROC / str(pid) / name).read_text(errors="replace").rstrip("\0").split("\0")
    except OSError:
        return []
