"""One temperature curve over several tables of a device, an offset for each, cross-validated."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.fit import FitResult, FitStatus
from mavcal.calib.procedures.drift_fit import fit_posed
from mavcal.calib.recording import Channel
from mavcal.calib.thermal.drift import DriftData
from mavcal.calib.thermal.fit import PolynomialOptions

Array = NDArray[np.float64]

TABLES_WARNING = "{} tables, each with an offset of its own"
_ROWS = 20_000  # of a table, that are enough to compare curves
_SEEN = 50  # rows within and outside of the range of the others, with which one is judged
_BETTER = 0.95  # of what the polynomial leaves, that a slope has to leave to be taken


@dataclass(frozen=True)
class Outside:
    """What is left of held-out tables outside the temperatures of the others, rms in the sensor's unit."""

    slope: float
    polynomial: float
    clamped: float
    """By the polynomial held at the ends of its range, as a firmware does."""
    low: float
    high: float
    """degC that the others covered."""


def fit_tables(tables: Sequence[tuple[Channel, Array]], options: PolynomialOptions, *, relative: bool) -> FitResult:
    """The common curve of one sensor in several tables: its samples and a temperature (N,) for each, degC.

    A slope takes the place of the polynomial where it leaves less of a table that was held out, outside the range of
    the others.
    """
    degree = options.degree
    found = outside_of(tables, degree)
    used_degree = 1 if found is not None and found.slope < _BETTER * found.polynomial else degree
    channel, temperature, number = _joined(tables)
    good = np.isfinite(channel.values).all(axis=1) & np.isfinite(temperature)
    data = DriftData.of(channel.take(good), temperature[good])
    number = number[good]
    if len(number) != data.n:  # spikes were left out: rows are told apart by their time
        number = number[np.searchsorted(channel.t[good], data.time)]
    fit = fit_posed(
        channel,
        data,
        number,
        dataclasses.replace(options, degree=used_degree),
        relative=relative,
        warning=TABLES_WARNING,
    )
    if found is None or fit.status == FitStatus.REFUSED:
        return fit
    held = dataclasses.asdict(found) | {"degree": used_degree}
    return dataclasses.replace(
        fit,
        warnings=(*fit.warnings, _comparison(found, degree, used_degree, fit.unit)),
        quality={**fit.quality, "held_out": held},
    )


def outside_of(tables: Sequence[tuple[Channel, Array]], degree: int) -> Outside | None:
    """Each table held out in turn; None where none reaches beyond the temperatures of the others, or degree is 1."""
    thinned = [_thinned(channel, temperature) for channel, temperature in tables]
    squares, count, reach = np.zeros(3), 0, (np.inf, -np.inf)
    for k, (t, y) in enumerate(thinned):
        others = [table for j, table in enumerate(thinned) if j != k]
        if degree < 2 or not others:
            return None
        low, high = min(float(u.min()) for u, _ in others), max(float(u.max()) for u, _ in others)
        inside = (t >= low) & (t <= high)
        if inside.sum() < _SEEN or (~inside).sum() < _SEEN:
            continue
        held = np.clip(t, low, high)
        slope, curve = _curve(others, 1, low, high), _curve(others, degree, low, high)
        for row, (coefficients, at) in enumerate(((slope, t), (curve, t), (curve, held))):
            left = y - _value(coefficients, at, low, high)
            left = left - left[inside].mean(axis=0)
            squares[row] += float((left[~inside] ** 2).mean(axis=1).sum())
        count += int((~inside).sum())
        reach = min(reach[0], low), max(reach[1], high)
    if not count:
        return None
    slope_rms, polynomial_rms, clamped_rms = np.sqrt(squares / count)
    return Outside(float(slope_rms), float(polynomial_rms), float(clamped_rms), reach[0], reach[1])


def _comparison(found: Outside, degree: int, used_degree: int, unit: str) -> str:
    """The comparison in a sentence, and what clamping costs."""
    better = "a slope is fitted" if used_degree == 1 else f"degree {used_degree} stays"
    cost = found.clamped / max(min(found.slope, found.polynomial), 1e-300)
    return (
        f"a held-out table is left, outside the temperatures of the others, with {found.slope:.2g} {unit} by a slope "
        f"and {found.polynomial:.2g} by degree {degree}: {better}. Firmwares clamp instead, which leaves "
        f"{found.clamped:.2g} {unit}, {cost:.1f} times as much. Warm it up through all temperatures that are flown"
    )


def _thinned(channel: Channel, temperature: Array) -> tuple[Array, Array]:
    good = np.isfinite(temperature) & np.isfinite(channel.values).all(axis=1)
    step = max(1, int(good.sum()) // _ROWS)
    return temperature[good][::step], channel.values[good][::step]


def _curve(tables: Sequence[tuple[Array, Array]], degree: int, low: float, high: float) -> Array:
    """Coefficients (degree, 3) of the powers of the scaled temperature, with a constant for every table."""
    rows = np.concatenate(
        [_powers(t, degree, low, high) - _powers(t, degree, low, high).mean(axis=0) for t, _ in tables]
    )
    values = np.concatenate([y - y.mean(axis=0) for _, y in tables])
    return np.asarray(np.linalg.lstsq(rows, values, rcond=None)[0])


def _value(coefficients: Array, t: Array, low: float, high: float) -> Array:
    return np.asarray(_powers(t, len(coefficients), low, high) @ coefficients)


def _powers(t: Array, degree: int, low: float, high: float) -> Array:
    x = (t - 0.5 * (low + high)) / max(0.5 * (high - low), 1e-9)
    return np.asarray(x[:, None] ** np.arange(1, degree + 1))


def _joined(tables: Sequence[tuple[Channel, Array]]) -> tuple[Channel, Array, NDArray[np.intp]]:
    """One channel after the other on one clock, their temperatures, and the table of each row."""
    times, end = [], 0.0
    for channel, _ in tables:
        times.append(channel.t - channel.t[0] + end)
        end = float(times[-1][-1]) + 60.0
    zero = [channel.zero_bin for channel, _ in tables]
    joined = dataclasses.replace(
        tables[0][0],
        t=np.concatenate(times),
        values=np.concatenate([channel.values for channel, _ in tables]),
        zero_bin=np.concatenate([z for z in zero if z is not None]) if all(z is not None for z in zero) else None,
    )
    number = np.repeat(np.arange(len(tables)), [len(channel) for channel, _ in tables])
    return joined, np.concatenate([t for _, t in tables]), number.astype(np.intp)
