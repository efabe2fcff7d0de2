from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import click
import numpy as np
import pytest
from click.testing import CliRunner, Result
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from mavcal.calib.recording import Channel, Recording, Rounding, Sensor, Stage

G = 9.80665
FACES = (
    Rotation.identity(),
    Rotation.from_euler("x", 180, degrees=True),
    Rotation.from_euler("x", 90, degrees=True),
    Rotation.from_euler("x", -90, degrees=True),
    Rotation.from_euler("y", 90, degrees=True),
    Rotation.from_euler("y", -90, degrees=True),
)


@pytest.fixture(autouse=True)
def _help_option_is_forgotten(monkeypatch: pytest.MonkeyPatch) -> None:
    """A command keeps the help option of its first run: one that was run alone would not know ``-h`` afterwards."""
    invoke = CliRunner.invoke

    def invoked(self: CliRunner, command: click.Command, *arguments: Any, **options: Any) -> Result:
        try:
            return invoke(self, command, *arguments, **options)
        finally:
            command._help_option = None

    monkeypatch.setattr(CliRunner, "invoke", invoked)


def channel(
    sensor: Sensor, t: np.ndarray, values: np.ndarray, unit: str, *, quantum: float = 0.0, instance: int = 0
) -> Channel:
    """A raw channel, truncated toward zero to `quantum` if there is one."""
    if quantum == 0.0:
        return Channel(sensor, instance, t, values, unit, Stage.RAW, "test")
    k = np.trunc(values / quantum)
    middle = (k + 0.5 * np.sign(k)) * quantum
    return Channel(
        sensor, instance, t, middle, unit, Stage.RAW, "test", quantum, Rounding.TOWARD_ZERO, zero_bin=np.asarray(k == 0)
    )


def _held(attitudes: Sequence[Rotation], hold: float, transition: float, dt: float) -> Rotation:
    """Attitudes held in turn, with smooth turns between them."""
    pieces = []
    for i, attitude in enumerate(attitudes):
        pieces.append(np.repeat(attitude.as_quat()[None], int(hold / dt), axis=0))
        if i + 1 < len(attitudes):
            s = np.linspace(0.0, 1.0, int(transition / dt))
            turn = (attitude.inv() * attitudes[i + 1]).as_rotvec()
            pieces.append((attitude * Rotation.from_rotvec((s * s * (3 - 2 * s))[:, None] * turn)).as_quat())
    return Rotation.from_quat(np.concatenate(pieces))


def make_poses(
    rng: np.random.Generator,
    *,
    oblique: int = 4,
    tilt_deg: float = 3.0,
    tremor_deg: float = 0.2,
    hold: float = 3.0,
    rate: float = 50.0,
    accel_noise: float = 0.02,
    gyro_noise: float = 0.001,
    accel_offset: Sequence[float] = (0.3, -0.2, 0.15),
    accel_matrix: np.ndarray | None = None,
    gyro_offset: Sequence[float] = (0.013, -0.008, 0.005),
    quantised: bool = True,
) -> Recording:
    """Six faces and oblique poses held by hand: `accel_matrix` takes truth to the sensor, offsets are added."""
    attitudes = [Rotation.from_euler("xy", rng.normal(0.0, tilt_deg, 2), degrees=True) * face for face in FACES]
    attitudes += [Rotation.from_quat(q / np.linalg.norm(q)) for q in rng.normal(size=(oblique, 4))]
    fine = 4
    dt = 1.0 / (rate * fine)
    attitude = _held(attitudes, hold, 1.5, dt)
    smooth = np.exp(-2 * np.pi * 2.0 * dt)
    tremor = lfilter([1 - smooth], [1, -smooth], rng.normal(size=(len(attitude), 3)), axis=0)
    tremor = lfilter([1 - smooth], [1, -smooth], tremor, axis=0)
    attitude = attitude * Rotation.from_rotvec(tremor * np.radians(tremor_deg) / max(tremor.std(), 1e-12))
    rows = np.arange(fine, len(attitude) - fine, fine)
    rates = (attitude[rows - fine // 2].inv() * attitude[rows + fine // 2]).as_rotvec() / (fine * dt)
    force = attitude[rows].inv().apply([0.0, 0.0, -G])
    M = np.eye(3) if accel_matrix is None else accel_matrix
    accel = force @ M.T + accel_offset + accel_noise * rng.normal(size=force.shape)
    gyro = rates + gyro_offset + gyro_noise * rng.normal(size=force.shape)
    t = rows * dt
    return Recording(
        (
            channel(Sensor.ACCEL, t, accel, "m/s2", quantum=1e-3 * G if quantised else 0.0),
            channel(Sensor.GYRO, t, gyro, "rad/s", quantum=1e-3 if quantised else 0.0),
        )
    )


@pytest.fixture(scope="session")
def held_poses() -> Callable[..., Recording]:
    """:func:`make_poses`."""
    return make_poses


@pytest.fixture(scope="session")
def raw_channel() -> Callable[..., Channel]:
    """:func:`channel`."""
    return channel
