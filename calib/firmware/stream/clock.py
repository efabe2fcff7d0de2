"""The vehicle's clock from time stamps that wrap, arrive late, or restart after a reboot."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

WRAP_S: Final = 2.0**32 / 1000.0
"""A millisecond counter of 32 bits starts again after 49.7 days."""
WRAP_WINDOW_S: Final = 60.0
BACKWARD_S: Final = 1.0
"""A stamp this much older than the newest one is late, or the clock has started again."""
CONFIRMATIONS: Final = 3
"""So many old stamps in a row are a reboot; fewer are frames that were held up on their way."""
REBOOT_GAP_S: Final = 0.5
"""What is put between the last time before a reboot and the first one after it; its true length is not known."""


class VehicleClock:
    """Turns raw time stamps, in the order of arrival, into seconds that never run backward over a reboot.

    A late frame keeps its (older) time. The outcome does not depend on how the stamps are cut into batches.
    """

    def __init__(self) -> None:
        self._newest: float | None = None
        self._offset = 0.0
        self._suspects = 0

    @property
    def now(self) -> float | None:
        """Newest time; None before the first stamp."""
        return None if self._newest is None else self._newest + self._offset

    def unwrap_ms(self, milliseconds: NDArray[np.unsignedinteger]) -> Array:
        """Seconds of ``time_boot_ms`` stamps, whole turns of the counter put back."""
        seconds = milliseconds.astype(np.float64) / 1000.0
        if self._newest is None or self._newest < WRAP_S / 2:
            return seconds
        turned = seconds + WRAP_S * np.round((self._newest - seconds) / WRAP_S)
        return np.where(np.abs(turned - self._newest) <= WRAP_WINDOW_S, turned, seconds)

    def read(self, raw: Array) -> tuple[Array, tuple[int, ...]]:
        """Times of `raw` stamps (s since boot, in order of arrival), and the indices at which a new boot begins."""
        if not len(raw):
            return raw, ()
        newest = raw[0] if self._newest is None else self._newest
        reached = np.maximum.accumulate(np.concatenate(([newest], raw)))
        if self._suspects == 0 and (raw >= reached[:-1] - BACKWARD_S).all():
            self._newest = float(reached[-1])
            return raw + self._offset, ()
        return self._read_one_by_one(raw, float(newest))

    def _read_one_by_one(self, raw: Array, newest: float) -> tuple[Array, tuple[int, ...]]:
        times, reboots = np.empty(len(raw)), []
        for i, stamp in enumerate(raw.tolist()):
            if stamp >= newest - BACKWARD_S:
                self._suspects = 0
                newest = max(newest, stamp)
            else:
                self._suspects += 1
                if self._suspects >= CONFIRMATIONS:
                    self._offset += newest + REBOOT_GAP_S - stamp
                    newest, self._suspects = stamp, 0
                    reboots.append(i)
            times[i] = stamp + self._offset
        self._newest = newest
        return times, tuple(reboots)
