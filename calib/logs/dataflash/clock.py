"""Times of a DataFlash log in seconds since boot."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from calib.firmware.log_fields import SAMPLE_TIME_COLUMNS

if TYPE_CHECKING:
    from calib.logs.dataflash.log import Log, Table

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

STAMPS: Final = (("TimeUS", 1e-6), ("T", 1e-3), ("TimeMS", 1e-3))
"""Columns that hold the time since boot. GPS of old firmwares says the time of the week in TimeMS, and its own in T."""
WRAP_US: Final = 2.0**32
LATEST_S: Final = 1.0
"""A sample that claims to be older than this when it is logged was read at a time that is not known."""


class Clock:
    """Gives every message its time; messages without a stamp get the one of the stamped message before them."""

    def __init__(self, log: Log) -> None:
        stamped = [name for name in log if _stamp(log[name]) is not None and name not in ("FMT", "PARM", "UNIT")]
        self._where = np.empty(0, dtype=np.int64)
        self._times = np.empty(0)
        if stamped:
            densest = log[max(stamped, key=lambda name: len(log[name]))]
            self._where, self._times = densest.offsets, self._stamps(densest)

    def times(self, table: Table) -> Array:
        """When the messages of `table` were written, s."""
        if _stamp(table) is not None:
            return self._stamps(table)
        if not len(self._where):
            return np.zeros(len(table))
        before = np.searchsorted(self._where, table.offsets) - 1
        return self._times[np.maximum(before, 0)]

    def sample_times(self, table: Table, rows: slice | Mask) -> tuple[Array, Mask]:
        """When the sensor was read, s, and which `rows` of the table have a believable time."""
        t = self.times(table)[rows]
        column = next((name for name in SAMPLE_TIME_COLUMNS if name in table), None)
        if column is not None and table.format.letter(column) in "QIqi":
            read = table[column][rows].astype(np.float64)
            # a column of 32 bits wraps every 71 minutes; the compass may be read while its message is being written
            late = 1e-6 * ((t * 1e6 - read + 0.5 * WRAP_US) % WRAP_US - 0.5 * WRAP_US)
            t = np.where(np.abs(late) < LATEST_S, t - late, t)
        keep = np.ones(len(t), dtype=bool)
        return t, keep

    def _stamps(self, table: Table) -> Array:
        stamp = _stamp(table)
        assert stamp is not None
        return np.asarray(table[stamp[0]].astype(np.float64) * stamp[1])


def _stamp(table: Table) -> tuple[str, float] | None:
    for column, unit in STAMPS:
        if table.format.letter(column) in ("Q", "I", "q", "i"):
            return column, unit
    return None
