"""Effects that are none of the airframe: the day's air, the estimator, and sensors."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from mavcal.calib.blind.airframe.air import Gust, Weather
from mavcal.calib.blind.airframe.changes import signed
from mavcal.calib.blind.airframe.draw import log_uniform
from mavcal.calib.blind.airframe.effects import air_density
from mavcal.calib.blind.airframe.seen import see
from mavcal.calib.blind.airframe.sides import Entry, Kind, Pair, Rng, Slip

EARLIEST, LATEST = 30.0, 75.0
"""s: between take-off and landing of every mission."""


def draw_weather(rng: Rng, strongest: float, turbulence: float) -> Weather:
    """Wind up to that speed and turbulence up to that deviation, m/s."""
    speed, angle = rng.uniform(0.0, strongest), rng.uniform(-math.pi, math.pi)
    return Weather(speed * math.cos(angle), speed * math.sin(angle), rng.uniform(0.0, turbulence))


def wind(rng: Rng, pair: Pair) -> Pair:
    """A windy day against a calm one."""
    speed, angle = log_uniform(rng, 1.5, 8.0), rng.uniform(-math.pi, math.pi)
    real = Weather(speed * math.cos(angle), speed * math.sin(angle), pair.real.weather.turbulence)
    sim = replace(pair.sim.weather, north=0.0, east=0.0)
    params = {"north": real.north - sim.north, "east": real.east - sim.east}
    pair = replace(pair, real=replace(pair.real, weather=real), sim=replace(pair.sim, weather=sim))
    return pair.said(Entry("wind", "environment", params, size=speed))


def turbulence(rng: Rng, pair: Pair) -> Pair:
    """A gusty day against a smooth one; `sigma` is what linear drag makes of it, m/s2."""
    sigma = log_uniform(rng, 0.5, 2.0)
    real = replace(pair.real, weather=replace(pair.real.weather, turbulence=sigma))
    sim = replace(pair.sim, weather=replace(pair.sim.weather, turbulence=0.0))
    force = sigma * see(pair.real.vehicle).rotor_drag
    return replace(pair, real=real, sim=sim).said(Entry("turbulence", "environment", {"sigma": force}, size=sigma))


def gust(rng: Rng, pair: Pair) -> Pair:
    """One gust; `size` is what linear drag makes of its peak, m/s2, and `t` the time of the peak."""
    peak, angle = log_uniform(rng, 3.0, 9.0), rng.uniform(-math.pi, math.pi)
    length, at = rng.uniform(1.0, 4.0), rng.uniform(EARLIEST, LATEST)
    one = Gust(at, length, (peak * math.cos(angle), peak * math.sin(angle), 0.0))
    weather = replace(pair.real.weather, gusts=(*pair.real.weather.gusts, one))
    params = {"t": at + 0.5 * length, "size": peak * see(pair.real.vehicle).rotor_drag}
    return replace(pair, real=replace(pair.real, weather=weather)).said(Entry("gust", "environment", params, size=peak))


def _slip(rng: Rng, pair: Pair, *, reset: bool) -> Pair:
    size, angle = log_uniform(rng, 0.4, 3.0), rng.uniform(-math.pi, math.pi)
    at, length = rng.uniform(EARLIEST, LATEST), rng.uniform(2.0, 6.0)
    slip = Slip(at, length, (size * math.cos(angle), size * math.sin(angle)), reset)
    real = replace(pair.real, slips=(*pair.real.slips, slip))
    name = "ekf_reset" if reset else "gps_glitch"
    return replace(pair, real=real).said(Entry(name, "environment", {"t": at, "size": size}, size=size))


def gps_glitch(rng: Rng, pair: Pair) -> Pair:
    """The estimated velocity is led astray and returns."""
    return _slip(rng, pair, reset=False)


def ekf_reset(rng: Rng, pair: Pair) -> Pair:
    """The estimated velocity drifts and is set right at once."""
    return _slip(rng, pair, reset=True)


def accel_scale(rng: Rng, pair: Pair) -> Pair:
    """The first unit's accelerometer reads its z axis too large or too small."""
    step = signed(rng, 0.01, 0.06)
    first, second = pair.real.units
    x, y, z = first.accel_scale
    real = replace(pair.real, units=(replace(first, accel_scale=(x, y, z * (1.0 + step))), second))
    return replace(pair, real=real).said(Entry("accel_scale", "sensor", {"scale.z": step}, instances=(1,), size=step))


def accel_bias(rng: Rng, pair: Pair) -> Pair:
    """The first unit's accelerometer has an offset in its horizontal plane."""
    size, angle = log_uniform(rng, 0.1, 0.6), rng.uniform(-math.pi, math.pi)
    added = (size * math.cos(angle), size * math.sin(angle), 0.0)
    first, second = pair.real.units
    x, y, z = (a + b for a, b in zip(first.accel_bias, added, strict=True))
    real = replace(pair.real, units=(replace(first, accel_bias=(x, y, z)), second))
    params = {"bias.x": added[0], "bias.y": added[1]}
    return replace(pair, real=real).said(Entry("accel_bias", "sensor", params, instances=(1,), size=size))


def gyro_scale(rng: Rng, pair: Pair) -> Pair:
    """The first unit's gyroscope reads all axes too large or too small."""
    step = signed(rng, 0.02, 0.1)
    first, second = pair.real.units
    real = replace(pair.real, units=(replace(first, gyro_scale=(1.0 + step,) * 3), second))
    params = {f"scale.{axis}": step for axis in "xyz"}
    return replace(pair, real=real).said(Entry("gyro_scale", "sensor", params, instances=(1,), size=step))


ENVIRONMENT: tuple[Kind, ...] = (
    Kind("wind", wind, "air", "environment"),
    Kind("turbulence", turbulence, "air", "environment"),
    Kind("gust", gust, "gust", "environment"),
    Kind("gps_glitch", gps_glitch, "slip", "environment"),
    Kind("ekf_reset", ekf_reset, "slip", "environment"),
    Kind("air_density", air_density, "thrust", "environment"),
)
SENSORS: dict[str, Kind] = {
    "thrust_scale": Kind("accel_scale", accel_scale, "sensor", "sensor"),
    "inertia": Kind("gyro_scale", gyro_scale, "sensor", "sensor"),
    "rotor_drag": Kind("accel_bias", accel_bias, "sensor", "sensor"),
}
"""The sensor's error that looks most like an airframe's effect, beside it. Source: AIRFRAME 5.6."""


def differs(pair: Pair) -> tuple[str, ...]:
    """What of the day's air differs enough between the sides that naming it is no false alarm."""
    a, b = pair.real.weather, pair.sim.weather
    names = []
    if math.hypot(a.north - b.north, a.east - b.east) > 0.3:
        names.append("wind")
    if max(a.turbulence, b.turbulence) > 0.1:
        names += ["turbulence", "gust"]
        names += [] if "wind" in names else ["wind"]  # slow turbulence is wind of a minute
    if np.isclose(a.north, b.north) and np.isclose(a.east, b.east) and a.turbulence == b.turbulence:
        return ()
    return tuple(names)
