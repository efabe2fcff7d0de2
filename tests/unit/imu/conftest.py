from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mavcal.calib.recording import Channel, Sensor, Stage

G = 9.80665


@dataclass(frozen=True, eq=False)
class Unit:
    """A true inertial unit: ``corrected = C (m - b)``, the accelerometer's C symmetric."""

    accel_matrix: np.ndarray
    accel_offset: np.ndarray
    gyro_matrix: np.ndarray
    gyro_offset: np.ndarray


TRUE = Unit(
    np.array([[1.01, 0.006, -0.004], [0.006, 0.985, 0.008], [-0.004, 0.008, 1.004]]),
    np.array([0.3, -0.2, 0.15]),
    np.array([[1.01, 0.008, -0.006], [-0.004, 0.99, 0.01], [0.005, -0.007, 1.015]]),
    np.array([0.012, -0.008, 0.005]),
)


def _recorded(
    rng: np.random.Generator,
    *,
    attitudes: Rotation | None = None,
    poses: int = 16,
    hold: float = 2.0,
    move: float = 1.0,
    rate: float = 100.0,
    accel_sd: float = 0.03,
    gyro_sd: float = 0.003,
    unit: Unit = TRUE,
) -> tuple[Channel, Channel]:
    """Poses held still and smooth turns between them, in which a hand accelerates the unit too."""
    attitudes = Rotation.random(poses, random_state=rng) if attitudes is None else attitudes
    held, turning = int(hold * rate), int(move * rate)
    profile = 1.0 - np.cos(2.0 * np.pi * (np.arange(turning) + 0.5) / turning)
    profile *= rate / profile.sum()
    pieces = [np.zeros((held, 3))]
    for before, after in itertools.pairwise(attitudes):
        pieces += [np.outer(profile, (before.inv() * after).as_rotvec()), np.zeros((held, 3))]
    rates = np.vstack(pieces)
    halves = Rotation.from_rotvec(rates / (2.0 * rate)).as_matrix()
    body = attitudes[0].as_matrix()
    force = np.empty_like(rates)
    for k, half in enumerate(halves):
        body = body @ half
        force[k] = body.T @ [0.0, 0.0, -G]
        body = body @ half
    moving = np.abs(rates).sum(axis=1) > 0.0
    force[moving] += rng.normal(size=(int(moving.sum()), 3))
    accel = force @ np.linalg.inv(unit.accel_matrix).T + unit.accel_offset
    gyro = rates @ np.linalg.inv(unit.gyro_matrix).T + unit.gyro_offset
    t = np.arange(len(rates)) / rate
    noisy = (accel + accel_sd * rng.normal(size=accel.shape), gyro + gyro_sd * rng.normal(size=gyro.shape))
    return (
        Channel(Sensor.ACCEL, 0, t, noisy[0], "m/s2", Stage.RAW, "test"),
        Channel(Sensor.GYRO, 0, t, noisy[1], "rad/s", Stage.RAW, "test"),
    )


@pytest.fixture
def recorded() -> Callable[..., tuple[Channel, Channel]]:
    return _recorded


@pytest.fixture
def true_unit() -> Unit:
    return TRUE
