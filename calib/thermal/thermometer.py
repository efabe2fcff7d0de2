"""Temperature at any instant, interpolated from a thermometer with repeated readings.

Autopilots read a thermometer about once a second and send the last reading with every sample. A reading is valid at its
time and then becomes stale. Its time must be inferred from the stream: a new value was just read. A value that stays
for many seconds was read repeatedly, last one period before it changed.
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
    """Values of one thermometer over time, with the first and last time of each.

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
        """Add samples later than the previous ones; many different values among them count as one mean reading."""
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
        """Begin a new value; its `_LAST` is that of the previous value until its own is known."""
        if self._used == len(self._rows):
            self._join()
        if self._used:
            self._rows[self._used - 1, _LAST] = row[_LAST]
        self._rows[self._used] = row
        self._used += 1

    def at(self, time: Array) -> Array:
        """Temperature at times (N,), degC, linear between the reading times."""
        known, values = self._instants()
        return np.asarray(np.interp(time, known, values), dtype=np.float64)

    def _instants(self) -> tuple[Array, Array]:
        """Times and temperatures of the readings whose times are known."""
        time, last, value, silence = self._rows[: self._used].T.copy()
        if self._used < 3:
            return time, value
        spans = np.diff(time)
        usual = float(np.quantile(spans, _USUAL))
        interval = float(np.median(silence[1:]))  # between two messages
        # The value held until `last` was read within the period before it; the next hold time gives the period.
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
        """Merge pairs of neighbours, except long-lasting values; if too many are left, double the limit."""
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
