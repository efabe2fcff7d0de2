"""Errors that exist and that no catalogue of calibration has: what a diagnosis must call unknown.

Those marked foreseen are named in the method's own text; the others its author was not told of.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from mavcal.calib.blind.effects.kind import Added, Kind, Make, Mapped, direction
from mavcal.calib.blind.effects.thermal import lagged
from mavcal.calib.blind.missions import ALL, FLOWN, TRAVELLED, TURNED, MissionKind, Rng, World
from mavcal.calib.blind.sensors import Order, Suite

Array = NDArray[np.float64]
MOVED = (MissionKind.TUMBLE, MissionKind.FLIGHT, MissionKind.FULL)
RANGE = {"accel": (1e-5, 8.0), "gyro": (1e-6, 1.0), "mag": (1e-3, 90.0)}


def _added(name: str, sensor: str, shape: Array) -> Make:
    return lambda size: Added(f"unknown_{name}", (sensor,), {sensor: size * shape})


def _axis(rng: Rng) -> int:
    return int(rng.integers(3))


def _on_axis(rng: Rng, path: Array) -> Array:
    out = np.zeros((len(path), 3))
    out[:, _axis(rng)] = path
    return out


def _unit(x: Array) -> Array:
    return np.asarray(x / np.abs(x).max())


def _cubic(rng: Rng, world: World, suite: Suite, sensor: str) -> Make:
    x = world.truth(sensor)
    return _added("cubic", sensor, _on_axis(rng, _unit(x[:, _axis(rng)]) ** 3))


def _asymmetry(rng: Rng, world: World, suite: Suite, sensor: str) -> Make:
    """The gain differs by sign (IEEE 1293: scale factor asymmetry)."""
    axis = _axis(rng)

    def make(size: float) -> Mapped:
        def form(x: Array) -> Array:
            y = x.copy()
            y[:, axis] += size * np.maximum(x[:, axis], 0.0)
            return y

        return Mapped("unknown_asymmetry", (sensor,), form, order=Order.GAIN)

    return make


def _play(rng: Rng, world: World, suite: Suite, sensor: str) -> Make:
    """Mechanical play or remanence: the output follows only after the input has turned by a width."""
    axis = _axis(rng)
    x = world.truth(sensor)[::8, axis]
    width = rng.uniform(0.05, 0.3) * float(np.ptp(x))
    out = np.empty_like(x)
    at = x[0]
    for k, value in enumerate(x.tolist()):
        at = min(max(at, value - width), value + width)
        out[k] = at
    left = np.zeros((len(world.t), 3))
    left[:, axis] = np.interp(world.t, world.t[::8], out - x)
    return _added("play", sensor, left / width)


def _telegraph(rng: Rng, world: World, suite: Suite, sensor: str) -> Make:
    """Popcorn noise: each axis jumps between two levels at random times."""
    out = np.zeros((len(world.t), 3))
    for axis in range(3):
        times = np.cumsum(rng.exponential(rng.uniform(2.0, 8.0), 100))
        out[:, axis] = (np.searchsorted(times, world.t) % 2) * rng.uniform(0.3, 1.0)
    return _added("telegraph", sensor, out)


def _gauss_markov(rng: Rng, world: World, suite: Suite, sensor: str) -> Make:
    """Exponentially correlated noise of each axis."""
    rho = math.exp(-world.dt / rng.uniform(0.3, 4.0))
    drive = math.sqrt(1.0 - rho**2) * rng.standard_normal((len(world.t), 3))
    return _added("gauss_markov", sensor, np.asarray(lfilter([1.0], [1.0, -rho], drive, axis=0)))


def _hidden_driver(rng: Rng, world: World, suite: Suite, sensor: str) -> Make:
    """One quantity that nobody logs (pressure, a payload's current) moves all axes together."""
    rho = math.exp(-world.dt / rng.uniform(2.0, 12.0))
    path = lfilter([1.0], [1.0, -rho], rng.standard_normal(len(world.t)))
    return _added("hidden_driver", sensor, np.outer(_unit(path), rng.standard_normal(3)))


def _duty_cycle(rng: Rng, world: World, suite: Suite, sensor: str) -> Make:
    """A heater or a transmitter that is switched on and off at its own pace."""
    period, share, phase = rng.uniform(3.0, 14.0), rng.uniform(0.25, 0.6), rng.random()
    on = ((world.t / period + phase) % 1.0 < share).astype(float)
    return _added("duty_cycle", sensor, np.outer(lagged(on, world.dt, 0.05), direction(rng)))


def _supply(rng: Rng, world: World, suite: Suite, sensor: str) -> Make:
    """The battery sags under current and the sensor's reference voltage with it."""
    return _added("supply", sensor, np.outer(_unit(world.current - world.current[0]), direction(rng)))


def _current_squared(rng: Rng, world: World, suite: Suite, sensor: str) -> Make:
    """Warm leads, saturating iron: a field that goes with the square of the current."""
    return _added("current_squared", sensor, np.outer(_unit(world.current**2), direction(rng)))


def _turning(rng: Rng, world: World, suite: Suite, sensor: str) -> Make:
    """A gyroscope's proof mass that feels angular acceleration about another axis."""
    turning = np.gradient(world.rate, world.dt, axis=0)
    return _added("angular_acceleration", sensor, np.outer(_unit(turning[:, _axis(rng)]), direction(rng)))


def _g_squared(rng: Rng, world: World, suite: Suite, sensor: str) -> Make:
    """Anisoelasticity: the product of two specific forces (IEEE Std 952)."""
    a = rng.choice(3, 2, replace=False)
    return _added("anisoelastic", sensor, _on_axis(rng, world.force[:, a[0]] * world.force[:, a[1]] / 96.2))


def _cross_product(rng: Rng, world: World, suite: Suite, sensor: str) -> Make:
    """Cross-axis nonlinearity."""
    x = world.truth(sensor)
    a = rng.choice(3, 2, replace=False)
    return _added("cross_axis_product", sensor, _on_axis(rng, _unit(x[:, a[0]] * x[:, a[1]])))


def _ripple(rng: Rng, world: World, suite: Suite, sensor: str) -> Make:
    """A converter's integral nonlinearity: periodic in the input."""
    axis = _axis(rng)
    x = world.truth(sensor)[:, axis]
    period = float(np.ptp(x)) / rng.uniform(3.0, 9.0)
    out = np.zeros((len(x), 3))
    out[:, axis] = np.sin(2.0 * np.pi * x / period + rng.uniform(0, 6.28))
    return _added("converter_ripple", sensor, out)


def _settling(rng: Rng, world: World, suite: Suite, sensor: str) -> Make:
    """Start-up: an offset that decays from switching on."""
    decay = np.exp(-world.t / rng.uniform(4.0, 20.0))
    return _added("settling", sensor, np.outer(decay, direction(rng)))


def _bursts(rng: Rng, world: World, suite: Suite, sensor: str) -> Make:
    """Radio packets that reach the sensor's lines: short bursts at random times."""
    out = np.zeros((len(world.t), 3))
    for start in rng.uniform(1.0, world.t[-1] - 1.0, int(rng.integers(8, 40))):
        rows = (world.t >= start) & (world.t < start + rng.uniform(0.03, 0.15))
        out[rows] += rng.standard_normal((int(rows.sum()), 3))
    return _added("bursts", sensor, out)


def _ringing(rng: Rng, world: World, suite: Suite, sensor: str) -> Make:
    """A mast that swings after each change of thrust: a resonance at a few hertz."""
    f, q = rng.uniform(3.0, 12.0), rng.uniform(8.0, 25.0)
    w = 2.0 * np.pi * f
    r = math.exp(-w / (2.0 * q) * world.dt)
    kick = np.gradient(world.throttle, world.dt)
    out = lfilter([1.0], [1.0, -2.0 * r * math.cos(w * world.dt), r * r], kick)
    return _added("ringing", sensor, np.outer(_unit(out), direction(rng)))


def _eddy(rng: Rng, world: World, suite: Suite, sensor: str) -> Make:
    """Currents induced in a plate by the changing field: along its normal only."""
    normal = direction(rng)
    change = np.gradient(world.field, world.dt, axis=0) @ normal
    return _added("eddy_current", sensor, np.outer(_unit(change), normal))


def _temperature_rate(rng: Rng, world: World, suite: Suite, sensor: str) -> Make:
    """Thermal stress: the gain follows the rate of the temperature."""
    axis = _axis(rng)
    rate = _unit(np.gradient(world.temperature, world.dt))
    return _added("thermal_stress", sensor, _on_axis(rng, rate * _unit(world.truth(sensor)[:, axis])))


def _dipole(rng: Rng, world: World, suite: Suite, sensor: str) -> Make:
    """A car or a reinforced pillar beside the path: a dipole's field, steep where the path comes near."""
    near = world.place[int(rng.integers(len(world.t)))] + rng.standard_normal(3) * np.array([1.5, 1.5, 1.0])
    r = world.place - near
    size = np.sqrt((r**2).sum(axis=1, keepdims=True) + 0.25)
    moment = direction(rng)
    field = 3.0 * r * (r @ moment)[:, None] / size**5 - moment / size**3
    return _added("dipole_nearby", sensor, world.attitude.inv().apply(field / np.abs(field).max()))


def _moving_part(rng: Rng, world: World, suite: Suite, sensor: str) -> Make:
    """A servo with a magnet, a landing gear: it goes to a new place at moments that are not logged, in some seconds."""
    out = np.zeros((len(world.t), 3))
    for start in rng.uniform(0.05, 0.9, int(rng.integers(3, 7))) * world.t[-1]:
        u = np.clip((world.t - start) / rng.uniform(0.5, 3.0), 0.0, 1.0)
        out += np.outer(u, rng.standard_normal(3))
    return _added("moving_part", sensor, out)


def _entry(
    name: str, sensor: str, draw: object, missions: tuple[MissionKind, ...] = ALL, *, foreseen: bool = False
) -> Kind:
    assert callable(draw)
    return Kind(f"unknown_{name}", sensor, draw, RANGE[sensor], 0, missions, foreseen)


KINDS = (
    _entry("cubic", "accel", _cubic, TURNED, foreseen=True),
    _entry("cubic", "gyro", _cubic, MOVED, foreseen=True),
    Kind("unknown_asymmetry", "accel", _asymmetry, (1e-6, 0.5), 0, TURNED, foreseen=True),
    Kind("unknown_asymmetry", "gyro", _asymmetry, (1e-6, 0.8), 0, MOVED, foreseen=True),
    _entry("telegraph", "gyro", _telegraph, foreseen=True),
    _entry("telegraph", "mag", _telegraph, foreseen=True),
    _entry("gauss_markov", "gyro", _gauss_markov, foreseen=True),
    _entry("gauss_markov", "accel", _gauss_markov, foreseen=True),
    _entry("hidden_driver", "accel", _hidden_driver, foreseen=True),
    _entry("hidden_driver", "mag", _hidden_driver, foreseen=True),
    _entry("angular_acceleration", "gyro", _turning, MOVED, foreseen=True),
    _entry("cross_axis_product", "accel", _cross_product, TURNED, foreseen=True),
    _entry("play", "accel", _play, TURNED),
    _entry("play", "mag", _play, TURNED),
    _entry("duty_cycle", "mag", _duty_cycle),
    _entry("duty_cycle", "gyro", _duty_cycle),
    _entry("supply", "accel", _supply, TRAVELLED),
    _entry("supply", "gyro", _supply, TRAVELLED),
    _entry("current_squared", "mag", _current_squared, TRAVELLED),
    _entry("anisoelastic", "gyro", _g_squared, TURNED),
    _entry("converter_ripple", "accel", _ripple, TURNED),
    _entry("converter_ripple", "gyro", _ripple, MOVED),
    _entry("settling", "accel", _settling),
    _entry("settling", "gyro", _settling),
    _entry("bursts", "gyro", _bursts),
    _entry("bursts", "mag", _bursts),
    _entry("ringing", "accel", _ringing, FLOWN),
    _entry("eddy_current", "mag", _eddy, TURNED),
    _entry("thermal_stress", "accel", _temperature_rate, TURNED),
    _entry("dipole_nearby", "mag", _dipole, TRAVELLED),
    _entry("moving_part", "mag", _moving_part),
)
