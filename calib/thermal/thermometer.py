"""Temperature at any instant, interpolated from a thermometer with repeated readings.

Autopilots read a thermometer about once a second and send the last reading with every sample. A reading is true when
it is taken and grows old from there. When it was taken must be told from the stream: a value that differs was just
read; one that stands for many seconds was read again and again, the last time one period before it changed.
"""

from __future__ import annotations

import numpy as np

from mavcal.calib.recording import Array, Channel
from mavcal.calib.thermal.cells import CELLS

_USUAL = 0.1  # quantile of the times between two values that is taken as the period: slow changes stand for longer
_FEW = 3  # values of one part that are kept as they are; more of them are averaged
_LATE = 0.25  # of a period: a value after a longer silence may have been read before it was seen
_STOOD = 1.5  # times the usual: values that stood for longer are never joined with others
_TIME, _LAST, _VALUE, _SILENCE = range(4)


class Thermometer:
    """Values of one thermometer over time: each when it was first and last seen.

    Parameters
    ----------
    limit : int
        Values to keep, up to twice as many between two joins.
    """

    def __init__(self, limit: int = CELLS) -> None:
        self._limit = limit
        self._rows = np.empty((2 * limit, 4))
        self._used = 0
        self._value = np.nan
        self._seen = -np.inf
        self.limits = (np.inf, -np.inf)
        """Lowest and highest value, degC."""

    def __len__(self) -> int:
        return self._used

    def add(self, part: Channel) -> None:
        """Take samples, later than those before; many different values among them count as one reading, their mean."""
        if not len(part):
            return
        t, values = part.t, part.values[:, 0]
        self.limits = (min(self.limits[0], float(values.min())), max(self.limits[1], float(values.max())))
        before = np.append(self._seen, t[:-1])
        fresh = values != np.append(self._value, values[:-1])
        self._value, self._seen = float(values[-1]), float(t[-1])
        found = np.column_stack([t, before, values, t - before])[fresh]
        if len(found) > _FEW:
            found = np.array([[found[:, _TIME].mean(), found[0, _LAST], found[:, _VALUE].mean(), found[0, _SILENCE]]])
        for row in found:
            self._begin(row)
        self._rows[self._used - 1, _LAST] = self._seen

    def _begin(self, row: Array) -> None:
        """A new value; its `_LAST` is that of the value before it until its own is known."""
        if self._used == len(self._rows):
            self._join()
        if self._used:
            self._rows[self._used - 1, _LAST] = row[_LAST]
        self._rows[self._used] = row
        self._used += 1

    def at(self, time: Array) -> Array:
        """Temperature at times (N,), degC: straight lines between the instants of reading."""
        known, values = self._instants()
        return np.asarray(np.interp(time, known, values), dtype=np.float64)

    def _instants(self) -> tuple[Array, Array]:
        """Times and temperatures of the thermometer's readings, as far as the times are known."""
        time, last, value, silence = self._rows[: self._used].T.copy()
        if self._used < 3:
            return time, value
        spans = np.diff(time)
        usual = float(np.quantile(spans, _USUAL))
        interval = float(np.median(silence[1:]))  # between two messages
        # What stood until `last` was read within the period before it. How long the next value stands tells the period.
        period = np.maximum(np.append(spans[1:], (np.inf, np.inf)), usual)
        held = last - np.maximum(period - interval, 0.0)
        late = silence > interval + _LATE * usual
        complete = late & ~np.append(late[1:], True) & np.isfinite(held)
        earliest = np.append(-np.inf, last[:-1])
        time[complete] = np.minimum(time, np.maximum(held, earliest))[complete]
        stood = np.flatnonzero((held > time)[:-1])
        at, again = np.insert(time, stood + 1, held[stood]), np.insert(value, stood + 1, value[stood])
        return at, again

    def _join(self) -> None:
        """Make pairs of neighbours one, except what stood for long; where that is too little, make room."""
        rows = self._rows[: self._used]
        pairs = rows[: self._used // 2 * 2].reshape(-1, 2, 4)
        stands = pairs[:, :, _LAST] - pairs[:, :, _TIME]
        usual = np.median(rows[:, _LAST] - rows[:, _TIME]) + np.quantile(np.diff(rows[:, _TIME]), _USUAL)
        brief = (stands <= _STOOD * usual).all(axis=1)
        first, second = pairs[:, 0].copy(), pairs[:, 1]
        first[brief, _TIME] = pairs[brief, :, _TIME].mean(axis=1)
        first[brief, _VALUE] = pairs[brief, :, _VALUE].mean(axis=1)
        first[brief, _LAST] = second[brief, _LAST]
        both = np.stack([first, second], axis=1).reshape(-1, 4)
        joined = np.vstack([both[np.column_stack([np.ones_like(brief), ~brief]).ravel()], rows[2 * len(pairs) :]])
        if len(joined) > 1.5 * self._limit:
            self._limit *= 2
        self._rows = np.empty((2 * self._limit, 4))
        self._rows[: len(joined)] = joined
        self._used = len(joined)
