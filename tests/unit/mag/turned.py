"""A simulated ArduPilot vehicle that is turned for its compasses, as its streams show it, and the truth beside it.

The compass task averages about ten samples over about 100 ms. It has no phase in common with the 50 Hz streams, which
carry the time stamps of the message. The first compass comes with all its digits (HIGHRES_IMU), the others in whole mG,
truncated (RAW_IMU and its like). The gyroscope lags by its filter. Only the containers come from `calib`.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from mavcal.calib.earth import EarthField
from mavcal.calib.fit import FitResult
from mavcal.calib.recording import Channel, Identity, Recording, Rounding, Sensor, Stage
from mavcal.service.simvehicle.ardupilot_sensors import compass_reader
from mavcal.service.simvehicle.config import VehicleConfig
from mavcal.service.simvehicle.corrections import truncated
from mavcal.service.simvehicle.magreader import MagReader
from mavcal.service.simvehicle.motion import FACES
from mavcal.service.simvehicle.rotation import Array
from mavcal.service.simvehicle.world import SimWorld

MESSAGES_HZ = 50.0
LONGEST_LAG_S = 0.012
"""Delay of the gyroscope: ArduPilot's low-pass of 20 Hz delays by sqrt(2)/(2 pi 20 Hz) = 11 ms."""
MGAUSS_PER_UT = 10.0
NINE = ((0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2))
QUANTA = (0.0, 0.1, 0.1)
"""Steps of the three compasses, uT."""


@dataclass(frozen=True, eq=False)
class Turned:
    """What was streamed, the field where it was, and the numbers (9,) of each compass that a fit should find.

    They are the offset, the diagonal and the upper cross terms of the symmetric matrix with determinant 1.
    """

    recording: Recording
    field: EarthField
    truth: tuple[Array, ...]


def turned(seed: int, rate_dps: float, noise: float, seconds: float) -> Turned:
    """A vehicle that is tumbled at `rate_dps` (0: it is held in many attitudes, one after the other) for `seconds`.

    `noise` is that of one axis of a compass reading, uT.
    """
    rng = np.random.default_rng([seed, 77])
    config = VehicleConfig(seed=seed, imu_count=1, mag_count=3, mag_noise=noise, mag_orientations=(0, 0, 0))
    world = SimWorld(config)
    phase, lag = float(rng.uniform(0.0, 1.0 / MESSAGES_HZ)), float(rng.uniform(0.0, LONGEST_LAG_S))
    reader = compass_reader(world)
    pieces = [_moved(world, reader, rng, rate_dps, start, end, phase, lag) for start, end in _legs(rate_dps, seconds)]
    t, force, turning = (np.concatenate([piece[k] for piece in pieces]) for k in range(3))
    readings = [np.concatenate([piece[3][k] for piece in pieces]) for k in range(3)]
    read_at = np.concatenate([piece[4] for piece in pieces])
    fresh = np.diff(read_at, prepend=-1.0) > 0.0
    fresh[:6] = False  # what was read before the first period was whole
    channels = [
        Channel(Sensor.ACCEL, 0, t, force, "m/s2", Stage.RAW, "HIGHRES_IMU"),
        Channel(Sensor.GYRO, 0, t, turning, "rad/s", Stage.RAW, "HIGHRES_IMU"),
        *(_compass(k, t[fresh], readings[k][fresh]) for k in range(3)),
    ]
    truth = tuple(_numbers(s.offset, np.linalg.inv(s.matrix)) for s in world.truth.mags)
    recording = Recording(tuple(channels), identity=Identity(autopilot="ardupilot"))
    return Turned(recording, EarthField(world.field, norm_sd=0.15), truth)


def _legs(rate_dps: float, seconds: float) -> list[tuple[float, float]]:
    """Pieces of one motion each: a hold of two seconds, or half a second of a tumble that goes on."""
    length = 2.0 if rate_dps == 0.0 else 0.5
    edges = np.arange(0.0, seconds + 1e-9, length)
    return [(float(a), float(b)) for a, b in itertools.pairwise(edges)]


def _moved(
    world: SimWorld,
    reader: MagReader,
    rng: np.random.Generator,
    rate_dps: float,
    start: float,
    end: float,
    phase: float,
    lag: float,
) -> tuple[Array, Array, Array, list[Array], Array]:
    """Times, force, rates, compass readings and when they were read, of the messages from `start` to `end`."""
    if rate_dps == 0.0:
        _hold(world, rng, start)
    elif start == 0.0:
        world.motion.hold(0.0, [float(a) for a in rng.uniform(-180.0, 180.0, 3)], transition_s=0.0)
        world.motion.tumble(0.0, rate_dps)
    reader.advance(end)
    first = int(np.ceil((start - phase) * MESSAGES_HZ + 1e-9))
    last = int(np.ceil((end - phase) * MESSAGES_HZ + 1e-9))
    t = phase + np.arange(first, last) / MESSAGES_HZ
    state, late = world.state(t), world.state(np.maximum(t - lag, start))
    readings = [reader.raw(k, t) for k in range(3)]
    return t, world.accel(0, state), world.gyro(0, late), readings, reader.read_at(t)


def _hold(world: SimWorld, rng: np.random.Generator, start: float) -> None:
    """The next attitude: faces and slants in turn, moved to within half a second."""
    names = list(FACES)
    index = round(start / 2.0)
    pose = np.array(FACES[names[index % 6]]) + rng.uniform(-40.0, 40.0, 3)
    world.motion.hold(start, [float(a) for a in pose], transition_s=0.5 if start else 0.0)


def _compass(k: int, t: Array, values: Array) -> Channel:
    if not QUANTA[k]:
        return Channel(Sensor.MAG, k, t, values, "uT", Stage.RAW, "HIGHRES_IMU")
    counts = truncated(values, MGAUSS_PER_UT).astype(np.float64)
    middle = (counts + 0.5 * np.sign(counts)) * QUANTA[k]
    return Channel(
        Sensor.MAG, k, t, middle, "uT", Stage.RAW, f"SCALED_IMU{k + 1}", QUANTA[k], Rounding.TOWARD_ZERO, counts == 0
    )


def _numbers(offset: Array, correction: Array) -> Array:
    normal = correction / np.cbrt(np.linalg.det(correction))
    return np.concatenate([offset, normal[NINE]])


def deviations(fit: FitResult, truth: Array) -> Array:
    """Error over sd (9,): offset, diagonal and cross terms of the matrix with determinant 1."""
    matrix = fit.model.matrix
    scale = float(np.cbrt(np.linalg.det(matrix)))
    inverse = np.linalg.inv(matrix)
    jacobian = np.eye(12)
    for k in range(9):
        unit = np.zeros(9)
        unit[k] = 1.0
        change = unit.reshape(3, 3) - matrix * np.trace(inverse @ unit.reshape(3, 3)) / 3.0
        jacobian[3:, 3 + k] = change.ravel() / scale
    rows = [0, 1, 2, *(3 + 3 * i + j for i, j in zip(*NINE, strict=True))]
    sd = np.sqrt(np.diag(jacobian @ fit.covariance @ jacobian.T))[rows]
    return np.asarray((np.concatenate([fit.model.offset, (matrix / scale)[NINE]]) - truth) / sd)
