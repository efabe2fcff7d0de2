"""Samples count from the instant on at which the calibration in force is known."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection

import numpy as np

from mavcal.calib.firmware.in_force.undo import GUARD_AFTER_S
from mavcal.calib.recording import Recording, Sensor


class KnownCalibration:
    """Leaves samples out that are older than the first reading of the last of `names`.

    A vehicle may have rewritten one of them before: it would take off a calibration that was not in force. Chunks
    follow each other. Positions stay: nothing is taken off them.
    """

    def __init__(self, names: Collection[str]) -> None:
        self._unread = set(names)
        self._since = -np.inf

    def feed(self, chunk: Recording) -> Recording:
        """The chunk without samples from before."""
        for entry in chunk.parameters.entries:
            if entry.name in self._unread:
                self._unread.remove(entry.name)
                self._since = max(self._since, entry.t + GUARD_AFTER_S)
        since = np.inf if self._unread else self._since
        kept = (c if c.sensor == Sensor.POSITION else c.between(since, np.inf) for c in chunk.channels)
        return dataclasses.replace(chunk, channels=tuple(channel for channel in kept if len(channel)))
