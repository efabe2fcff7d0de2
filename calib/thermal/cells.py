"""Samples of one sensor averaged over cells of time, in bounded memory.

A cell holds the number of its samples, their mean time, mean and scatter. If bins are coarse relative to the noise, it
also holds the number of samples in each bin. When there are too many cells, neighbours are joined. A thermal drift is
linear within a cell, so a fit loses nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.recording import Array, Channel
from mavcal.calib.stats.quantisation import COARSE, half_widths
from mavcal.calib.thermal.drift import DriftData, TemperatureBins

CELLS = 2048
"""Cells that are kept, up to twice as many between two joins: ticks of 0.25 s for 17 minutes, then of 0.5 s."""

_PENDING = 256  # pieces of bins that wait before they are put together
_FINE = 1.5  # times COARSE: noise above it needs no bins
_FROM_ZERO = 10.0  # sd from the bin around zero, which is wide
_GRAIN = 1e-6  # of a quantum: undone calibrations leave rounding errors on equal bins


@dataclass(frozen=True, eq=False)
class CellTable:
    """The cells in order of time: `count`, mean `time`, `span`, `mean` (M, k) and `squares` (M, k) about it."""

    time: Array
    count: Array
    span: NDArray[np.intp]
    mean: Array
    squares: Array


class DriftCells:
    """Cells of one channel with k columns; parts come in order of time.

    Parameters
    ----------
    columns : int
        Of the channel.
    limit : int
        Cells to keep.
    """

    def __init__(self, columns: int = 3, *, limit: int = CELLS) -> None:
        self._k = columns
        self._limit = limit
        self._rows = np.empty((2 * limit, 3 + 2 * columns))
        self._used = 0
        self._each = 1  # parts of a full cell
        self._parts = 0  # of the last one
        self._bins: list[list[Array] | None] = [[] for _ in range(columns)]
        self._quantum = 0.0
        self.channel: Channel | None = None
        """Empty channel with the metadata of all samples; None before the first."""

    def __len__(self) -> int:
        return self._used

    def add(self, part: Channel, span: int = 0) -> None:
        """Add the samples of `part` as one cell; cells of different `span` are never joined.

        Raises
        ------
        InvalidInputError
            If the number of columns differs.
        """
        values = part.values
        if values.shape[1] != self._k:
            raise InvalidInputError(f"{part.sensor}: {values.shape[1]} columns in cells of {self._k}")
        if not len(part):
            return
        if self.channel is None:
            self.channel, self._quantum = part.take(slice(0, 0)), part.quantum
        mean = values.mean(axis=0)
        squares = ((values - mean) ** 2).sum(axis=0)
        row = np.concatenate([[part.t.mean(), len(part), span], mean, squares])
        if self._used and self._parts < self._each and self._rows[self._used - 1, 2] == span:
            both = np.vstack([self._rows[self._used - 1], row])
            self._rows[self._used - 1] = _joined(both, np.zeros(2, dtype=np.intp), self._k)[0]
            self._parts += 1
        else:
            if self._used == len(self._rows):
                self._join()
            self._rows[self._used] = row
            self._used, self._parts = self._used + 1, 1
        if self._quantum > 0.0:
            self._count(part)

    def table(self) -> CellTable:
        """The cells so far."""
        rows = self._rows[: self._used].copy()
        k = self._k
        return CellTable(rows[:, 0], rows[:, 1], rows[:, 2].astype(np.intp), rows[:, 3 : 3 + k], rows[:, 3 + k :])

    def bins(self) -> tuple[TemperatureBins | None, ...]:
        """For every column, the number of samples of each cell in each bin; None where bins are fine."""
        found: list[TemperatureBins | None] = []
        for column in range(self._k):
            self._gather(column)
            pieces = self._bins[column]
            if not pieces or self._quantum <= 0.0:
                found.append(None)
                continue
            rows, values, halves, counts = pieces[0].T
            found.append(TemperatureBins(rows.astype(np.intp), values.copy(), halves.copy(), counts.copy()))
        return tuple(found)

    def data(self, temperature: Array) -> DriftData:
        """Data for a thermal fit, with one temperature a cell (degC)."""
        table = self.table()
        still = (table.squares == 0.0).all(axis=0) & (np.ptp(table.mean, axis=0) == 0.0)
        return DriftData(
            time=table.time,
            t=np.asarray(temperature, dtype=np.float64),
            y=table.mean,
            half=None,
            constant=np.asarray(still, dtype=np.bool_),
            ignored=0,
            counts=table.count,
            scatter=table.squares.sum(axis=0),
            cell_bins=self.bins() if self._quantum > 0.0 else None,
        )

    # -- bins --------------------------------------------------------------------------------------------------------

    def _count(self, part: Channel) -> None:
        half = half_widths(part)
        grain = _GRAIN * self._quantum
        for column in range(self._k):
            pieces = self._bins[column]
            if pieces is None:
                continue
            keys = np.round(part.values[:, column] / grain) * grain + 1j * half[:, column]
            kinds, counts = np.unique(keys, return_counts=True)
            pieces.append(np.column_stack([np.full(len(kinds), self._used - 1), kinds.real, kinds.imag, counts]))
            if len(pieces) >= _PENDING:
                self._gather(column)
                if self._is_fine(column):
                    self._bins[column] = None

    def _gather(self, column: int, renumbered: NDArray[np.intp] | None = None) -> None:
        """Put the pieces together, one row for every bin of a cell; `renumbered`: the new numbers of the cells."""
        pieces = self._bins[column]
        if not pieces:
            return
        whole = np.concatenate(pieces)
        if renumbered is not None:
            whole[:, 0] = renumbered[whole[:, 0].astype(np.intp)]
        whole = whole[np.lexsort((whole[:, 2], whole[:, 1], whole[:, 0]))]
        first = np.flatnonzero(np.append(True, (whole[1:, :3] != whole[:-1, :3]).any(axis=1)))
        counts = np.add.reduceat(whole[:, 3], first)
        self._bins[column] = [np.column_stack([whole[first, :3], counts])]

    def _is_fine(self, column: int) -> bool:
        """Whether the noise is far above the bin width and the values are far from the wide bin around zero."""
        rows = self._rows[: self._used]
        freedom = float((rows[:, 1] - 1.0).sum())
        sd = np.sqrt(float(rows[:, 3 + self._k + column].sum()) / max(freedom, 1.0))
        nearest = float(np.abs(rows[:, 3 + column]).min())
        return bool(sd > _FINE * COARSE * self._quantum and nearest > _FROM_ZERO * sd + self._quantum)

    # -- joining -----------------------------------------------------------------------------------------------------

    def _join(self) -> None:
        """Join neighbouring cells of the same span; if too many are left, double the limit."""
        rows = self._rows[: self._used]
        starts = np.append(True, np.diff(rows[:, 2]) != 0)
        since = np.arange(self._used) - np.maximum.accumulate(np.where(starts, np.arange(self._used), 0))
        number = np.cumsum(since % 2 == 0) - 1
        joined = _joined(rows, number, self._k)
        for column in range(self._k):
            self._gather(column, number.astype(np.intp))
        if len(joined) > 1.5 * self._limit:
            self._limit *= 2
        self._rows = np.empty((2 * self._limit, rows.shape[1]))
        self._rows[: len(joined)] = joined
        self._used, self._each = len(joined), 2 * self._each


def _joined(rows: Array, number: NDArray[np.intp], k: int) -> Array:
    """Merge the cells with the same `number`."""
    first = np.flatnonzero(np.append(True, np.diff(number) > 0))
    count = np.add.reduceat(rows[:, 1], first)
    means = np.add.reduceat(rows[:, 1, None] * rows[:, [0, *range(3, 3 + k)]], first, axis=0) / count[:, None]
    apart = rows[:, 3 : 3 + k] - means[number][:, 1:]
    squares = np.add.reduceat(rows[:, 3 + k :] + rows[:, 1, None] * apart**2, first, axis=0)
    return np.column_stack([means[:, 0], count, rows[first, 2], means[:, 1:], squares])
