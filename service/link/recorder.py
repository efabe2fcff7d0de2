"""The append-only .tlog of a link: everything received and sent, as any ground station can replay it.

A link that stays open goes on in another file now and then (:mod:`service.retention`); each file replays by itself.
Written without a buffer of our own, one system call a batch: what was written survives the death of this process.
"""

from __future__ import annotations

import asyncio
import os
import time
from pathlib import Path

from mavcal.calib.wire.tlog import tlog_record
from mavcal.service.errors import DiskFull, StoreError

_RETRY_S = 1.0


class TlogRecorder:
    """Appends records to one file. Belongs to the reader thread, except :meth:`sync` and the properties."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.begun_at = time.monotonic()
        self.error: DiskFull | None = None
        """Not None while nothing can be written."""
        self._retry_at = 0.0
        self._last_us = 0
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_CLOEXEC, 0o644)
            self.position = os.fstat(self._file).st_size
        except OSError as exc:
            raise StoreError(f"cannot record to {path}: {exc.strerror}. Check the data directory.") from exc

    def stamp(self) -> bytes:
        """The head of a record made now; times never decrease, even if the wall clock does."""
        self._last_us = max(self._last_us, time.time_ns() // 1000)
        return tlog_record(self._last_us, b"")

    def follow(self, before: TlogRecorder) -> None:
        """Continue another file, so that times do not decrease from file to file."""
        self._last_us = max(self._last_us, before._last_us)

    def write(self, records: list[bytes]) -> None:
        """Append records, each a stamp and a frame. A full disk is remembered in :attr:`error` and tried again."""
        now = time.monotonic()
        if self.error is not None and now < self._retry_at:
            return
        data = b"".join(records)
        try:
            written = os.write(self._file, data)
            if written == len(data):
                self.position += written
                self.error = None
                return
            reason = "only a part could be written"
        except OSError as exc:
            reason = exc.strerror or str(exc)
        self._cut_back()
        self._retry_at = now + _RETRY_S
        self.error = DiskFull(
            f"Recording to {self.path} has stopped: {reason}. Free some space; it goes on by itself, "
            "but a calibration that was being recorded has to be repeated."
        )

    def _cut_back(self) -> None:
        """Truncate the file after its last whole record."""
        try:
            os.ftruncate(self._file, self.position)
        except OSError:
            self.position = os.fstat(self._file).st_size  # a reader resynchronises over the torn one

    async def sync(self) -> None:
        """Force everything written so far to the disk. Raises DiskFull if that is not possible."""
        try:
            await asyncio.get_running_loop().run_in_executor(None, os.fsync, self._file)
        except OSError as exc:
            raise DiskFull(f"{self.path} could not be brought onto the disk: {exc.strerror}. Free some space.") from exc

    def close(self) -> None:
        """Close the file."""
        os.close(self._file)
