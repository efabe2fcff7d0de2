"""Counting lost frames by sequence numbers of eight bits.

The sequence alone shows a gap modulo 256. The rest is inferred. On Linux a UDP socket reports its count of dropped
datagrams with every datagram. Elsewhere the sender's own rate tells how many frames a silence amounts to.
"""

from __future__ import annotations

from mavcal.service.link.types import LinkStatistics

_WINDOW_S = 0.5
_REMEMBERED = 256
_SEEN_MASK = (1 << _REMEMBERED) - 1
_TOLERANCE = 8.0
"""Least tolerance of a count from a rate."""
_LONGEST_S = 30.0
"""Longest silence that counts as loss, s; a longer one is an absence."""


class SequenceCounter:
    """Counts what one sender's sequence numbers show."""

    __slots__ = (
        "_bytes",
        "_dropped",
        "_last",
        "_last_at",
        "_now",
        "_received_then",
        "_seen",
        "_sent",
        "_sent_per_s",
        "_window_at",
        "bytes_per_s",
        "bytes_received",
        "duplicated",
        "frames_per_s",
        "lost",
        "lost_inferred",
        "out_of_order",
        "received",
    )

    def __init__(self) -> None:
        self.received = self.lost = self.lost_inferred = self.duplicated = self.out_of_order = 0
        self.bytes_received = 0
        self.bytes_per_s = self.frames_per_s = self._sent_per_s = 0.0
        self._last = -1
        self._last_at = self._window_at = self._now = 0.0
        self._seen = 1  # bit k: the number k before the newest has come
        self._dropped = self._sent = self._bytes = self._received_then = 0

    def see(self, sequence: int, now: float, size: int, dropped: int = 0, share: float = 1.0) -> None:
        """Count a frame.

        Parameters
        ----------
        sequence
            0..255.
        now
            Monotonic time of its arrival, s.
        size
            Bytes of the frame.
        dropped
            Datagrams that the socket had to drop so far, of all senders; 0 if that is unknown.
        share
            This sender's share of all frames on the socket, 0..1.
        """
        if now != self._now:
            self._end_of_drain(now)
        self.received += 1
        self._bytes += size
        self.bytes_received += size
        step = (sequence - self._last) & 0xFF
        if self._last < 0:
            self._window_at, step = now, 1
        elif step != 1 or dropped != self._dropped:
            step = self._full_step(step, now - self._last_at, (dropped - self._dropped) * share)
            self._dropped = dropped
        if step > 0:
            self._advance(step, sequence, now)
        elif self._seen >> -step & 1:
            self.duplicated += 1
        else:
            self._seen |= 1 << -step
            self.out_of_order += 1
            self.lost = max(0, self.lost - 1)

    def _end_of_drain(self, now: float) -> None:
        """End the window before a new time: frames read together have one time, and must all fall in it."""
        if self._last >= 0 and self._now - self._window_at >= _WINDOW_S:
            self._roll(self._now)
        self._now = now

    def _advance(self, step: int, sequence: int, now: float) -> None:
        self.lost += step - 1
        self._sent += step
        self._seen = (self._seen << step | 1) & _SEEN_MASK if step < _REMEMBERED else 1
        self._last, self._last_at = sequence, now

    def _full_step(self, step: int, elapsed: float, dropped: float) -> int:
        """Steps forward (beyond 255 if many frames are missing), or 0 and less for a late frame.

        `step` is the difference of the sequence numbers modulo 256.
        """
        back, forward = -step & 0xFF, step or 256
        missing = dropped
        if not dropped and elapsed >= _LONGEST_S:
            return 1  # nothing before the absence is late or missing now
        if not dropped:
            missing = max(self._sent_per_s * elapsed - 1, 0.0)
        wraps = max(0, round((missing - (forward - 1)) / 256))
        error = abs(forward - 1 + 256 * wraps - missing)
        # a rate is only a guess: believe it where the sequence agrees, and never without a visible gap
        if not dropped and wraps and (forward == 1 or error > max(_TOLERANCE, missing / 8)):
            wraps, error = 0, abs(forward - 1 - missing)
        if back + _TOLERANCE < error:  # fewer steps back than frames forward unaccounted for: late, or doubled
            return -back
        self.lost_inferred += 256 * wraps
        return forward + 256 * wraps

    def _roll(self, now: float) -> None:
        elapsed = now - self._window_at
        self.bytes_per_s = self._bytes / elapsed
        self.frames_per_s = (self.received - self._received_then) / elapsed
        sent = self._sent / elapsed
        self._sent_per_s = sent if self._sent_per_s == 0.0 else 0.5 * (self._sent_per_s + sent)
        self._window_at, self._bytes, self._received_then, self._sent = now, 0, self.received, 0

    def statistics(self, crc_errors: int, now: float) -> LinkStatistics:
        """Snapshot; rates are 0 if nothing came for two seconds."""
        fresh = now - self._window_at < 2.0 + _WINDOW_S
        return LinkStatistics(
            received=self.received,
            lost=self.lost,
            lost_inferred=self.lost_inferred,
            duplicated=self.duplicated,
            out_of_order=self.out_of_order,
            crc_errors=crc_errors,
            bytes_received=self.bytes_received,
            bytes_per_s=self.bytes_per_s if fresh else 0.0,
            frames_per_s=self.frames_per_s if fresh else 0.0,
        )
