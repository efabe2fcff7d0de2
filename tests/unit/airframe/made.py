"""Flights made by hand: commands and motion as a test wants them, on the grid or as a recording."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from mavcal.calib.airframe.answer import Geometry
from mavcal.calib.airframe.commands import MotorCommands
from mavcal.calib.airframe.effects import BODY_DRAG
from mavcal.calib.airframe.flown import FlownFlight
from mavcal.calib.airframe.geometry import geometry_of
from mavcal.calib.airframe.physics import Airframe, Kind
from mavcal.calib.recording import Channel, Event, Identity, ParameterTimeline, Recording, Sensor, Stage

G = 9.80665
HZ = 100.0
Array = np.ndarray


def frame(name: str = "quad-x") -> Geometry:
    found = geometry_of({}, name)
    assert found is not None
    return found


def level(n: int) -> Array:
    return np.tile([1.0, 0.0, 0.0, 0.0], (n, 1))


def flight(c: Array, geometry: Geometry | None = None, **changes: Any) -> FlownFlight:
    """A flight with these commands (N, n), level and still where `changes` do not say otherwise."""
    geometry = geometry or frame()
    n = len(c)
    t = np.arange(n) / HZ
    commands = MotorCommands(t, c, np.zeros(n, dtype=bool), "test", None)
    plain = FlownFlight(
        t=t,
        force=np.tile([0.0, 0.0, -G], (n, 1)),
        rate=np.zeros((n, 3)),
        acceleration=np.zeros((n, 3)),
        unit=0,
        others={},
        c=c,
        velocity=np.zeros((n, 3)),
        q=level(n),
        voltage=np.full(n, 12.6),
        height=np.full(n, 10.0),
        usable=np.ones(n, dtype=bool),
        limited=np.zeros(n, dtype=bool),
        rest=None,
        cutoff_hz={},
        command_hz=HZ,
        inertial_hz=HZ,
        geometry=geometry,
        commands=commands,
        ardupilot=True,
    )
    found = replace(plain, **changes)
    return (
        found if "acceleration" in changes else replace(found, acceleration=np.gradient(found.rate, 1.0 / HZ, axis=0))
    )


def hover(seconds: float = 3.0, command: float = 0.5, motors: int = 4) -> Array:
    return np.full((round(seconds * HZ), motors), command)


def airframe(one: FlownFlight, *, kind: Kind | None = None, volts: float | None = 12.6, **options: Any) -> Airframe:
    return Airframe(one, kind or Kind(), volts, **options)


def theta(model: Airframe, **values: float) -> Array:
    """Parameters: nothing but what is said; `c2` is the drag of the body along every axis."""
    found = np.zeros(len(model.layout.names))
    found[[model.layout.place[name] for name in ("gain_x", "gain_y", "gain_z", "k")]] = 280.0, 280.0, 7.0, 25.0
    for name, value in values.items():
        for one in BODY_DRAG if name == "c2" else (name,):
            found[model.layout.place[one]] = value
    return found


AP = Identity(autopilot="ardupilot")
QUAD_X: Mapping[str, float] = {
    "FRAME_CLASS": 1, "FRAME_TYPE": 1, "MOT_SPIN_MIN": 0.15, "MOT_SPIN_MAX": 0.95, "MOT_PWM_MIN": 1000,
    "MOT_PWM_MAX": 2000, "MOT_THST_EXPO": 0.65, "INS_ACCEL_FILTER": 20, "INS_GYRO_FILTER": 20,
}  # fmt: skip


def stream(
    sensor: Sensor, t: Array, values: Array, *, instance: int = 0, source: str = "IMU", stage: Stage = Stage.FILTERED
) -> Channel:
    return Channel(sensor, instance, t, values, "1", stage, source)


def recording(
    seconds: float = 60.0,
    *,
    airborne: tuple[float, float] = (10.0, 50.0),
    scales: tuple[float, ...] = (1.0, 1.0),
    hz: tuple[float, ...] = (400.0, 100.0),
    parameters: Mapping[str, float] = QUAD_X,
    command: float = 0.5,
) -> Recording:
    """A vehicle that rests, climbs to 10 m at once, hovers and rests; unit i reads `scales[i]` times the force."""
    channels, dynamics = [], []
    start, end = airborne
    for k, (scale, rate) in enumerate(zip(scales, hz, strict=True)):
        t = np.arange(0.0, seconds, 1.0 / rate)
        channels.append(stream(Sensor.ACCEL, t, np.tile([0.0, 0.0, -G * scale], (len(t), 1)), instance=k))
        channels.append(stream(Sensor.GYRO, t, np.zeros((len(t), 3)), instance=k))
    t = np.arange(0.0, seconds, 0.02)
    up = (t >= start) & (t < end)
    pulses = np.where(up, 0.15 + 0.8 * command, 0.0)
    channels.append(stream(Sensor.MOTOR, t, np.tile(pulses[:, None], (1, 4)), source="RCOU", stage=Stage.RAW))
    t = np.arange(0.0, seconds, 0.1)
    up = (t >= start) & (t < end)
    place = np.column_stack([np.zeros(len(t)), np.zeros(len(t)), np.where(up, -10.0, 0.0)])
    dynamics.append(stream(Sensor.PLACE, t, place, source="XKF1", stage=Stage.RAW))
    dynamics.append(stream(Sensor.VELOCITY, t, np.zeros((len(t), 3)), source="XKF1", stage=Stage.RAW))
    dynamics.append(stream(Sensor.ATTITUDE, t, level(len(t)), source="XKQ", stage=Stage.RAW))
    dynamics.append(stream(Sensor.VOLTAGE, t, np.full((len(t), 1), 12.6), source="BAT", stage=Stage.RAW))
    events = (Event(start - 1.0, "armed", ""), Event(end + 1.0, "disarmed", ""))
    return Recording(
        tuple(channels), ParameterTimeline.constant(dict(parameters)), events, identity=AP, dynamics=tuple(dynamics)
    )
