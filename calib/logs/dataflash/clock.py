"""Times of a DataFlash log in seconds since boot, without the corrupt ones.

A damaged byte in a time stamp would move a sample to any time. Messages are in the order of time, so a stamp that
contradicts its neighbours is detected and its message left out. Where the clock starts again (a restart within one
file), times continue from where it stopped.
"""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.firmware.ardupilot.log_fields import SAMPLE_TIME_COLUMNS
from mavcal.calib.recording import Array, Event

if TYPE_CHECKING:
    from mavcal.calib.logs.dataflash.tables import Log, Table

Mask = NDArray[np.bool_]

STAMPS: Final = (("TimeUS", 1e-6), ("T", 1e-3), ("TimeMS", 1e-3))
"""Columns with the time since boot. In old firmwares' GPS messages TimeMS is the time of week and T the time since
boot."""
WHOLE: Final = ("Q", "I", "q", "i")
WRAP_US: Final = 2**32
WRAP_S: Final = 1e-6 * WRAP_US
"""Period, s, of a 32-bit microsecond counter: 71 minutes."""
LATEST_US: Final = 1_000_000
"""Greatest age of a sample when it is logged, us; beyond it, the time of reading is unknown."""
BACKWARD_S: Final = 1.0
"""Largest disorder, s, of messages from several threads; a longer step back is damage or a restart."""
CONFIRMATIONS: Final = 5
"""Consecutive messages after a step back that confirm a restart; fewer mean damage."""
RESTART_GAP_S: Final = 0.5
"""Seconds assumed between the last time before a restart and the first one after it; the true length is unknown."""
LONGEST_JUMP_S: Final = 60.0
"""Largest time, s, from the last but one message to the last; beyond it, the last one is damaged."""
LONGEST_S: Final = 3600.0
"""Time, s, for which other messages may follow the last one of the densest type."""
ROUNDS: Final = 8
ROWS: Final = 1 << 15
"""Messages whose times are processed at once."""


class Clock:
    """Gives every message of `log` its time; messages without a stamp get that of the stamped one before them."""

    def __init__(self, log: Log) -> None:
        self.doubted = 0
        self._densest: Table | None = None
        self._span: tuple[float, float] | None = None
        self._restarts: list[tuple[int, float, float]] = []
        self._wrapped: list[bool] = []
        stamped = [name for name in log if name not in ("FMT", "PARM", "UNIT", "MULT") and _stamp(log[name])]
        if not stamped:
            return
        self._densest = log[max(stamped, key=lambda name: len(log[name]))]
        times = _stamps(self._densest)
        added = 0.0
        for row in _restarts(times):
            before, after = float(times[row - 1]), float(times[row])
            wrapped = 0.0 <= after + WRAP_S - before < LONGEST_JUMP_S
            step = added + (WRAP_S if wrapped else before + RESTART_GAP_S - after)
            self._restarts.append((int(self._densest.offsets[row]), step, after + step))
            self._wrapped.append(wrapped)
            added = step
        times = self._over_restarts(times, self._densest)
        believed = np.flatnonzero(_consistent(times))
        if len(believed):
            self._span = float(times[believed[0]]), float(times[believed[-1]])

    @cached_property
    def _grid(self) -> tuple[NDArray[np.int64], Array]:
        """File offsets and times of the densest message type, where plausible.

        It takes a quarter of the memory of a recording, so only logs with damage or messages without a stamp need it.
        """
        if self._densest is None:
            return np.empty(0, dtype=np.int64), np.empty(0)
        times = self._over_restarts(_stamps(self._densest), self._densest)
        keep = _consistent(times)
        return self._densest.offsets[keep], times[keep]

    def _over_restarts(self, t: Array, table: Table) -> Array:
        """`t` made continuous across restarts."""
        if self._restarts:
            t = t.copy()
            places = [place for place, *_ in self._restarts]
            edges = [*np.searchsorted(table.offsets, places).tolist(), len(t)]
            for (_, step, _), first, last in zip(self._restarts, edges, edges[1:], strict=False):
                t[first:last] += step
        return t

    @property
    def events(self) -> list[Event]:
        """Restarts within the log; an overflow of a 32-bit clock is not one."""
        return [
            Event(t, "reboot", "the vehicle's clock started again")
            for (_, _, t), wrapped in zip(self._restarts, self._wrapped, strict=True)
            if not wrapped
        ]

    def times(self, table: Table) -> Array:
        """Times at which the messages of `table` were written, s; nan where the stamp is implausible."""
        if _stamp(table) is None or self._span is None:
            return self._by_place(table)
        t = self._over_restarts(_stamps(table), table)
        first, last = self._span[0] - BACKWARD_S, self._span[1] + BACKWARD_S
        if len(t) and not (t[0] >= first and t[-1] <= last and (np.diff(t) >= -BACKWARD_S).all()):
            where, times = self._grid
            i = np.searchsorted(where, table.offsets)
            earliest = np.where(i > 0, times[np.maximum(i - 1, 0)] - BACKWARD_S, 0.0)
            latest = np.where(i < len(times), times[np.minimum(i, len(times) - 1)] + BACKWARD_S, times[-1] + LONGEST_S)
            wrong = (t < earliest) | (t > latest)
            self.doubted += int(wrong.sum())
            t[wrong] = np.nan
        return t

    def moments(self, table: Table) -> list[float]:
        """Times of the events of `table`; an implausible stamp is replaced by that of the surrounding messages."""
        t = self.times(table)
        lost = ~np.isfinite(t)
        if lost.any():
            t[lost] = self._by_place(table)[lost]
        return [float(time) for time in t]

    def sample_times(self, table: Table) -> Array:
        """Times at which the sensor was read, s; without a column for it, when the message was written."""
        t = self.times(table)
        column = next((name for name in SAMPLE_TIME_COLUMNS if table.format.letter(name) in WHOLE), None)
        if column is None or table.format.letter("TimeUS") not in WHOLE:
            return t
        all_written, all_read = table.columns("TimeUS", column)
        for row in range(0, len(t), ROWS):
            part = slice(row, row + ROWS)
            written, read = all_written[part].astype(np.int64), all_read[part].astype(np.int64)
            # a column of 32 bits wraps every 71 minutes; the compass may be read while its message is being written
            late = (written - read + WRAP_US // 2) % WRAP_US - WRAP_US // 2
            moved = t[part] - 1e-6 * written  # over a restart; nan where the time is not believed
            t[part] = np.where(np.abs(late) < LATEST_US, 1e-6 * (written - late) + moved, t[part])
        return t

    def _by_place(self, table: Table) -> Array:
        where, times = self._grid
        if not len(where):
            return np.zeros(len(table))
        before = np.searchsorted(where, table.offsets) - 1
        return np.asarray(times[np.maximum(before, 0)])


def ordered(t: Array) -> Mask:
    """Mask of the times to keep so that they never decrease; as few as possible are left out.

    Of two that contradict each other, the one that also contradicts its other neighbour is left out.
    """
    keep = np.isfinite(t)
    for _ in range(ROUNDS):
        left = np.flatnonzero(keep)
        times = t[left]
        back = np.flatnonzero(np.diff(times) < 0)
        if not len(back):
            return keep
        high = (back == 0) | (times[np.maximum(back - 1, 0)] <= times[back + 1])
        keep[left[np.where(high, back, back + 1)]] = False
    left = np.flatnonzero(keep)
    keep[left[t[left] < np.maximum.accumulate(t[left])]] = False
    return keep


def _consistent(times: Array) -> Mask:
    """Mask of the times of the densest message type that contradict no other."""
    keep = ordered(times)
    if keep.any() and len(times) > 2 and times[-1] - times[-2] > LONGEST_JUMP_S:
        keep[-1] = False
    return keep


def _restarts(t: Array) -> list[int]:
    """Rows at which the clock starts again: several consecutive ones are earlier than before, and in order."""
    found = []
    for i in np.flatnonzero(np.diff(t) < -BACKWARD_S).tolist():
        after = t[i + 1 : i + 1 + CONFIRMATIONS]
        before = t[max(0, i - CONFIRMATIONS) : i]
        whole = len(after) == CONFIRMATIONS and len(before) > 0
        if whole and (np.diff(after) >= 0).all() and after[-1] < np.median(before) - BACKWARD_S:
            found.append(i + 1)
    return found


def _stamps(table: Table) -> Array:
    stamp = _stamp(table)
    assert stamp is not None
    t = table[stamp[0]].astype(np.float64)
    t *= stamp[1]
    return np.asarray(t)


def _stamp(table: Table) -> tuple[str, float] | None:
    for column, unit in STAMPS:
        if table.format.letter(column) in WHOLE:
            return column, unit
    return None
