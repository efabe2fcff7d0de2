"""Time and samples: latency, the sensor's own filter, another clock, repeated samples, coarse steps, sudden changes."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, lfilter, lfilter_zi

from mavcal.calib.blind.effects.kind import Added, Kind, Make, direction, named
from mavcal.calib.blind.missions import ALL, LOG_RATE, OVERSAMPLING, Rng, World, ease
from mavcal.calib.blind.sensors import SENSORS, Effect, Order, Quality, Suite
from mavcal.calib.blind.severity import divergence

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Shifted(Effect):
    """The value at time t is that of ``t - delay - rate t``: s, and s/s."""

    delay: float
    rate: float = 0.0

    def mean(self, world: World, sensor: str, x: Array) -> Array:
        """Interpolated on the fine grid."""
        at = world.t - self.delay - self.rate * world.t
        return np.stack([np.interp(at, world.t, column) for column in x.T], axis=1)


@dataclass(frozen=True, eq=False)
class LowPass(Effect):
    """The sensor's filter at its own fast rate: it passes motion and noise alike, at the datasheet's density."""

    cutoff: float
    poles: int

    def _coefficients(self) -> tuple[Array, Array]:
        b, a = butter(self.poles, 2.0 * self.cutoff / (LOG_RATE * OVERSAMPLING))
        return b, a

    def mean(self, world: World, sensor: str, x: Array) -> Array:
        """Filtered, from rest at the first value."""
        b, a = self._coefficients()
        start = lfilter_zi(b, a)[:, None] * x[:1]
        return np.asarray(lfilter(b, a, x, axis=0, zi=start)[0])

    def _gain(self, f: Array) -> Array:
        """Amplitude at `f` Hz."""
        b, a = self._coefficients()
        z = np.exp(-2j * np.pi * f / (LOG_RATE * OVERSAMPLING))
        return np.asarray(np.abs(np.polyval(b[::-1], z) / np.polyval(a[::-1], z)))

    def noise(self, world: World, sensor: str, noise: Array, quality: Quality, rng: Rng) -> Array:
        """The datasheet's density is what enters the filter, up to half the log's rate."""
        f = np.asarray(np.fft.rfftfreq(len(noise), quality.every / LOG_RATE), dtype=np.float64)
        return np.fft.irfft(np.fft.rfft(noise, axis=0) * self._gain(f)[:, None], n=len(noise), axis=0)

    def information(self, world: World, sensor: str, quality: Quality) -> float:
        """Divergence of the filtered spectrum from the white one."""
        n = len(range(0, len(world.t), OVERSAMPLING * quality.every))
        f = (np.arange(n) + 0.5) / n * 0.5 * LOG_RATE / quality.every
        rounding = quality.step**2 / 12.0
        return 3.0 * divergence((quality.sd**2 * self._gain(f) ** 2 + rounding) / quality.variance)


@dataclass(frozen=True, eq=False)
class Held(Effect):
    """A bus that sometimes hands over the old sample: `rows` repeat the one before them."""

    rows: Array  # integer rows at the sensor's rate

    def finish(self, world: World, sensor: str, x: Array, rng: Rng) -> Array:
        """Repeated rows."""
        source = np.arange(len(x))
        source[self.rows] = -1
        return np.asarray(x[np.maximum.accumulate(source)])

    def information(self, world: World, sensor: str, quality: Quality) -> float:
        """Each repeated value differs from its own by twice the variance; motion comes on top and is left out."""
        return 2.0 * 3.0 * len(self.rows)


@dataclass(frozen=True, eq=False)
class Coarse(Effect):
    """A larger rounding step, in the sensor's unit."""

    to: float = field(default=0.0, kw_only=True)

    def step(self, sensor: str, quality: Quality) -> float:
        """The coarse step."""
        return self.to

    def information(self, world: World, sensor: str, quality: Quality) -> float:
        """As the extra variance of rounding."""
        n = 3 * len(range(0, len(world.t), OVERSAMPLING * quality.every))
        ratio = (quality.sd**2 + self.to**2 / 12.0) / quality.variance
        return n * (ratio - 1.0 - math.log(ratio))


def _delay(rng: Rng, world: World, suite: Suite, sensor: str) -> Make:
    return lambda size: Shifted(f"{sensor}_delay", (sensor,), size, truth={"delay_s": size}, order=Order.TIME)


def _clock(rng: Rng, world: World, suite: Suite, sensor: str) -> Make:
    sign = rng.choice([-1.0, 1.0])
    return lambda size: Shifted("clock_drift", SENSORS, 0.0, sign * size, order=Order.TIME)


def _low_pass(rng: Rng, world: World, suite: Suite, sensor: str) -> Make:
    """Two poles as in sensors' and flight controllers' filters, or the one of a resistor and a capacitor."""
    poles = int(rng.choice([1, 2, 2]))
    return lambda size: LowPass(f"{sensor}_low_pass", (sensor,), 1.0 / size, poles, order=Order.TIME)


def _hold(rng: Rng, world: World, suite: Suite, sensor: str) -> Make:
    n = len(range(0, len(world.t), OVERSAMPLING * suite[sensor].every))
    candidates = rng.permutation(np.arange(1, n, int(rng.choice([1, 2]))))

    def make(size: float) -> Held:
        return Held(f"{sensor}_hold", (sensor,), np.sort(candidates[: max(1, round(size))]), order=Order.LIMIT)

    return make


def _coarse(rng: Rng, world: World, suite: Suite, sensor: str) -> Make:
    return lambda size: Coarse(f"{sensor}_quantisation", (sensor,), to=size, truth={"step": size}, order=Order.LIMIT)


def _step(rng: Rng, world: World, suite: Suite, sensor: str) -> Make:
    """A shock or a piece of iron that moves: the offset is another one from then on, within 20 ms."""
    v = direction(rng)
    at = rng.uniform(0.15, 0.85) * float(world.t[-1])
    delta = np.outer(ease(world.t, at, at + 0.02), v)
    return lambda size: Added(f"{sensor}_step", (sensor,), {sensor: size * delta}, truth=named("step", size * v))


SIZES = {"accel": (1e-5, 5.0), "gyro": (1e-6, 0.5), "mag": (1e-3, 80.0)}
FINEST = {"accel": (5e-3, 2.0), "gyro": (1e-3, 0.2), "mag": (0.16, 20.0)}
KINDS = (
    *(Kind(f"{s}_delay", s, _delay, (1e-6, 0.12), 1, ALL) for s in SENSORS),
    *(Kind(f"{s}_low_pass", s, _low_pass, (1 / 700.0, 0.5), 1, ALL) for s in SENSORS),
    *(Kind(f"{s}_hold", s, _hold, (1.0, 3000.0), 0, ALL) for s in SENSORS),
    *(Kind(f"{s}_quantisation", s, _coarse, FINEST[s], 0, ALL) for s in SENSORS),
    *(Kind(f"{s}_step", s, _step, SIZES[s], 3, ALL) for s in SENSORS),
    Kind("clock_drift", "all", _clock, (1e-8, 2e-3), 1, ALL),
)
