"""Reads a magnetometer: averages the raw field over each period, and repeats it in between."""

from __future__ import annotations

import numpy as np

from mavcal.service.simvehicle.rotation import Array, body_from_ned
from mavcal.service.simvehicle.world import SimWorld

KEEP = 64  # readings kept: more than any tick asks for at the highest speed


class MagReader:
    """Raw magnetometer readings (µT, chip frame) of all instances, new once a period.

    A driver's timer takes samples, and a task of the main loop reads their mean since it was last there. The task has
    no fixed phase to the timer or the streams, and is sometimes one loop late. One reading may therefore average a
    sample more than the next. The age of the reading in a message depends on the phase.

    Args:
        world: what is measured.
        period: seconds between fresh readings.
        subsamples: how many samples the timer takes in a period; 1 is the field at its end.
        phase: when the first period begins, s.
        late: by how much a reading comes late at most, s.
    """

    def __init__(
        self, world: SimWorld, period: float, subsamples: int, *, phase: float = 0.0, late: float = 0.0
    ) -> None:
        self._world, self._period, self._phase, self._late = world, period, phase, late
        self._step = period / subsamples
        self.restart()

    def restart(self) -> None:
        """Begin at vehicle time zero."""
        self._rng = np.random.default_rng([self._world.config.seed, 5])
        self._index = 1  # of the next reading: due at phase + index · period, or a little later
        self._due = self._next_due()
        self._taken = 0
        self._pending = np.empty((0, 3))
        self._times = np.zeros(1)
        count = len(self._world.truth.mags)
        first = self._world.state(np.zeros(1))
        field = body_from_ned(first.q, self._world.field)
        self._values = [self._world.mag(k, field, np.zeros(1)) for k in range(count)]

    def _next_due(self) -> float:
        late = self._rng.uniform(0.0, self._late) if self._late > 0.0 else 0.0
        return self._phase + self._index * self._period + late

    def advance(self, until: float) -> None:
        """Take all samples up to `until`; the motion must not have changed in between."""
        last = int(np.floor(until / self._step + 1e-9))
        if last > self._taken:
            q, _ = self._world.motion.evaluate(np.arange(self._taken + 1, last + 1) * self._step)
            self._pending = np.concatenate([self._pending, body_from_ned(q, self._world.field)])
            self._taken = last
        fresh, means = [], []
        while self._due <= until + 1e-9:
            count = len(self._pending) - max(last - int(np.floor(self._due / self._step + 1e-9)), 0)
            if count > 0:
                fresh.append(self._due)
                means.append(self._pending[:count].mean(axis=0))
                self._pending = self._pending[count:]
            self._index += 1
            self._due = self._next_due()
        if fresh:
            self._append(np.array(fresh), np.array(means))

    def _append(self, fresh: Array, field_body: Array) -> None:
        self._times = np.concatenate([self._times, fresh])[-KEEP:]
        self._values = [
            np.concatenate([old, self._world.mag(k, field_body, fresh)])[-KEEP:] for k, old in enumerate(self._values)
        ]

    def indices(self, t: Array) -> Array:
        """Index of the latest kept reading at each time t (N,)."""
        found = np.searchsorted(self._times, t + 1e-9, side="right") - 1
        return np.maximum(found, 0)

    def raw(self, instance: int, t: Array) -> Array:
        """The latest raw reading at times t, shape (N, 3)."""
        return np.asarray(self._values[instance][self.indices(t)])

    def read_at(self, t: Array) -> Array:
        """Times (N,) of the readings that are valid at times t."""
        return np.asarray(self._times[self.indices(t)])
