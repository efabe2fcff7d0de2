"""One process owns a data directory."""

from __future__ import annotations

import fcntl
import os
from pathlib import Path

from service.errors import DataDirLocked, StoreError


class DataDirLock:
    """Holds a data directory until it is released or the process ends, however it ends."""

    def __init__(self, data_dir: Path) -> None:
        path = data_dir / "lock"
        try:
            data_dir.mkdir(parents=True, exist_ok=True, mode=0o700)
            self._fd = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
        except OSError as error:
            reason = error.strerror or str(error)
            raise StoreError(f"the data directory {data_dir} cannot be used ({reason}): choose another one") from error
        try:
            fcntl.flock(self._fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            owner = os.read(self._fd, 32).decode("ascii", "replace").strip()
            os.close(self._fd)
            raise DataDirLocked(
                f"the data directory is in use by process {owner or 'unknown'}: stop that process, or give this one "
                "another --data-dir"
            ) from error
        os.truncate(self._fd, 0)
        os.pwrite(self._fd, f"{os.getpid()}\n".encode(), 0)

    def release(self) -> None:
        """Give the directory back."""
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1
