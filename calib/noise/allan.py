"""Allan variance of a sensor at rest: white noise N, bias instability B, rate random walk K, each with its sd.

The averaging time is ``tau = m/rate``. There the overlapping Allan variance is the mean of
``(x_{i+2m} - 2 x_{i+m} + x_i)^2 / (2 tau^2)`` over the integrated samples x; see IEEE 952, annex C. Three noises of
known spectrum add in it,

``avar(tau) = N^2/tau + (2 ln 2/pi) B^2 + K^2 tau/3``.

The estimates at different tau are correlated. Their covariance follows from the spectrum, ``cov = 2/n int |H_m|^2
|H_m'|^2 S^2`` (the fourth moment of Gaussian noise). Generalised least squares therefore gives N, B and K with a valid
sd. The usual readings, N at tau = 1, B at the minimum and K at tau = 3, are reported beside it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

from mavcal.calib.errors import InvalidInputError

Array = NDArray[np.float64]

FLICKER = 2.0 * np.log(2.0) / np.pi
"""Allan variance of bias instability B = 1: the flat part lies at 0.664 B."""
TERMS = ("N", "B", "K")
"""White noise (unit/sqrt(Hz)), bias instability (unit), rate random walk (unit/sqrt(s)); N^2 is a two-sided density."""

_CHUNK = 16_384  # samples worked on while they are in the cache
_LONGEST = 6  # the longest averaging time is this part of the recording
_FREQUENCIES = 12_000
MISFIT = 0.01
"""P-value below which a record contradicts the model."""
_DEPARTURE = 0.08  # of the deviation: a shortest averaging time that lies farther from the others' model is left out
_MODEL_ERROR = 0.05  # of the variance: no sensor is these three noises exactly
_LEAST_TAUS = 4
_ROUNDS = 4
_SHARE = 0.5  # a slope holds where its noise is more than this part of the variance
_KNOWN = 2.0  # a noise whose variance is less than this many of its own sd is not told from none


@dataclass(frozen=True, eq=False)
class AllanTable:
    """Averaging times in samples and in seconds, and the Allan deviation there."""

    m: NDArray[np.intp]
    tau: Array
    adev: Array
    terms: NDArray[np.intp]
    """Number of second differences in the mean."""


@dataclass(frozen=True, eq=False)
class AllanFit:
    """N, B and K with their covariance, and where the data follow them.

    A term indistinguishable from zero has the value 0, and its upper bound in `upper`.
    """

    values: Array  # (3,)
    sd: Array  # (3,) nan where not told from zero
    upper: Array  # (3,) 95 % bound
    covariance: Array  # (3, 3) of the squares N^2, B^2, K^2
    used: NDArray[np.bool_]  # which averaging times follow the model
    model: Array  # Allan deviation that the fit predicts, at every tau
    relative_sd: Array  # of the measured Allan deviation, at every tau
    chi2: float
    dof: int
    p_value: float | None
    residuals: Array  # of the used ones, whitened, with what the model may be off
    condition: float


def octaves(n: int) -> NDArray[np.intp]:
    """Averaging times in samples, in octaves up to a sixth of `n`."""
    if n < 2 * _LONGEST:
        return np.zeros(0, dtype=np.intp)
    top = np.log2(n / _LONGEST)
    return np.unique(np.round(2.0 ** np.arange(0.0, top + 1e-9)).astype(np.intp))


def overlapping_deviation(y: Array, rate: float, m: NDArray[np.intp]) -> AllanTable:
    """Overlapping Allan deviation of the samples `y` (N,), taken at `rate` (Hz), at `m` samples of averaging.

    Raises
    ------
    InvalidInputError
        If a sample is not finite, or there are fewer than two averaging times in the record.
    """
    y = np.asarray(y, dtype=np.float64)
    if not np.isfinite(y).all() or not rate > 0.0:
        raise InvalidInputError(
            f"{int((~np.isfinite(y)).sum())} of {len(y)} samples are not finite, rate {rate} Hz: the Allan variance "
            "needs a gapless series at a known rate"
        )
    m = np.asarray(m, dtype=np.intp)
    if len(m) and not (m[0] >= 1 and 2 * m[-1] <= len(y)):
        raise InvalidInputError(f"averaging over {m[0]} to {m[-1]} samples needs {2 * m[-1]} samples, not {len(y)}")
    x = np.empty(len(y) + 1)
    x[0] = 0.0
    np.cumsum(y - y.mean(), out=x[1:])
    buffer = np.empty(_CHUNK)
    squares = np.array([_second_differences(x, int(k), buffer) for k in m])
    terms = len(x) - 2 * m
    return AllanTable(m, m / rate, np.sqrt(squares / (2.0 * terms)) / m, terms)


def _second_differences(x: Array, m: int, buffer: Array) -> float:
    """Sum of ``(x_{i+2m} - 2 x_{i+m} + x_i)^2``."""
    total = 0.0
    n = len(x) - 2 * m
    for i in range(0, n, _CHUNK):
        j = min(i + _CHUNK, n)
        d = buffer[: j - i]
        np.add(x[i:j], x[i + 2 * m : j + 2 * m], out=d)
        d -= x[i + m : j + m]
        d -= x[i + m : j + m]
        total += float(d @ d)
    return total


def fit_noise(table: AllanTable, n: int) -> AllanFit:
    """N, B and K of the model by generalised least squares on the Allan variances.

    Averaging times at the short end may not follow the model: a low-pass filter, coarse quantisation or vibration. They
    are left out one after the other, as long as the whole contradicts the model.

    Parameters
    ----------
    table
        At least four averaging times.
    n : int
        Samples of the record.
    """
    if len(table.m) < _LEAST_TAUS:
        raise InvalidInputError(
            f"{len(table.m)} averaging times from {n} samples: {_LEAST_TAUS} or more are needed; record longer"
        )
    spectrum = _Spectrum.of(table)
    best = _fit_from(table, spectrum, 0)
    for first in range(1, 1 + min(len(table.m) // 2, len(table.m) - _LEAST_TAUS)):
        if (best.p_value or 0.0) > MISFIT:
            break
        found = _fit_from(table, spectrum, first)
        departs = abs(table.adev[first - 1] / found.model[first - 1] - 1.0) > _DEPARTURE
        if departs and (found.p_value or 0.0) > (best.p_value or 0.0):  # else the misfit lies elsewhere
            best = found
    start = int(np.flatnonzero(best.used)[0])
    filtered = start > 0 and table.adev[start - 1] < best.model[start - 1]
    if filtered and len(table.m) - start > _LEAST_TAUS:  # the knee of a filter looks like a flat part
        best = _fit_from(table, spectrum, start + 1)
    return best


@dataclass(frozen=True, eq=False)
class _Spectrum:
    """Transfer functions of the averaging times at sampled frequencies, and the three spectra there."""

    gain: Array  # (taus, F) |H|^2
    spectra: Array  # (3, F) of one unit of N^2, B^2, K^2
    weight: Array  # (F,) width of each frequency's cell, both sides
    terms: Array

    @classmethod
    def of(cls, table: AllanTable) -> _Spectrum:
        rate = table.m[0] / table.tau[0]
        edges = np.geomspace(0.02 / table.m[-1], 0.5, _FREQUENCIES + 1)
        place = (np.arange(_FREQUENCIES) * 0.6180339887498949) % 1.0  # spread evenly: no lobe is met again and again
        f = edges[:-1] + place * np.diff(edges)
        gain = 2.0 * np.sin(np.pi * f * table.m[:, None]) ** 4 / (table.m[:, None] * np.sin(np.pi * f)) ** 2
        hertz = f * rate
        spectra = rate * np.vstack([np.ones_like(f), 1.0 / (2.0 * np.pi * hertz), 1.0 / (2.0 * np.pi * hertz) ** 2])
        return cls(gain, spectra, 2.0 * np.diff(edges), table.terms.astype(np.float64))

    def covariance(self, squares: Array) -> Array:
        """Covariance of the Allan variances under N^2, B^2, K^2; the shorter mean of a pair counts."""
        density = np.maximum(squares, 0.0) @ self.spectra
        product = (self.gain * (self.weight * density**2)) @ self.gain.T
        pairs = np.maximum(self.terms[:, None], self.terms)
        return np.asarray(2.0 * product / pairs, dtype=np.float64)


def _fit_from(table: AllanTable, spectrum: _Spectrum, first: int) -> AllanFit:
    design = np.column_stack([1.0 / table.tau, np.full(len(table.tau), FLICKER), table.tau / 3.0])
    avar = table.adev**2
    used = np.arange(len(avar)) >= first
    squares, covariance = _start(design[used], avar[used]), np.eye(3)
    spread = np.eye(len(avar))
    for _ in range(_ROUNDS):
        spread = spectrum.covariance(squares)
        modelled = design @ squares
        inner = spread[np.ix_(used, used)] + 1e-6 * np.diag(modelled[used] ** 2)
        squares, covariance = _bounded(design[used], avar[used], inner)
    modelled = design @ squares
    tolerant = inner + np.diag((_MODEL_ERROR * modelled[used]) ** 2)
    whitened = np.linalg.solve(np.linalg.cholesky(tolerant), avar[used] - modelled[used])
    free = int((squares > 0.0).sum())
    dof = int(used.sum()) - free
    chi2 = float(whitened @ whitened)
    half = np.linalg.cholesky(inner)
    strict = np.linalg.solve(half, avar[used] - modelled[used])
    covariance = covariance * max(1.0, float(strict @ strict) / max(dof, 1))
    scaled = np.linalg.solve(half, design[used])
    return _noise_fit(
        squares,
        covariance,
        used=used,
        model=np.sqrt(modelled),
        relative_sd=0.5 * np.sqrt(np.diag(spread)) / modelled,
        chi2=chi2,
        dof=dof,
        p_value=float(chdtrc(dof, chi2)) if dof > 0 else None,
        residuals=whitened,
        condition=float(np.linalg.cond(scaled / np.linalg.norm(scaled, axis=0))),
    )


def _noise_fit(squares: Array, covariance: Array, **facts: object) -> AllanFit:
    error = np.sqrt(np.diag(covariance))
    determined = squares > _KNOWN * error
    values = np.sqrt(np.where(determined, squares, 0.0))
    sd = np.where(determined, error / (2.0 * np.where(determined, values, 1.0)), np.nan)
    upper = np.sqrt(np.maximum(squares, 0.0) + 1.645 * error)
    return AllanFit(values=values, sd=sd, upper=upper, covariance=covariance, **facts)  # type: ignore[arg-type]


def _start(design: Array, avar: Array) -> Array:
    """Start values by least squares with equal relative weights, right within a small factor."""
    return _bounded(design, avar, np.diag(avar**2))[0]


def _bounded(design: Array, avar: Array, covariance: Array) -> tuple[Array, Array]:
    """Non-negative least squares over all sets of terms; the covariance is that of all three."""
    half = np.linalg.cholesky(covariance)
    A, y = np.linalg.solve(half, design), np.linalg.solve(half, avar)
    size = np.linalg.norm(A, axis=0)
    A = A / size
    best, best_cost = np.zeros(3), np.inf
    for chosen in ([0, 1, 2], [0, 1], [0, 2], [1, 2], [0], [1], [2]):
        solution = np.linalg.lstsq(A[:, chosen], y, rcond=None)[0]
        cost = float(((y - A[:, chosen] @ solution) ** 2).sum())
        if (solution > 0.0).all() and cost < best_cost:
            best = np.zeros(3)
            best[chosen] = solution
            best_cost = cost
    information = A.T @ A + 1e-12 * np.eye(3)
    return best / size, np.linalg.inv(information) / np.outer(size, size)
