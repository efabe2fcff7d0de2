"""Lock of a data directory, which one process owns."""

from __future__ import annotations

import fcntl
import os
from pathlib import Path

from mavcal.service.errors import DataDirLocked, StoreError


class DataDirLock:
    """Holds a data directory until it is released or the process ends, however it ends.

    The directory itself is locked, so that nobody gets in by removing a file of it. The file `lock` names the owner,
    and is locked as well for versions that look at nothing else.
    """

    def __init__(self, data_dir: Path) -> None:
        self._held: list[int] = []
        try:
            data_dir.mkdir(parents=True, exist_ok=True, mode=0o700)
            self._held.append(os.open(data_dir, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC))
            self._held.append(os.open(data_dir / "lock", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600))
        except OSError as error:
            self.release()
            reason = error.strerror or str(error)
            raise StoreError(f"the data directory {data_dir} cannot be used ({reason}): choose another one") from error
        named = self._held[-1]
        try:
            for held in self._held:
                fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            owner = os.read(named, 32).decode("ascii", "replace").strip()
            self.release()
            raise DataDirLocked(
                f"the data directory is in use by process {owner or 'unknown'}: stop that process, or give this one "
                "another --data-dir"
            ) from error
        os.truncate(named, 0)
        os.pwrite(named, f"{os.getpid()}\n".encode(), 0)

    def release(self) -> None:
        """Give the directory back."""
        while self._held:
            os.close(self._held.pop())


RECORDED = ("tlogs/*.tlog", "recordings/*")
"""Files that only the database assigns to jobs."""


def require_database(data_dir: Path, *, empty: bool) -> None:
    """Refuse an empty database in a directory that had another one, whose jobs may have been writing.

    Raises
    ------
    StoreError
        If recordings lie in the data directory of a database that is `empty`.
    """
    found = [path for pattern in RECORDED for path in data_dir.glob(pattern)] if empty else []
    if found:
        raise StoreError(
            f"the data directory {data_dir} has {len(found)} recordings, but its database is missing or empty: put "
            "the database back from a backup, or choose another --data-dir"
        )
