"""A disk that is full, slow or cut off from power, a database that is gone, and a wall clock that jumps."""

from __future__ import annotations

import errno
import os
import random
import shutil
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from bench.campaign.crossed.plan import Cross, Process
from mavcal.service.errors import DiskFull, StoreError
from mavcal.service.link import recorder

SLOW_S = 0.05
JUMP_S = 7200.0
GONE_WRITES = 3


@dataclass
class Disk:
    """The fault of a run's disk, and how much of each file survives a loss of power."""

    cross: Cross
    strikes: int = 0
    """How often it refused or delayed a write."""
    synced: dict[Path, int] = field(default_factory=dict)
    """Bytes of each file that were brought onto the disk."""
    _count: int = 0
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def store_write(self, kind: str, *, durable: bool) -> None:
        """Before a write of the store. Raises DiskFull, StoreError."""
        if self.cross.process == Process.SLOW and durable:
            self._strike()
            time.sleep(SLOW_S)
        elif self.cross.process == Process.FULL and self._full(kind):
            raise DiskFull("the disk is full: injected")
        elif self.cross.process == Process.DATABASE and self._gone(kind):
            raise StoreError("the database does not answer: injected")

    def tlog_write(self) -> None:
        """Before a write of a telemetry log. Raises OSError."""
        if self.cross.process == Process.FULL and self._full("tlog"):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    def _full(self, kind: str) -> bool:
        """From the n-th write of the chosen kind on, so many of that kind are refused."""
        wanted = self.cross.disk
        if kind != wanted["kind"]:
            return False
        with self._lock:
            self._count += 1
            hit = 0 <= self._count - wanted["nth"] < wanted["lasting"]
            self.strikes += hit
        return bool(hit)

    def _gone(self, kind: str) -> bool:
        """From the n-th row of the journal on, so many writes of any kind are refused."""
        with self._lock:
            self._count += kind == "add_journal"
            hit = self._count >= self.cross.disk["nth"] and self.strikes < GONE_WRITES * self.cross.disk["lasting"]
            self.strikes += hit
        return bool(hit)

    def _strike(self) -> None:
        with self._lock:
            self.strikes += 1

    def fsynced(self, path: Path) -> None:
        """`path` is on the disk as it is now."""
        if self.cross.process == Process.SLOW:
            time.sleep(SLOW_S)
        self.synced[path] = path.stat().st_size


class _DiskOs:
    """The module `os` as the recorder of a link sees it."""

    def __init__(self, disk: Disk) -> None:
        self._disk = disk

    def __getattr__(self, name: str) -> Any:
        return getattr(os, name)

    def write(self, file: int, data: bytes) -> int:
        """As os.write."""
        self._disk.tlog_write()
        return os.write(file, data)

    def fsync(self, file: int) -> None:
        """As os.fsync."""
        os.fsync(file)
        self._disk.fsynced(Path(f"/proc/self/fd/{file}").resolve())


@dataclass
class WallClock:
    """The wall clock; it jumps `JUMP_S` forward, then as far back, where that is the fault of the run."""

    jumps: bool
    begun: float = field(default_factory=time.monotonic)

    def __call__(self) -> float:
        """Seconds since 1970, or so."""
        phase = int((time.monotonic() - self.begun) / 2.0) % 3 if self.jumps else 0
        return time.time() + (0.0, JUMP_S, -JUMP_S)[phase]


class _JumpingTime:
    """The module `time` as the recorder of a link sees it."""

    def __init__(self, wall: WallClock) -> None:
        self._wall = wall

    def __getattr__(self, name: str) -> Any:
        return getattr(time, name)

    def time_ns(self) -> int:
        """As time.time_ns."""
        return int(self._wall() * 1e9)


def installed(disk: Disk, wall: WallClock) -> None:
    """Have the recorders of this process write to `disk`; a run replaces what the one before installed."""
    recorder.os = _DiskOs(disk)  # type: ignore[attr-defined, assignment]
    recorder.time = _JumpingTime(wall)  # type: ignore[attr-defined, assignment]


def power_cut(data_dir: Path, image: Path, disk: Disk, draw: random.Random) -> None:
    """Make `image` what a loss of power at this instant may leave of a data directory.

    Bytes that were not synced are cut off at a random place.
    """
    image.mkdir()
    for path in sorted(data_dir.rglob("*")):
        target = image / path.relative_to(data_dir)
        if path.is_dir():
            target.mkdir(exist_ok=True)
        elif path.suffix == ".tlog" or path.name.endswith("-wal"):
            data = path.read_bytes()
            safe = min(disk.synced.get(path.resolve(), 0), len(data))
            target.write_bytes(data[: draw.randint(safe, len(data))])
        elif not path.name.endswith("-shm"):
            shutil.copyfile(path, target)
