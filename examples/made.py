"""Recordings that stand in for logs of your own: made by the simulator of sensors, with everything known."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from mavcal.calib import Channel, Recording, Sensor, Stage
from mavcal.calib.earth import earth_field
from mavcal.calib.logs.tables import write_table
from mavcal.calib.recording import Event, Identity, ParameterTimeline
from mavcal.calib.simulate import (
    MotionOptions,
    SensorErrors,
    SensorSuite,
    Simulated,
    Warming,
    along,
    motion_of,
    simulate,
    trajectory,
)
from mavcal.calib.simulate.typical import typical

Array = NDArray[np.float64]

FIELD = np.array([21.0, 1.1, 43.2])
"""Magnetic field north, east, down, uT: the middle of Europe."""
OFFSET = (14.0, -9.0, 6.0)
"""Offset of the compass that flies, uT."""
LATITUDE, LONGITUDE, YEAR = 47.4, 8.5, 2026.5
_QUIET = {"accel": 3e-3, "gyro": 3e-4, "mag": 0.05}

CLEAN = SensorSuite(**{name: SensorErrors(noise_density=np.full(3, noise)) for name, noise in _QUIET.items()})
"""Noise alone."""
REAL = dataclasses.replace(
    CLEAN,
    accel=dataclasses.replace(CLEAN.accel, temperature=np.array([[0.008], [-0.005], [0.012]]), t_ref=35.0),
    mag=dataclasses.replace(CLEAN.mag, bias=np.array([-6.0, 4.0, -3.0])),
)
"""An accelerometer that drifts with temperature, and a magnetised compass."""


def turned_by_hand(path: Path, seed: int) -> Path:
    """A table of an ordinary unit that is waved through all directions for a minute."""
    rng = np.random.default_rng(seed)
    suite = typical(rng)
    motion = motion_of("tumble", MotionOptions(duration=60.0), rng)
    write_table(simulate(trajectory(motion.legs, 50.0, field=FIELD, start=motion.start), suite, rng).recording, path)
    return path


def flown(seed: int) -> Recording:
    """Two minutes of a copter: it stands, takes off, turns twice on the spot and banks; its compass has an offset."""
    rng = np.random.default_rng(seed)
    rate, seconds, ground = 50.0, 120.0, 15.0
    t = np.arange(int(seconds * rate)) / rate
    up = np.clip((t - ground) / 3.0, 0.0, 1.0)
    turned = np.clip((t - ground - 5.0) / (seconds - ground - 10.0), 0.0, 1.0)
    yaw = 0.3 + 4.0 * np.pi * turned**2 * (3.0 - 2.0 * turned)
    banks = np.radians(15.0) * up[:, None] * np.column_stack([np.sin(0.7 * t), np.sin(0.45 * t + 1.0)])
    attitude = Rotation.from_euler("ZYX", np.column_stack([yaw, banks]))
    field = earth_field(LATITUDE, LONGITUDE, 450.0, YEAR).north_east_down
    suite = dataclasses.replace(CLEAN, mag=dataclasses.replace(CLEAN.mag, bias=np.array(OFFSET)))
    made = simulate(along(t, attitude, field=field), suite, rng, mag_rate=10.0).recording
    place = np.tile([LATITUDE, LONGITUDE, 450.0], (int(seconds), 1))
    position = Channel(Sensor.POSITION, 0, np.arange(seconds), place, "deg", Stage.RAW, "GPS")
    return dataclasses.replace(
        made,
        channels=(*(_as_streamed(channel) for channel in made.channels), position),
        parameters=ParameterTimeline.constant(_parameters()),
        events=(Event(0.0, "utc", "2026-07-01T12:00:00"), Event(ground, "armed", "")),
        identity=Identity(autopilot="ardupilot", firmware=(4, 5, 7), uid="00ff"),
        source="flight.bin",
    )


def _as_streamed(channel: Channel) -> Channel:
    """As a log has it: the calibration in force is in the numbers of inertial sensors and compasses."""
    corrected = channel.sensor in {Sensor.ACCEL, Sensor.GYRO, Sensor.MAG}
    return dataclasses.replace(channel, stage=Stage.CORRECTED) if corrected else channel


def _parameters() -> dict[str, float | int]:
    """Parameters of one inertial unit and one external compass that were never calibrated."""
    values: dict[str, float | int] = {"AHRS_ORIENTATION": 0, "COMPASS_LEARN": 0, "COMPASS_OFFS_MAX": 1800.0}
    values |= {"COMPASS_DEV_ID": 97539, "COMPASS_PRIO1_ID": 97539, "COMPASS_USE": 1, "COMPASS_EXTERNAL": 1}
    values |= {"COMPASS_ORIENT": 0, "COMPASS_SCALE": 1.0, "COMPASS_MOTCT": 0}
    values |= {f"COMPASS_{name}_{axis}": 0.0 for name in ("OFS", "ODI", "MOT") for axis in "XYZ"}
    values |= {f"COMPASS_DIA_{axis}": 1.0 for axis in "XYZ"}
    values |= {"INS_ACC_ID": 2753028, "INS_GYR_ID": 2753029, "INS_USE": 1}
    values |= {f"INS_{name}_{axis}": 0.0 for name in ("ACCOFFS", "GYROFFS") for axis in "XYZ"}
    return values | {f"INS_ACCSCAL_{axis}": 1.0 for axis in "XYZ"}


def beside_ideal(suite: SensorSuite, seed: int) -> Recording:
    """Thirty seconds of tumbling while it warms up, with what ideal sensors would have read beside it."""
    rng = np.random.default_rng(seed)
    motion = motion_of("tumble", MotionOptions(duration=30.0), rng)
    path = trajectory(motion.legs, 50.0, field=FIELD, start=motion.start, warming=Warming(22.0, 55.0, 12.0))
    made = simulate(path, suite, rng)
    return dataclasses.replace(made.recording, reference=_ideal(made))


def _ideal(made: Simulated) -> tuple[Channel, ...]:
    path = made.trajectory
    readings = ((Sensor.ACCEL, path.force, "m/s2"), (Sensor.GYRO, path.rate, "rad/s"), (Sensor.MAG, path.field, "uT"))
    return tuple(Channel(sensor, 0, path.t, values, unit, Stage.RAW, "reference") for sensor, values, unit in readings)
