"""When a magnetometer is fresh: a reader that averages the raw field over each period and repeats it in between."""

from __future__ import annotations

import numpy as np

from service.simvehicle.rotation import Array, body_from_ned
from service.simvehicle.world import World

KEEP = 64  # readings kept: more than any tick asks for at the highest speed


class MagReader:
    """Raw magnetometer readings (µT, chip frame) of all instances, new once a period.

    Args:
        world: what is measured.
        period: seconds between fresh readings.
        subsamples: how many instants of the period are averaged; 1 is the field at its end.
    """

    def __init__(self, world: World, period: float, subsamples: int) -> None:
        self._world, self._period, self._subsamples = world, period, subsamples
        self.restart()

    def restart(self) -> None:
        """Begin at vehicle time zero."""
        self._next = 1  # index of the next reading: it is fresh at _next · period
        self._pending = np.empty((0, 3))
        self._times = np.zeros(1)
        count = len(self._world.truth.mags)
        first = self._world.state(np.zeros(1))
        field = body_from_ned(first.q, self._world.field)
        self._values = [self._world.mag(k, field, np.zeros(1)) for k in range(count)]

    def advance(self, until: float) -> None:
        """Take all samples up to `until`: the motion must still be the one that was in force."""
        step = self._period / self._subsamples
        done = (self._next - 1) * self._subsamples + len(self._pending)
        last = int(np.floor(until / step + 1e-9))
        if last <= done:
            return
        t = np.arange(done + 1, last + 1) * step
        q, _ = self._world.motion.evaluate(t)
        field = np.concatenate([self._pending, body_from_ned(q, self._world.field)])
        whole = len(field) // self._subsamples
        self._pending = field[whole * self._subsamples :]
        if whole:
            mean = field[: whole * self._subsamples].reshape(whole, self._subsamples, 3).mean(axis=1)
            fresh = np.arange(self._next, self._next + whole) * self._period
            self._next += whole
            self._append(fresh, mean)

    def _append(self, fresh: Array, field_body: Array) -> None:
        self._times = np.concatenate([self._times, fresh])[-KEEP:]
        self._values = [
            np.concatenate([old, self._world.mag(k, field_body, fresh)])[-KEEP:] for k, old in enumerate(self._values)
        ]

    def indices(self, t: Array) -> Array:
        """Which kept reading is the latest at each time t (N,)."""
        found = np.searchsorted(self._times, t + 1e-9, side="right") - 1
        return np.maximum(found, 0)

    def raw(self, instance: int, t: Array) -> Array:
        """The latest raw reading at times t, shape (N, 3)."""
        return np.asarray(self._values[instance][self.indices(t)])

    def read_at(self, t: Array) -> Array:
        """When the reading that is valid at times t was taken, shape (N,)."""
        return np.asarray(self._times[self.indices(t)])
