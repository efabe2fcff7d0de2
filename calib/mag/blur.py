"""Motion blur of a compass whose output is the mean over a time window (ArduPilot: 100 ms at 10 Hz).

While the body turns at w the field turns in it at -w, and its mean over a window tau is shorter: the part that is
perpendicular to w shrinks by ``sinc(|w| tau/2) = 1 - (w tau)^2/24 + ...``. With ``W = w w^T - |w|^2 I``,
``mean = (I + g W) field`` and ``g = (1 - sinc(|w| tau/2))/|w|^2``. The offset of the sensor does not turn.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Unpack

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calib.errors import InvalidInputError
from calib.fit import FitResult, FitStatus
from calib.mag.ellipsoid import fit_ellipsoid
from calib.mag.result import MagFacts
from calib.mag.shape import MagModel
from calib.triad import TriadModel

Array = NDArray[np.float64]

CORRECTABLE = 0.02
"""Shrinkage up to which blur is computed back; beyond (7 rad/s at 100 ms) the rate within the window is not known well
enough."""

_KNOWN_TO = 0.03
"""Error of the blur that is computed back, relative: window and gyro are known to some milliseconds."""

_ROUNDS = 2  # the model that the correction needs is itself better after one


@dataclass(frozen=True, eq=False)
class Rates:
    """How the body turned during the window of every magnetometer sample.

    Parameters
    ----------
    squares : shape (N, 3, 3)
        Mean of ``w w^T`` over the window, (rad/s)^2; 0 where not known.
    known : shape (N,)
        Whether the gyro covers the window.
    window
        Length of the window, s.
    """

    squares: Array
    known: NDArray[np.bool_]
    window: float

    def shrinkage(self) -> Array:
        """How much shorter a field perpendicular to the axis of rotation reads, (N,): 0.01 is one percent."""
        speed = np.sqrt(np.trace(self.squares, axis1=1, axis2=2))
        return np.asarray(1.0 - np.sinc(speed * self.window / (2.0 * np.pi)))

    def sharp(self, limit: float = CORRECTABLE) -> NDArray[np.bool_]:
        """The samples (N,) whose blur is known and at most `limit`."""
        return self.known & (self.shrinkage() <= limit)

    def take(self, rows: NDArray[np.bool_] | slice) -> Rates:
        """The rates of the samples `rows`."""
        return Rates(self.squares[rows], self.known[rows], self.window)


def rates_during(t: ArrayLike, gyro_t: ArrayLike, gyro: ArrayLike, window: float) -> Rates:
    """Rates of rotation over the window that ends at each magnetometer sample.

    Parameters
    ----------
    t : shape (N,)
        Times of the magnetometer's samples, s.
    gyro_t : shape (M,)
        Times of the gyro's samples on the same clock, increasing.
    gyro : shape (M, 3)
        rad/s. A bias of 0.1 rad/s is no matter here.
    window
        What the compass averages over, s; 0: it does not.

    Raises
    ------
    InvalidInputError
        If shapes do not match, or the gyro is not finite or its times do not increase.
    """
    ends = np.asarray(t, dtype=np.float64)
    times, rates = np.asarray(gyro_t, dtype=np.float64), np.asarray(gyro, dtype=np.float64)
    if rates.ndim != 2 or rates.shape != (len(times), 3) or len(times) < 2:
        raise InvalidInputError(f"gyro samples {rates.shape} do not match {len(times)} time stamps (two at least)")
    if not (np.isfinite(rates).all() and (np.diff(times) > 0.0).all()):
        raise InvalidInputError("the gyro must be finite and its time stamps increasing")
    if not window >= 0.0:
        raise InvalidInputError(f"a compass cannot average over {window} s")
    squares = (rates[:, :, None] * rates[:, None, :]).reshape(-1, 9)
    known = (ends >= times[0]) & (ends <= times[-1] + window) & _without_gap(ends, times, window)
    if window == 0.0:
        return Rates(np.zeros((len(ends), 3, 3)), known, 0.0)
    steps = 0.5 * (squares[1:] + squares[:-1]) * np.diff(times)[:, None]
    integral = np.vstack([np.zeros(9), np.cumsum(steps, axis=0)])
    late, early = np.clip(ends, times[0], times[-1]), np.clip(ends - window, times[0], times[-1])
    mean = np.empty((len(ends), 9))
    for k in range(9):
        mean[:, k] = np.interp(late, times, integral[:, k]) - np.interp(early, times, integral[:, k])
    mean /= np.maximum(late - early, 1e-9)[:, None]
    mean[~known] = 0.0
    return Rates(mean.reshape(-1, 3, 3), known, window)


def _without_gap(ends: Array, times: Array, window: float) -> NDArray[np.bool_]:
    """Whether a gyro sample lies within twice the window around every one of `ends`."""
    after = np.searchsorted(times, ends)
    before = np.clip(after - 1, 0, len(times) - 1)
    nearest = np.minimum(np.abs(times[before] - ends), np.abs(times[np.clip(after, 0, len(times) - 1)] - ends))
    return np.asarray(nearest <= max(2.0 * window, 0.2))


def deblurred(samples: ArrayLike, rates: Rates, model: TriadModel) -> Array:
    """`samples` (N, 3) as they would read without motion, given a `model` of the sensor up to a common scale.

    ``y = b + S u`` with u the field, hence ``S^-1 (mean - b) = (I + g W) u``.
    """
    array = np.asarray(samples, dtype=np.float64)
    speed2 = np.trace(rates.squares, axis1=1, axis2=2)
    g = rates.shrinkage() / np.maximum(speed2, 1e-12)
    shrink = np.eye(3) + g[:, None, None] * (rates.squares - speed2[:, None, None] * np.eye(3))
    blurred = model.apply(array)
    return model.invert(np.linalg.solve(shrink, blurred[:, :, None])[:, :, 0])


def fit_ellipsoid_deblurred(
    samples: ArrayLike,
    rates: Rates,
    *,
    model: str = MagModel.SYMMETRIC,
    robust: bool | None = None,
    prior_sd: float | None = None,
    **facts: Unpack[MagFacts],
) -> FitResult:
    """Fit the ellipsoid to samples whose motion blur is computed back; too fast ones are left out.

    Parameters
    ----------
    samples : shape (N, 3)
        In order of time.
    rates
        Of the same N samples.
    model, robust, prior_sd, **facts
        As for :func:`calib.mag.ellipsoid.fit_ellipsoid`. Three percent of the mean shrinkage is added to the error of
        the field strength.
    """
    array = np.asarray(samples, dtype=np.float64)
    if len(array) != len(rates.known):
        raise InvalidInputError(f"{len(array)} magnetometer samples, but rates of {len(rates.known)}")
    sharp = rates.sharp()
    kept, slow = array[sharp], rates.take(sharp)
    field = facts.get("field")
    if field is not None and len(kept):
        doubt = _KNOWN_TO * float(slow.shrinkage().mean()) * field.norm
        facts["field"] = dataclasses.replace(field, norm_sd=math.hypot(field.norm_sd, doubt))
    fit = fit_ellipsoid(kept, model=model, robust=robust, prior_sd=prior_sd, **facts)
    for _ in range(_ROUNDS):
        if fit.status == FitStatus.REFUSED:
            break
        sharp_samples = deblurred(kept, slow, fit.model)
        fit = fit_ellipsoid(sharp_samples, model=model, robust=robust, prior_sd=prior_sd, **facts)
    return fit
