"""Motion blur of a compass whose output is the mean over a time window (ArduPilot: 100 ms at 10 Hz).

While the body turns, the field turns in it the other way, and its mean over the window is shorter than the field. With
``phi(t)`` the angle turned, up to terms of the fourth order only the scatter of that angle within the window counts:

    mean = (I + (C - tr(C) I)/2) field,    C = mean of (phi - mean phi)(phi - mean phi)^T over the window

so a turn that stops half-way blurs less than its mean square rate says. A steady turn at w has ``C = w w^T tau^2/12``,
and exactly ``mean = field sinc(|w| tau/2)`` across the axis; this also scales the rest. The offset does not turn.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.mag.samples import CHUNK
from mavcal.calib.triad import Array, TriadModel

if TYPE_CHECKING:
    from scipy.interpolate import CubicHermiteSpline


CORRECTABLE = 0.02
"""Largest shrinkage whose blur is corrected; beyond (7 rad/s at 100 ms) the angle within the window is not known well
enough."""

_AS_STATED = math.radians(10.0)
"""Angle within which axes count as stated: it mixes the blur of two axes by a sixth, and blur is small."""

_KNOWN_TO = 0.1  # rad, standard deviation up to which the axes found are believed
_EXPLAINED = 0.3  # of the change of the field, rms, that the turn may leave
_LEAST = 10  # changes of the field
_INSTANTS = 16  # of the window whose angles are looked at: the scatter is short of the integral by 1/16^2, added below
_STEP = 0.005  # s by which the window is moved to see what a time lag does


@dataclass(frozen=True, eq=False)
class Rates:
    """Rotation of the body during the window of every magnetometer sample.

    Parameters
    ----------
    ends : shape (N,)
        When each window ends, s.
    turn : shape (N, 3)
        Angle that was turned during the window, rad.
    scatter : shape (N, 3, 3)
        C of the module's equation, rad^2; 0 where not known.
    drift : shape (N, 3, 3)
        Increase of C per second of delay of the compass's time stamps, rad^2/s.
    known : shape (N,)
        Whether the gyro covers the window.
    window
        Length of the window, s.
    interval
        Interval of the gyro samples, s, whose messages also carry the compass.
    """

    ends: Array
    turn: Array
    scatter: Array
    drift: Array
    known: NDArray[np.bool_]
    window: float
    interval: float = 0.0

    def shrinkage(self) -> Array:
        """Shortening of a field perpendicular to the axis of rotation, (N,): 0.01 is one percent."""
        return _shrinkage(self.scatter)

    def sharp(self, limit: float = CORRECTABLE) -> NDArray[np.bool_]:
        """The samples (N,) whose blur is known and at most `limit`."""
        return self.known & (self.shrinkage() <= limit)

    def take(self, rows: NDArray[np.bool_] | NDArray[np.intp] | slice) -> Rates:
        """The rates of the samples `rows`."""
        return Rates(
            self.ends[rows],
            self.turn[rows],
            self.scatter[rows],
            self.drift[rows],
            self.known[rows],
            self.window,
            self.interval,
        )

    def turned(self, rotation: Array) -> Rates:
        """The same in axes that `rotation` (3, 3) leads to."""
        return dataclasses.replace(
            self,
            turn=self.turn @ rotation.T,
            scatter=rotation @ self.scatter @ rotation.T,
            drift=rotation @ self.drift @ rotation.T,
        )

    def adjusted(self, gain: float, lag: float, axes: Array) -> Rates:
        """The blur, stronger by the fraction `gain`, with time stamps late by `lag` (s), and another gyroscope.

        What it calls phi is then `axes` (3, 3) times that.
        """
        late = dataclasses.replace(self, scatter=(1.0 + gain) * (self.scatter + lag * self.drift))
        return late.turned(axes)

    def followed_by(self, *others: Rates) -> Rates:
        """These rates followed by `others`."""
        parts = (self, *others)
        return Rates(
            np.concatenate([p.ends for p in parts]),
            np.concatenate([p.turn for p in parts]),
            np.concatenate([p.scatter for p in parts]),
            np.concatenate([p.drift for p in parts]),
            np.concatenate([p.known for p in parts]),
            self.window,
            self.interval,
        )


def rates_during(t: ArrayLike, gyro_t: ArrayLike, gyro: ArrayLike, window: float) -> Rates:
    """Rotation of the body in the window that ends at each magnetometer sample.

    Parameters
    ----------
    t : shape (N,)
        Times of the magnetometer's samples, s.
    gyro_t : shape (M,)
        Times of the gyro's samples on the same clock, increasing.
    gyro : shape (M, 3)
        rad/s. A bias of 0.01 rad/s does not matter here.
    window
        Averaging window of the compass, s; 0: none.

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
    from scipy.interpolate import CubicHermiteSpline  # loads scipy.optimize: 14 MB that an idle service does without

    interval = float(np.median(np.diff(times)))
    known = _covered_by_gyro(ends, times, window, interval)
    if window == 0.0:
        nothing = np.zeros((len(ends), 3, 3))
        return Rates(ends, np.zeros((len(ends), 3)), nothing, nothing, known, 0.0, interval)
    steps = 0.5 * (rates[1:] + rates[:-1]) * np.diff(times)[:, None]
    angle = CubicHermiteSpline(times, np.vstack([np.zeros(3), np.cumsum(steps, axis=0)]), rates)

    ahead, here, behind = _scatters(angle, ends, window, (times[0], times[-1]))
    turn = angle(np.clip(ends, times[0], times[-1])) - angle(np.clip(ends - window, times[0], times[-1]))
    drift = (ahead - behind) / (2.0 * _STEP)
    for array in (turn, here, drift):
        array[~known] = 0.0
    return Rates(ends, turn, here, drift, known, window, interval)


def _scatters(
    angle: CubicHermiteSpline, ends: Array, window: float, span: tuple[float, float]
) -> tuple[Array, Array, Array]:
    """C (N, 3, 3) over the windows that end at `ends`, for stamps late by _STEP, on time, and early by it.

    Beyond the gyro's samples the body is assumed at rest.
    """
    instants = (np.arange(_INSTANTS) + 0.5) / _INSTANTS * window
    found = np.empty((3, len(ends), 3, 3))
    for k, late in enumerate((_STEP, 0.0, -_STEP)):
        for start in range(0, len(ends), CHUNK):
            rows = slice(start, start + CHUNK)
            phi = angle(np.clip(ends[rows, None] - late - instants, *span))
            phi -= phi.mean(axis=1, keepdims=True)
            found[k, rows] = np.transpose(phi, (0, 2, 1)) @ phi
    found /= _INSTANTS * (1.0 - _INSTANTS**-2.0)
    return found[0], found[1], found[2]


def _covered_by_gyro(ends: Array, times: Array, window: float, interval: float) -> NDArray[np.bool_]:
    """Whether the gyro covers the window before every one of `ends` without a gap."""
    slack = 1.5 * interval
    inside = (ends - window >= times[0] - slack) & (ends <= times[-1] + slack)
    longest = max(2.0 * window, 0.2, 3.0 * interval) if window == 0.0 else max(1.5 * window, 3.0 * interval)
    gaps = np.flatnonzero(np.diff(times) > longest)
    # The gaps are apart: a window touches one if one begins before its end and that one ends after its start.
    if not len(gaps):
        return np.asarray(inside)
    before = np.searchsorted(times[gaps], ends) - 1
    return np.asarray(inside & ~((before >= 0) & (times[gaps[before] + 1] > ends - window)))


def _shrinkage(scatter: Array) -> Array:
    angle = np.sqrt(12.0 * np.clip(np.trace(scatter, axis1=1, axis2=2), 0.0, None))
    return np.asarray(1.0 - np.sinc(angle / (2.0 * np.pi)))


def deblurred(samples: ArrayLike, rates: Rates, model: TriadModel) -> Array:
    """`samples` (N, 3) as they would read without motion, given a `model` of the sensor up to a common scale.

    ``y = b + S u`` with u the field, hence ``S^-1 (mean - b) = (I + g (C - tr(C) I)) u``. The rates are in the axes of
    the corrected field.
    """
    array = np.asarray(samples, dtype=np.float64)
    total = np.trace(rates.scatter, axis1=1, axis2=2)
    g = _shrinkage(rates.scatter) / np.where(total > 1e-12, total, 1.0)
    shrink = np.eye(3) + g[:, None, None] * (rates.scatter - total[:, None, None] * np.eye(3))
    blurred = model.apply(array)
    return model.invert(np.linalg.solve(shrink, blurred[:, :, None])[:, :, 0])


def axes_of_gyro(directions: Array, rates: Rates) -> Array:
    """Rotation (3, 3) from gyro to compass axes; the unit matrix where the data agree with the stated mounting.

    From sample to sample the field turns by ``du = u x (R phi)``, which is linear in R.

    Parameters
    ----------
    directions : shape (N, 3)
        Of the field in the compass's axes, of about unit length.
    rates
        Of the same N samples.
    """
    if len(directions) < _LEAST + 2:
        return np.eye(3)
    apart = rates.ends[2:] - rates.ends[:-2]
    near = (apart > 0.0) & (apart <= 3.0 * rates.window)
    if np.count_nonzero(near) < _LEAST:
        return np.eye(3)
    change = ((directions[2:] - directions[:-2]) * (rates.window / np.where(near, apart, 1.0))[:, None])[near]
    u, phi = directions[1:-1][near], rates.turn[1:-1][near]
    cross = np.zeros((len(u), 3, 3))
    cross[:, 0, 1], cross[:, 0, 2], cross[:, 1, 2] = -u[:, 2], u[:, 1], -u[:, 0]
    cross -= np.transpose(cross, (0, 2, 1))
    design = (cross[:, :, :, None] * phi[:, None, None, :]).reshape(-1, 9)
    normal = design.T @ design
    if not np.linalg.eigvalsh(normal)[0] > 1e-9 * max(float(np.trace(normal)), 1e-300):
        return np.eye(3)
    general = np.linalg.solve(normal, design.T @ change.ravel())
    left, _, right = np.linalg.svd(general.reshape(3, 3))
    rotation = left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right
    misfit = change.ravel() - design @ rotation.ravel()
    variance = float(misfit @ misfit) / len(misfit)
    known = math.sqrt(variance / float(np.linalg.eigvalsh(normal)[0])) < _KNOWN_TO
    explained = variance < _EXPLAINED**2 * float(np.mean(change**2))
    angle = math.acos(min(1.0, max(-1.0, 0.5 * (float(np.trace(rotation)) - 1.0))))
    return np.asarray(rotation) if known and explained and angle > _AS_STATED else np.eye(3)
