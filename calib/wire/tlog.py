"""Telemetry logs: a sequence of records, each eight bytes of big-endian microseconds since 1970 and one frame."""

from __future__ import annotations

import struct
from collections.abc import Iterator

from mavcal.calib.wire.frames import Frame, Plausibility, cut, next_magic

_TIME = struct.Struct(">Q")


def tlog_record(time_us: int, raw: bytes) -> bytes:
    """One record of a .tlog."""
    return _TIME.pack(time_us) + raw


class TlogReader:
    """Reads the records of a .tlog and resynchronises after damage.

    Iterate for ``(time_us, frame)``; the counters are right once the iteration has ended. A frame of an unknown
    message counts only if another record, or the end, follows it.
    """

    def __init__(self, data: bytes | memoryview) -> None:
        self._data = bytes(data)
        self.records = 0
        self.skipped_bytes = 0
        self.unknown = 0

    def __iter__(self) -> Iterator[tuple[int, Frame]]:
        data, end = self._data, len(self._data)
        plausibility = Plausibility(data)
        self.records = self.skipped_bytes = self.unknown = 0
        at = 0
        while at + 8 < end:
            frame = cut(data, at + 8, end)
            if isinstance(frame, Frame):
                stop = at + 8 + len(frame.raw)
                if frame.known or plausibility.unverified(at + 8, stop, stop + 8):
                    self.records += 1
                    self.unknown += not frame.known
                    yield _TIME.unpack_from(data, at)[0], frame
                    at = stop
                    continue
            step = next_magic(data, at + 9, end) - 8
            self.skipped_bytes += step - at
            at = step
        self.skipped_bytes += end - at if at < end else 0


def iter_tlog(data: bytes | memoryview) -> Iterator[tuple[int, Frame]]:
    """Iterate over ``(time_us, frame)`` of a .tlog; use :class:`TlogReader` to also learn what was skipped."""
    return iter(TlogReader(data))
