"""Times of a DataFlash log in seconds since boot, without the corrupt ones.

A damaged byte may lie in a time stamp, where it would move a sample to any moment. The messages lie in the file in the
order of time, so a stamp that contradicts its neighbours is seen and its message left out; a clock that starts again in
the middle (a restart within one file) goes on where it stopped.
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
"""Columns that hold the time since boot. GPS of old firmwares says the time of the week in TimeMS, and its own in T."""
WHOLE: Final = ("Q", "I", "q", "i")
WRAP_US: Final = 2**32
WRAP_S: Final = 1e-6 * WRAP_US
"""A clock of 32 bits of microseconds runs over after 71 minutes."""
LATEST_US: Final = 1_000_000
"""A sample that claims to be older than this when it is logged was read at a time that is not known."""
BACKWARD_S: Final = 1.0
"""Messages of several threads may be written so little out of order; a longer step back is damage or a restart."""
CONFIRMATIONS: Final = 5
"""Messages in a row behind a step back that mean a restart; fewer are damage."""
RESTART_GAP_S: Final = 0.5
"""Seconds assumed between the last time before a restart and the first one after it; the true length is unknown."""
LONGEST_JUMP_S: Final = 60.0
"""A last message that lies further behind all others is damage."""
LONGEST_S: Final = 3600.0
"""Other messages may go on so long after the last one of the densest."""
ROUNDS: Final = 8
ROWS: Final = 1 << 15
"""Messages whose times are worked on at once."""


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
        """Places in the file and times of the densest message whose times are plausible.

        A quarter of what a recording of it needs, so it is only made for a log with damage or messages without stamp.
        """
        if self._densest is None:
            return np.empty(0, dtype=np.int64), np.empty(0)
        times = self._over_restarts(_stamps(self._densest), self._densest)
        keep = _consistent(times)
        return self._densest.offsets[keep], times[keep]

    def _over_restarts(self, t: Array, table: Table) -> Array:
        """`t` as it goes on over restarts."""
        if self._restarts:
            t = t.copy()
            places = [place for place, *_ in self._restarts]
            edges = [*np.searchsorted(table.offsets, places).tolist(), len(t)]
            for (_, step, _), first, last in zip(self._restarts, edges, edges[1:], strict=False):
                t[first:last] += step
        return t

    @property
    def events(self) -> list[Event]:
        """Restarts within the log; a clock of 32 bits that ran over did not start again."""
        return [
            Event(t, "reboot", "the vehicle's clock started again")
            for (_, _, t), wrapped in zip(self._restarts, self._wrapped, strict=True)
            if not wrapped
        ]

    def times(self, table: Table) -> Array:
        """Times at which the messages of `table` were written, s; nan where the stamp cannot be believed."""
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
        """The same for events: a stamp that cannot be believed is replaced by the one of the messages around."""
        t = self.times(table)
        lost = ~np.isfinite(t)
        if lost.any():
            t[lost] = self._by_place(table)[lost]
        return [float(time) for time in t]

    def sample_times(self, table: Table) -> Array:
        """Times at which the sensor was read, s; where no column says it, when the message was written."""
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
    """Which of the times stay so that none is before the one in front of it; as few as possible are left out.

    When two contradict each other, the one goes that contradicts its other neighbour too.
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
    """Which times of the densest messages contradict no other."""
    keep = ordered(times)
    if keep.any() and len(times) > 2 and times[-1] - times[-2] > LONGEST_JUMP_S:
        keep[-1] = False
    return keep


def _restarts(t: Array) -> list[int]:
    """Rows at which the clock starts again: many in a row are earlier than the one before, and go on in order."""
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
