"""Fit of the forward model to one flight, by Gauss-Newton steps in whitened cosine bins.

The residual is whitened by its own spectrum (Whittle): turbulence, estimator errors and sensor noise are learned, not
declared. The result is a :class:`FlightFit`, the log-likelihood about the best point.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct
from scipy.ndimage import binary_dilation, uniform_filter1d

from mavcal.calib.airframe.flown import REST_AGREES, FlownFlight
from mavcal.calib.airframe.geometry import arms
from mavcal.calib.airframe.gyro_noise import TORQUE_BAND_HZ, GyroNoise
from mavcal.calib.airframe.physics import TORQUE_ONLY, Airframe, Layout
from mavcal.calib.airframe.priors import ENDS, prior_of, step_of
from mavcal.calib.recording import Sensor

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

FORCE_BAND_HZ: Final = 10.0
"""Highest frequency, Hz, at which force is judged. Source: AIRFRAME 5.3, above lies vibration."""
SLOW_HZ: Final = 0.1
"""Frequency, Hz, below which torque is a trim and is judged over the whole flight; above, only during commanded turns.
Chosen, not measured: turns last a second or two."""
_USUAL_S: Final = 2.0
_EXCITED: Final = 8.0
"""Multiple of the usual change of the differential commands that is a commanded turn. Chosen, not measured: far beyond
the controller's reaction to gusts."""
_TURN_S: Final = 0.4
"""Time, s, added on either side of a commanded turn for the vehicle's response. Chosen, not measured."""
_ROUNDS, _WHITE_ROUNDS = 8, 4
"""Most rounds, and those with one variance per channel before its spectrum is learned."""
_SHORTEST: Final = 0.01
"""Fraction of a step below which the search along it stops."""
_NEAR: Final = 2.0
"""Distance from the best point, in standard errors, below which the spectrum is learned. Chosen, not measured."""
_CONVERGED: Final = 0.02
"""Change of the best point, in standard errors, below which the fit has converged."""
_WINDOW: Final = 0.15
"""Half width of the averaging of a spectrum, relative to the frequency. Chosen, not measured."""
_LEAST_BINS: Final = 8
_HEARD, _HEARD_HZ = 2.0, 2.0
"""Turns are judged where they exceed this multiple of the gyroscope's noise, and always below the second value, Hz. The
controller's response to noise looks like a reaction of the rotors. Chosen, not measured."""
_OCTAVES: Final = (0.3, 0.6, 1.2, 2.5, 5.0, 10.0)
"""Band edges, Hz, for the comparison of a residual with that noise. Source: octaves below `TORQUE_BAND_HZ`."""


@dataclass(frozen=True)
class Reference:
    """Relative error of the model in some columns of force and torque.

    One standard deviation of the model error is `right_to` of the size of `whole`. `answered` of the residual below
    `below_hz` is added: the controller's response to it may bias the parameters. `rows` selects :class:`_View` s.
    """

    columns: tuple[int, ...]
    whole: tuple[int, ...]
    right_to: float
    answered: float
    below_hz: float
    rows: tuple[int, ...] = (0, 1, 2)


REFERENCES: Final = (
    Reference((0, 1), (0, 1, 2), 0.002, 0.2, 2.0),
    Reference((2,), (0, 1, 2), 0.002, 0.48, SLOW_HZ, rows=(0,)),
    Reference((2,), (0, 1, 2), 0.002, 0.36, 2.0, rows=(1,)),
    Reference((3,), (3,), 0.006, 0.15, 50.0),
    Reference((4,), (4,), 0.006, 0.15, 50.0),
    Reference((5,), (5,), 0.009, 0.1, 50.0),
)
"""Force perpendicular to the axis; along it, below `SLOW_HZ` in the whole flight and above it in climbs; roll, pitch
and yaw. Errors of the estimator's climb rate are slow, so they do not affect climbs, which tell thrust from its curve.
Measured: gains of one simulator's flights spread by 0.3 %, and amplitudes of effects in 60 development nulls of other
physics in turbulence by 0.4 to 1.1 of their standard errors. Velocity and attitude loops respond to gusts below 2 Hz,
the rate loop to noise of turns up to 50 Hz."""
SAG_SPAN: Final = 0.03
"""Least relative change of the voltage for its effect on thrust to be fitted. Source: half of the 6 % that are needed
to name it (AIRFRAME 5.8)."""
UNSEEN_BIAS: Final = 0.1
"""Standard deviation of an accelerometer offset without a rest, m/s2. Source: residual of a six-face calibration
(PEERS)."""


@dataclass(frozen=True, eq=False)
class FlightFit:
    """Result of a fit: the best `theta` (P,), and the curvature (P, P) of the log-likelihood there, without the priors.

    `gradient` (P,) is that of the log-likelihood at `theta`. `spectra` are variances of the whitened bins; `residual`
    (N, 6) of force and torque, nan where it is not used. `free` (P,) are the parameters that were fitted. `trusted` (P,
    P) is the inverse covariance of the model's own errors (:meth:`FlightLikelihood.trusted`).
    """

    layout: Layout
    theta: Array
    curvature: Array
    gradient: Array
    free: Mask
    residual: Array
    spectra: tuple[Array, ...]
    trusted: Array
    loglik: float
    samples: int

    @cached_property
    def covariance(self) -> Array:
        """Covariance (P, P) of all parameters, with their priors."""
        prior = np.diag([1.0 / prior_of(n)[1] ** 2 for n in self.layout.names])
        return np.asarray(np.linalg.inv(self.curvature + prior))

    def value(self, name: str) -> float:
        """Best value of one parameter."""
        return float(self.theta[self.layout.place[name]])

    def sd(self, name: str) -> float:
        """Its standard error."""
        k = self.layout.place[name]
        return float(np.sqrt(self.covariance[k, k]))


@dataclass(frozen=True, eq=False)
class _View:
    """One column of force and torque, its rows (0 all, 1 lifts, 2 turns), and its cosine bins."""

    column: int
    rows: int
    picked: NDArray[np.intp]


def excited(flight: FlownFlight) -> tuple[Mask, Mask]:
    """Masks (N,) of commanded turns and of climbs, in which a controller in the loop biases least.

    Elsewhere commands respond to gusts: those that fight a gust would explain it away (AIRFRAME 5.4).
    """
    x, y, spin = arms(flight.geometry.motors)
    ways = [np.abs(_moving(flight, flight.c @ of_axis / len(x))) for of_axis in (x, y, spin, np.ones(len(x)))]
    rows = [w > _EXCITED * max(float(np.median(w[flight.usable])), 1e-4) for w in ways]
    width = max(int(_TURN_S * flight.fs), 1)
    turns, lifts = rows[0] | rows[1] | rows[2], rows[3]
    return tuple(np.asarray(binary_dilation(r, iterations=width)) for r in (turns, lifts))  # type: ignore[return-value]


def _moving(flight: FlownFlight, told: Array) -> Array:
    return np.asarray(told - uniform_filter1d(told, max(int(_USUAL_S * flight.fs), 1)))


class FlightLikelihood:
    """The whitened residual of one flight as a function of the parameters."""

    def __init__(self, airframe: Airframe, usable: Mask, *, torque: bool) -> None:
        self.airframe, self.usable = airframe, usable
        flight = airframe.flight
        n = len(flight.t)
        hz = np.asarray(np.arange(n) * flight.fs / (2.0 * n), dtype=np.float64)
        self.torque, self._hz = torque, hz
        turns, lifts = excited(flight)
        self.turns, self.lifts = usable & turns, usable & lifts
        self._rows = (usable, self.lifts, self.turns)
        low = hz <= self._highest(Sensor.ACCEL)
        self._views = [_View(0, 0, np.flatnonzero(low)), _View(1, 0, np.flatnonzero(low))]
        self._views += [_View(2, 1, np.flatnonzero(low & (hz >= SLOW_HZ))), _View(2, 0, np.flatnonzero(hz < SLOW_HZ))]
        self._measured = np.hstack(airframe.measured)
        if torque:
            fast = (hz >= SLOW_HZ) & (hz <= self._highest(Sensor.GYRO))
            self._views += [_View(k, 2, np.flatnonzero(fast & (hz <= self.heard(k)))) for k in range(3, 6)]
            self._views += [_View(k, 0, np.flatnonzero(hz < SLOW_HZ)) for k in range(3, 6)]

    def _highest(self, sensor: Sensor) -> float:
        """Highest frequency judged, Hz."""
        flight = self.airframe.flight
        corner = flight.cutoff_hz.get(sensor, 0.0)
        band = FORCE_BAND_HZ if sensor is Sensor.ACCEL else TORQUE_BAND_HZ
        return min(band, corner or band, 0.45 * flight.inertial_hz, 0.45 * flight.command_hz)

    def heard(self, column: int) -> float:
        """Frequency, Hz, up to which turns over the whole flight exceed the gyroscope's noise."""
        turns = excited(self.airframe.flight)[0] & self.airframe.flight.usable
        power = dct(self._measured[:, column] * turns, norm="ortho") ** 2
        noise = self.noise.power[column - 3] * turns.mean() * self.noise.of_white
        loud = self._hz[(_smooth(power) > _HEARD * noise) & (self._hz <= TORQUE_BAND_HZ)]
        return max(float(loud.max(initial=0.0)), _HEARD_HZ)

    @cached_property
    def possible(self) -> Mask:
        """Parameters that this flight's signals depend on at all (P,)."""
        names = self.airframe.layout.names
        return np.array([self.torque or (n not in TORQUE_ONLY and "torque" not in n) for n in names]) & self._felt

    @property
    def _felt(self) -> Mask:
        """Mask of the parameters, without the voltage exponent if the voltage does not change."""
        sags = self.airframe.voltage_span >= SAG_SPAN
        return np.array([n != "sag" or sags for n in self.airframe.layout.names])

    def prior(self, name: str) -> tuple[float, float]:
        """Prior mean and standard deviation of one parameter, with the accelerometer's error at rest."""
        if name in self._at_rest:
            return self._at_rest[name]
        return prior_of(name)

    @cached_property
    def priors(self) -> tuple[Array, Array]:
        """Mean and standard deviation of every parameter (P,)."""
        mean, sd = np.array([self.prior(n) for n in self.airframe.layout.names]).T
        return mean, sd

    @cached_property
    def ends(self) -> Array:
        """Least and greatest value of every parameter (2, P)."""
        return np.array([ENDS.get(n, (-np.inf, np.inf)) for n in self.airframe.layout.names]).T

    @cached_property
    def _at_rest(self) -> Mapping[str, tuple[float, float]]:
        """Priors of the accelerometer's offset and scale, from its error at rest; scale explains all of it, or none."""
        flight = self.airframe.flight
        mean = None if flight.rest is None else flight.rest.means.get(flight.unit)
        if flight.rest is None or mean is None:
            return {"bias_z": (0.0, UNSEEN_BIAS)}
        off = float(np.linalg.norm(mean)) - flight.gravity
        at_rest = {"bias_z": (-off, flight.rest.sd)}
        if abs(off) < REST_AGREES:
            return at_rest
        return {**at_rest, "scale": (off / flight.gravity, abs(off) / flight.gravity)}

    def trusted(self, columns: list[Array], residual: list[Array]) -> Array:
        """Inverse covariance (F, F) of the free parameters due to the model's own errors, by `REFERENCES`."""
        measured = self.bins(self._measured)
        total = np.zeros((len(columns[0]), len(columns[0])))
        for one in REFERENCES:
            views = [k for k, v in enumerate(self._views) if v.column in one.columns and v.rows in one.rows]
            size = sum(float((measured[k] ** 2).sum()) for k, v in enumerate(self._views) if v.column in one.whole)
            left = math.fsum(self._answerable(k, residual[k], one.below_hz) for k in views)
            if size > 0.0:
                error = one.right_to**2 * size + one.answered**2 * left
                total += sum(columns[k] @ columns[k].T for k in views) / max(error, 1e-12)
        return total

    def _answerable(self, view: int, residual: Array, below_hz: float) -> float:
        """Energy of a view's residual below that frequency, minus the sensor's noise."""
        one = self._views[view]
        if one.column < 3:
            return _beyond_noise(residual, self._hz[one.picked], below_hz)
        noise = self.noise.power[one.column - 3] * self._rows[one.rows].mean() * self.noise.of_white[one.picked]
        beyond = np.array(
            [b.sum() for b in np.split(residual**2 - noise, np.searchsorted(self._hz[one.picked], _OCTAVES))]
        )
        return float(beyond[beyond > 0.0].sum())

    @cached_property
    def noise(self) -> GyroNoise:
        """White noise of the gyroscope, from its own readings."""
        usable = self.airframe.flight.usable
        return GyroNoise(self.airframe.flight, self._hz, np.where(usable[:, None], self._measured[:, 3:], 0.0))

    def spectra(self, theta: Array) -> tuple[Array, ...]:
        """Spectra of the residual at `theta`."""
        return tuple(spectra_of(self.bins(self.residual(theta))))

    def loglik(self, theta: Array, spectra: tuple[Array, ...]) -> float:
        """Log-likelihood of `theta` with given noise, nats."""
        bins = self.bins(self.residual(theta))
        return -0.5 * sum(float((np.log(s) + b**2 / s).sum()) for b, s in zip(bins, spectra, strict=True))

    def bins(self, rows: Array) -> list[Array]:
        """Cosine bins of each channel of (N, 6). Most parameters move force or torque alone; the rest stays zero."""
        channels = np.ascontiguousarray(np.nan_to_num(rows).T)
        moved = [bool(channel.any()) for channel in channels]
        return [
            dct(channels[v.column] * self._rows[v.rows], norm="ortho", overwrite_x=True)[v.picked]
            if moved[v.column]
            else np.zeros(len(v.picked))
            for v in self._views
        ]

    @cached_property
    def _free_bins(self) -> list[list[Array]]:
        return list(map(self.bins, self.airframe.free_signals))

    def residual(self, theta: Array) -> Array:
        """Measured minus predicted (N, 6)."""
        return self._measured - np.hstack(self.airframe.predicted(theta))

    def jacobian(self, theta: Array, free: Mask) -> list[Array]:
        """Derivative of the prediction by each free parameter, in bins (P, K) a channel."""
        base = np.hstack(self.airframe.predicted(theta))
        columns: list[list[Array]] = [[] for _ in self._views]
        first = len(theta) - len(self.airframe.free)
        for k in np.flatnonzero(free):
            if k >= first:
                for out, found in zip(columns, self._free_bins[k - first], strict=True):
                    out.append(found)
                continue
            step = step_of(self.airframe.layout.names[k])
            moved = theta.copy()
            moved[k] += step
            change = (np.hstack(self.airframe.predicted(moved)) - base) / step
            for out, found in zip(columns, self.bins(change), strict=True):
                out.append(found)
        return [np.array(c) for c in columns]


def _beyond_noise(residual: Array, hz: Array, below_hz: float) -> float:
    """Energy of a residual below that frequency, minus the noise floor at the highest ones."""
    power, slow = residual**2, hz < below_hz
    noise = 0.0 if slow.all() else float(power[~slow][-(np.count_nonzero(~slow) // 2) :].mean())
    return max(float(power[slow].sum()) - noise * np.count_nonzero(slow), 0.0)


def fitted(
    likelihood: FlightLikelihood,
    start: Array,
    fixed: Mapping[str, float] | None = None,
    rounds: int = _ROUNDS,
    *,
    expand: bool = True,
) -> FlightFit:
    """The best point with the priors, from `start`; parameters of `fixed` keep those values."""
    layout = likelihood.airframe.layout
    theta = start.copy()
    free = np.ones(len(theta), dtype=bool)
    for name, value in (fixed or {}).items():
        theta[layout.place[name]], free[layout.place[name]] = value, False
    free &= likelihood.possible
    mean, sd = likelihood.priors
    white = rounds > _WHITE_ROUNDS
    for turn in range(rounds):
        bins = likelihood.bins(likelihood.residual(theta))
        # an initial misfit would be taken for noise of that spectrum, and remain
        white = white and turn < _WHITE_ROUNDS
        spectra = [_white(b**2) for b in bins] if white else spectra_of(bins)
        columns = likelihood.jacobian(theta, free)
        curvature, gradient = _normal(columns, bins, spectra)
        penalty = 1.0 / sd[free] ** 2
        hessian = curvature + np.diag(penalty)
        step = _inward(hessian, gradient - penalty * (theta[free] - mean[free]), theta[free], likelihood.ends[:, free])
        theta, part = _descended(likelihood, theta, free, step, spectra)
        moved = part * float(np.abs(step * np.sqrt(np.diag(hessian))).max())
        if moved < _CONVERGED and not white:
            break
        white = white and moved > _NEAR
    if expand:
        return expanded(likelihood, theta, free)
    count = len(theta)
    blank = np.zeros((count, count))
    return FlightFit(layout, theta, blank, blank[0], free, np.empty((0, 6)), (), blank, 0.0, 0)


def _inward(hessian: Array, slope: Array, at: Array, ends: Array) -> Array:
    """Gauss-Newton step with every parameter held that is at a limit and would exceed it.

    Clipped afterwards instead, such a step might not descend, and the fit would stall.
    """
    kept = np.ones(len(at), dtype=bool)
    while True:
        step = np.zeros(len(at))
        step[kept] = np.linalg.solve(hessian[np.ix_(kept, kept)], slope[kept])
        out = kept & (((at <= ends[0]) & (step < 0.0)) | ((at >= ends[1]) & (step > 0.0)))
        if not out.any():
            return step
        kept &= ~out


def _descended(
    likelihood: FlightLikelihood,
    theta: Array,
    free: Mask,
    step: Array,
    spectra: list[Array],
) -> tuple[Array, float]:
    """The point after the longest fraction of the step that does not lose likelihood, and that fraction."""
    mean, sd = likelihood.priors

    def loss(at: Array) -> float:
        bins = likelihood.bins(likelihood.residual(at))
        own = sum(float((b**2 / s).sum()) for b, s in zip(bins, spectra, strict=True))
        return own + float((((at - mean) / sd) ** 2)[free].sum())

    before, part = loss(theta), 1.0
    while part > _SHORTEST:
        moved = theta.copy()
        moved[free] += part * step
        moved = np.clip(moved, *likelihood.ends)
        if loss(moved) <= before:
            return moved, part
        part *= 0.4
    return theta, 0.0


def expanded(likelihood: FlightLikelihood, theta: Array, free: Mask, spectra: list[Array] | None = None) -> FlightFit:
    """The log-likelihood about `theta`, with its own spectra or with those given."""
    residual = likelihood.residual(theta)
    bins = likelihood.bins(residual)
    spectra = spectra_of(bins) if spectra is None else spectra
    columns = likelihood.jacobian(theta, free)
    curvature, gradient = _normal(columns, bins, spectra)
    count = len(theta)
    whole, slope = np.zeros((count, count)), np.zeros(count)
    whole[np.ix_(free, free)], slope[free] = curvature, gradient
    trusted = np.zeros((count, count))
    trusted[np.ix_(free, free)] = likelihood.trusted(columns, bins)
    loglik = -0.5 * sum(float((np.log(s) + b**2 / s).sum()) for b, s in zip(bins, spectra, strict=True))
    return FlightFit(
        layout=likelihood.airframe.layout,
        theta=theta,
        curvature=whole,
        gradient=slope,
        free=free,
        residual=np.where(likelihood.usable[:, None], residual, np.nan),
        spectra=tuple(spectra),
        trusted=trusted,
        loglik=loglik,
        samples=sum(len(b) for b in bins),
    )


def spectra_of(bins: list[Array]) -> list[Array]:
    """Variance of every bin, averaged over its neighbours in proportion to the frequency."""
    return [_smooth(b**2) for b in bins]


def _white(power: Array) -> Array:
    """The mean power in every bin; tiny for a view without rows, whose power is zero."""
    return np.full(len(power), max(float(power.mean()), 1e-300))


def _smooth(power: Array) -> Array:
    """Means over windows that grow with the bin number; small at the low end, where a flight has few bins."""
    total = np.concatenate([[0.0], np.cumsum(power)])
    k = np.arange(len(power))
    half = np.maximum(_LEAST_BINS, (_WINDOW * k)).astype(np.intp)
    low, high = np.maximum(k - half, 0), np.minimum(k + half + 1, len(power))
    return np.asarray(np.maximum((total[high] - total[low]) / (high - low), 1e-12 * max(power.max(), 1e-300)))


def _normal(columns: list[Array], bins: list[Array], spectra: list[Array]) -> tuple[Array, Array]:
    curvature = sum((c / s) @ c.T for c, s in zip(columns, spectra, strict=True))
    gradient = sum((c / s) @ b for c, b, s in zip(columns, bins, spectra, strict=True))
    return np.asarray(curvature), np.asarray(gradient)
