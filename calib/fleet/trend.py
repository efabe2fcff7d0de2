"""Drift of one sensor with time and temperature, and the date on which it exceeds its limit.

The lasting part of a bias is the line plus the walk, without the scatter from one power-up to the next. The bias has
left its limit when that part is farther than the limit from the bias that corrects the sensor. Both are taken at the
temperature of that calibration. Three axes count together. Intervals are of 90 %; docs/measured/accuracy.md states how
often they contained the truth in simulations.

Each axis follows ``y_i = a + d t_i + s (T_i - T_0) + w(t_i) + v_i + e_i``: `w` is a random walk, `v` the scatter from
one power-up to the next, `e` the measurement noise with known standard deviation. The sizes of `w` and `v` are
integrated over on a grid, with the marginal likelihood of all three axes together. Their prior is log-uniform, and
favours the walk, whose prediction is less certain. The drift has a prior of unknown typical size, so it can be near
zero (decision 22); with a flat one every sensor would leave its limit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import cache

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.fleet.record import BiasObservation

Array = NDArray[np.float64]
DAY_S = 86400.0
YEAR_D = 365.25
HORIZON_D = 10.0 * YEAR_D
"""Days beyond which nothing is predicted."""
COVERAGE = 0.90
LEAST_SPREAD_DEGC = 5.0
"""Least spread of temperatures, degC, that determines a slope."""
_APART = 1e-3
"""Temperature and time are inseparable if a straight line leaves less than this fraction of the temperature's spread.
Only made-up readings leave less."""
LEAST_SPAN_D = 1.0
MOST = 64
"""Most measurements of one trend: calibrations first, then the newest of the others."""
_DRAWS, _SEED = 4000, 21
_PATHS = 400
"""Number of draws that are extrapolated; the quantiles of slopes use all draws."""
_AHEAD_D = np.concatenate([[0.0], np.geomspace(0.5, HORIZON_D, 96)])
SHARES = np.array([0.0, 0.25, 0.5, 0.75, 1.0])
"""Grid of the walk's share in the scatter, over one mean interval between measurements."""
LEAN = np.array([0.01, 0.01, 0.03, 0.1, 0.85])
"""Prior of the shares."""
SIZES = np.geomspace(0.1, 20.0, 17)
"""Grid of the scatter's standard deviation, in units of that of the residuals."""
LEAST_NOISE = 0.02
"""Least standard deviation of a measurement, in units of that of the residuals: a smaller one only worsens the
conditioning."""
DRIFTS, LEAST_DRIFT, MOST_DRIFT = 10, 0.03, 10.0
"""Grid of the typical change over the whole span: number of values, the smallest in residuals, and the largest in
changes that a plain line finds."""


class Quantity(StrEnum):
    """What a trend may leave undetermined."""

    TIME = "time"
    TEMPERATURE = "temperature"
    LEAVING = "leaving"


@dataclass(frozen=True)
class Open:
    """What the measurements do not determine."""

    quantity: Quantity
    why: str


@dataclass(frozen=True)
class Slope:
    """A slope along one axis, with the interval that holds it with 90 %."""

    value: float
    """Per year or per degC, in the unit of the drift."""
    low: float
    """End of the interval, same unit."""
    high: float
    """End of the interval, same unit."""


@dataclass(frozen=True)
class Leaving:
    """When a bias leaves its limit; None: not within ten years from the last measurement."""

    earliest: float | None
    """With 90 % it leaves between here and `latest`, s since 1970."""
    middle: float | None
    """As likely before as after, s since 1970."""
    latest: float | None
    """End of that interval, s since 1970."""


@dataclass(frozen=True)
class Trend:
    """Drift along the sensor's axes, in the unit of the bias. None: not determined; `open` has the reasons."""

    n: int
    """Measurements that it rests on."""
    per_year: tuple[Slope, Slope, Slope] | None
    per_degc: tuple[Slope, Slope, Slope] | None
    leaving: Leaving | None
    open: tuple[Open, ...] = ()


def bias_trend(observations: Sequence[BiasObservation], limit: float) -> Trend:
    """Trend of one sensor; `limit` is the largest allowed distance of its bias from the correction in force."""
    seen = _chosen(observations)
    n = len(seen)
    warm, left_open = _temperature(seen)
    unknowns = 3 if warm else 2
    short = _too_few(seen, unknowns)
    if short:
        quantities = dict.fromkeys((Quantity.TIME, *(o.quantity for o in left_open), Quantity.LEAVING))
        if warm:
            quantities[Quantity.TEMPERATURE] = None
        reasons = {o.quantity: o.why for o in left_open}
        return Trend(n, None, None, None, tuple(Open(q, reasons.get(q, short)) for q in quantities))
    applied = [o for o in seen if o.applied]
    reference = applied[-1] if applied else seen[-1]
    days = np.array([o.at for o in seen]) / DAY_S
    warmth = np.array([o.temperature for o in seen], float) - (reference.temperature or 0.0) if warm else None
    sd = np.array([float(np.sqrt(np.mean(np.square(o.sd)))) for o in seen])
    bias = np.array([o.bias for o in seen])
    rng = np.random.default_rng(_SEED)  # the same measurements give the same digits
    measured = Measured(days, bias, sd, warmth)
    drawn = {belief: draw(measured, belief, rng, _DRAWS) for belief in Belief}
    wide = drawn[Belief.ANY]
    per_degc = None if wide.per_degc is None else _slopes(wide.per_degc)
    leaving = None
    if applied:
        away = [_days_ahead(found, np.array(reference.bias), limit) for found in drawn.values()]
        leaving = _leaving(away, seen[-1].at)
    else:
        left_open = (*left_open, Open(Quantity.LEAVING, "No calibration is in force whose limit it could leave."))
    return Trend(n, _slopes(wide.per_day * YEAR_D), per_degc, leaving, left_open)


def _chosen(observations: Sequence[BiasObservation]) -> list[BiasObservation]:
    """At most :data:`MOST` observations, in the order of time."""
    ordered = sorted(observations, key=lambda o: o.at)
    kept = [o for o in ordered if o.applied][-MOST:]
    others = [o for o in ordered if not o.applied]
    room = MOST - len(kept)
    return sorted([*kept, *others[len(others) - min(room, len(others)) :]], key=lambda o: o.at)


def _temperature(seen: Sequence[BiasObservation]) -> tuple[bool, tuple[Open, ...]]:
    """Whether a slope with temperature is among the unknowns; else why not."""
    known = [o.temperature for o in seen if o.temperature is not None]
    if len(known) < len(seen):
        missing = len(seen) - len(known)
        why = f"The temperature of {missing} of {len(seen)} measurements is not known."
        return False, (Open(Quantity.TEMPERATURE, why),)
    if not known or max(known) - min(known) < LEAST_SPREAD_DEGC:
        spread = max(known) - min(known) if known else 0.0
        measured = f"{len(seen)} measurements within {spread:.1f} degC determine"
        measured = "1 measurement determines" if len(seen) == 1 else measured
        why = f"{measured} no slope with temperature: measure at one that is {LEAST_SPREAD_DEGC:.0f} degC away."
        return False, (Open(Quantity.TEMPERATURE, why),)
    if len(seen) > 3 and _goes_with_time(seen, known):  # fewer determine no slope whatever they are
        why = f"In {len(seen)} measurements temperature went evenly with time, so that nothing tells the two apart."
        return False, (Open(Quantity.TEMPERATURE, why),)
    return True, ()


def _goes_with_time(seen: Sequence[BiasObservation], warmth: Sequence[float]) -> bool:
    """Whether temperature and time cannot be separated."""
    days = np.array([o.at for o in seen]) / DAY_S
    line = np.stack([np.ones(len(days)), days - days.mean()], axis=1)
    known = np.array(warmth)
    left = known - line @ np.linalg.lstsq(line, known, rcond=None)[0]
    return bool(np.ptp(left) < _APART * np.ptp(known))


def _too_few(seen: Sequence[BiasObservation], unknowns: int) -> str:
    """Why the measurements determine no drift with an uncertainty; empty: they do."""
    if len(seen) <= unknowns:
        lacking = unknowns + 1 - len(seen)
        what = "drift and slope with temperature" if unknowns == 3 else "drift"
        have = f"{len(seen)} measurement{'' if len(seen) == 1 else 's'}"
        return f"{have} determine{'s' if len(seen) == 1 else ''} no {what} with an uncertainty: {lacking} more needed."
    span = (seen[-1].at - seen[0].at) / DAY_S
    if span < LEAST_SPAN_D:
        return f"The measurements lie within {24.0 * span:.1f} h, which determines no drift."
    return ""


def _slopes(drawn: Array) -> tuple[Slope, Slope, Slope]:
    tail = 0.5 * (1.0 - COVERAGE)
    low, middle, high = np.quantile(drawn, [tail, 0.5, 1.0 - tail], axis=0)
    x, y, z = (Slope(float(m), float(a), float(b)) for m, a, b in zip(middle, low, high, strict=True))
    return x, y, z


@cache
def _paths() -> Array:
    """Random walks of variance one per day, one an extrapolated draw, (3, 400, days); the same for every sensor."""
    steps = np.random.default_rng(_SEED + 1).standard_normal((_PATHS, len(_AHEAD_D) - 1, 3))
    walked = np.cumsum(np.sqrt(np.diff(_AHEAD_D))[:, None] * steps, axis=1)
    whole = np.concatenate([np.zeros((_PATHS, 1, 3)), walked], axis=1)
    return np.ascontiguousarray(np.moveaxis(whole, 2, 0))


def _days_ahead(drawn: Draws, corrected: Array, limit: float) -> Array:
    """Days from the last measurement until each extrapolated draw exceeds the limit, ascending; inf: never."""
    walk, drift = np.sqrt(drawn.walk[:_PATHS])[:, None], drawn.per_day[:_PATHS]
    off = drawn.now[:_PATHS] - corrected
    squared = np.zeros((len(off), len(_AHEAD_D)))
    for axis, walked in enumerate(_paths()):
        squared += (walk * walked + _AHEAD_D * drift[:, axis, None] + off[:, axis, None]) ** 2
    beyond = squared > limit**2
    after = beyond.argmax(axis=1)
    before = np.maximum(after - 1, 0)
    each = np.arange(len(after))
    near, far = np.sqrt(squared[each, before]), np.sqrt(squared[each, after])
    part = np.divide(limit - near, far - near, out=np.zeros_like(near), where=(after > 0) & (far > near))
    left = _AHEAD_D[before] + part * (_AHEAD_D[after] - _AHEAD_D[before])
    return np.sort(np.where(beyond.any(axis=1), left, np.inf))


def _leaving(away: Sequence[Array], last: float) -> Leaving:
    """Hull of the 90 % intervals under both beliefs, and the median of all draws."""
    tail = 0.5 * (1.0 - COVERAGE)
    earliest = min(_at(days, tail) for days in away)
    latest = max(_at(days, 1.0 - tail) for days in away)
    middle = _at(np.sort(np.concatenate(away)), 0.5)
    first, between, end = (float(last + d * DAY_S) if np.isfinite(d) else None for d in (earliest, middle, latest))
    return Leaving(first, between, end)


def _at(ordered: Array, share: float) -> float:
    """The quantile, without interpolation since some values are infinite."""
    return float(ordered[round(share * (len(ordered) - 1))])


class Belief(StrEnum):
    """Prior of the drift."""

    ANY = "any"  # every drift is as likely as every other one
    SOME = "some"  # it has a typical size, and nothing is known about it


@dataclass(frozen=True, eq=False)
class Draws:
    """Joint posterior draws; arrays have shape (draws,) or (draws, 3)."""

    now: Array
    """The lasting part of the bias at the last measurement and the reference temperature, shape (draws, 3)."""
    per_day: Array
    """Its drift, shape (draws, 3)."""
    per_degc: Array | None
    """Its slope with temperature, shape (draws, 3); None: not among the unknowns."""
    walk: Array
    """Variance of the random walk over one day, shape (draws,)."""


@dataclass(frozen=True, eq=False)
class Measured:
    """Measurements of one sensor in order of time, at more than one time, and more than there are unknowns."""

    days: Array
    """Time of each measurement, days since 1970, shape (n,)."""
    bias: Array
    """Shape (n, 3)."""
    sd: Array
    """Standard deviation of one axis, shape (n,)."""
    warmth: Array | None
    """Temperature above the reference one, degC, shape (n,); None: it is left out."""


def draw(seen: Measured, belief: Belief, rng: np.random.Generator, count: int) -> Draws:
    """Posterior draws of the drift, given the measurements."""
    days, bias, sd, warmth = seen.days, seen.bias, seen.sd, seen.warmth
    span = float(days[-1] - days[0])
    columns = [np.ones(len(days)), (days - days[-1]) / span]
    if warmth is not None:
        columns.append(warmth / 10.0)
    design = np.stack(columns, axis=1)
    gap = span / (len(days) - 1)
    walks = np.minimum(days[:, None], days) - days[0]
    size, change = _scales(design, bias, sd)
    noise = np.maximum(sd, LEAST_NOISE * size) ** 2
    shares, sizes = (grid.ravel() for grid in np.meshgrid(SHARES, SIZES * size, indexing="ij"))
    shaped = shares[:, None, None] * walks / gap + (1.0 - shares)[:, None, None] * np.eye(len(days))
    covariance = sizes[:, None, None] ** 2 * shaped + np.diag(noise)
    solved = np.linalg.inv(covariance)
    drifts = np.geomspace(LEAST_DRIFT * size, MOST_DRIFT * max(change, size), DRIFTS)
    precisions = np.zeros(1) if belief is Belief.ANY else drifts**-2.0
    weight, best, spread = _lines(design, bias - bias[-1], covariance, solved, precisions)
    drawn = rng.choice(weight.size, size=count, p=weight.ravel() / weight.sum())
    cell = drawn // len(precisions)
    factor = np.linalg.cholesky(spread).reshape(-1, *spread.shape[2:])[drawn]
    unknown = best.reshape(-1, *best.shape[2:])[drawn] + factor @ rng.standard_normal((count, design.shape[1], 3))
    unknown[:, 0] += bias[-1]
    # the walk at the last measurement, given the line
    power = sizes**2 * shares / gap
    towards = power[:, None] * walks[:, -1]
    gain = np.einsum("ci,cij->cj", towards, solved)
    rest = np.sqrt(np.clip(power * walks[-1, -1] - np.einsum("ci,ci->c", gain, towards), 0.0, None))
    walked = (gain @ bias)[cell] - np.einsum("dk,dka->da", (gain @ design)[cell], unknown)
    walked += rest[cell, None] * rng.standard_normal((count, 3))
    per_degc = None if warmth is None else unknown[:, 2] / 10.0
    return Draws(unknown[:, 0] + walked, unknown[:, 1] / span, per_degc, power[cell])


def _lines(
    design: Array, bias: Array, covariance: Array, solved: Array, precisions: Array
) -> tuple[Array, Array, Array]:
    """Weight of every grid cell and every precision of the drift's prior, with the line's mean and covariance."""
    prior = np.zeros((len(precisions), design.shape[1], design.shape[1]))
    prior[:, 1, 1] = precisions
    information = (design.T @ solved @ design)[:, None] + prior
    spread = np.linalg.inv(information)
    spread = 0.5 * (spread + np.swapaxes(spread, -1, -2))
    towards = (design.T @ solved @ bias)[:, None]
    best = spread @ towards
    misfit = np.einsum("ia,cij,ja->c", bias, solved, bias)[:, None] - np.einsum("cdua,cdua->cd", best, towards)
    scatter = _logdet(covariance)[:, None] + _logdet(information) - np.log(np.where(precisions > 0.0, precisions, 1.0))
    lean = np.log(np.repeat(LEAN, len(SIZES)))[:, None]
    log_weight = lean - 0.5 * (3.0 * scatter + misfit)
    weight: Array = np.exp(log_weight - log_weight.max())
    return weight, best, np.asarray(spread, dtype=np.float64)


def _scales(design: Array, bias: Array, sd: Array) -> tuple[float, float]:
    """Standard deviation about a plain line, or of the measurements if larger; and the line's change over the span."""
    line = np.linalg.lstsq(design, bias, rcond=None)[0]
    free = max(3 * (len(bias) - design.shape[1]), 1)
    found = max(float(np.sqrt(((bias - design @ line) ** 2).sum() / free)), float(np.median(sd)), 1e-12)
    return found, float(np.linalg.norm(line[1]))


def _logdet(matrices: Array) -> Array:
    return np.asarray(np.linalg.slogdet(matrices)[1], dtype=np.float64)
