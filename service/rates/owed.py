"""Message rates before a watch, kept on disk so that they are restored even after the service was killed."""

from __future__ import annotations

import json
import os
import threading
from collections.abc import Mapping
from pathlib import Path

import structlog

from mavcal.service.errors import DiskFull

log = structlog.get_logger(__name__)


class OwedRates:
    """Intervals in us by message, by vehicle, as they were before; -1 off, 0 the vehicle's default.

    Parameters
    ----------
    path
        The file. One that is damaged counts as empty, and the log says so.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._writing = threading.Lock()
        self._owed = self._read()

    def all(self) -> Mapping[str, Mapping[int, int]]:
        """Rates owed to each vehicle."""
        return dict(self._owed)

    def put(self, vehicle_id: str, intervals: Mapping[int, int]) -> None:
        """Set what is owed to a vehicle; it is on disk on return.

        Raises
        ------
        DiskFull
            If it cannot be kept.
        """
        with self._writing:
            owed = {**self._owed, vehicle_id: dict(intervals)}
            if not intervals:
                del owed[vehicle_id]
            if owed != self._owed:
                self._write(owed)
                self._owed = owed

    def _write(self, owed: Mapping[str, Mapping[int, int]]) -> None:
        beside = self._path.with_suffix(".new")
        try:
            with beside.open("w", encoding="utf-8") as file:
                json.dump(owed, file)
                file.flush()
                os.fsync(file.fileno())
            beside.replace(self._path)
        except OSError as error:
            raise DiskFull(f"the message rates as they were cannot be kept ({error.strerror or error})") from error

    def _read(self) -> dict[str, dict[int, int]]:
        try:
            found = json.loads(self._path.read_text(encoding="utf-8"))
            return {str(v): {int(k): int(i) for k, i in intervals.items()} for v, intervals in found.items()}
        except FileNotFoundError:
            return {}
        except (OSError, ValueError, TypeError, AttributeError) as error:
            log.warning("message rates that were owed are not known any more", path=str(self._path), reason=str(error))
            return {}
