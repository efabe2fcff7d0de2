"""A small bench in numpy: a vehicle that is held, turned and warmed, with sensors of known truth."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from mavcal.calib.recording import Channel, Recording, Rounding, Sensor, Stage

G = 9.80665
FIELD = np.array([20.5, 1.2, 44.0])  # north east down, uT
FACES = {
    "level": (0.0, 0.0, 0.0),
    "left": (-90.0, 0.0, 0.0),
    "right": (90.0, 0.0, 0.0),
    "nose_down": (0.0, -90.0, 0.0),
    "nose_up": (0.0, 90.0, 0.0),
    "back": (180.0, 0.0, 0.0),
}


def attitude(roll: float, pitch: float, yaw: float = 0.0) -> Rotation:
    """Body to north-east-down, deg."""
    return Rotation.from_euler("ZYX", [yaw, pitch, roll], degrees=True)


@dataclass(frozen=True)
class Truth:
    """measured = sensitivity @ truth + offset + noise + sum_j thermal[:, j] (T - 35)^(j+1)"""

    offset: Sequence[float] = (0.0, 0.0, 0.0)
    sensitivity: np.ndarray = field(default_factory=lambda: np.eye(3))
    noise: float = 0.01
    thermal: np.ndarray = field(default_factory=lambda: np.zeros((3, 1)))
    quantum: float = 0.0

    def measure(self, truth: np.ndarray, temperature: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        d = temperature[:, None] - 35.0
        warm = sum(self.thermal[:, j] * d ** (j + 1) for j in range(self.thermal.shape[1]))
        return truth @ self.sensitivity.T + self.offset + warm + rng.normal(0.0, self.noise, truth.shape)


ACCEL = Truth((0.31, -0.22, 0.17), np.diag([0.98, 1.015, 0.99]), noise=0.02)
GYRO = Truth((0.0132, -0.0084, 0.0057), noise=0.001)
MAG = Truth((9.0, -5.5, 3.5), np.array([[1.06, 0.03, -0.02], [0.03, 0.95, 0.015], [-0.02, 0.015, 1.03]]), noise=0.2)


@dataclass
class Bench:
    """Attitude over time at 200 Hz; `record` turns it into a recording."""

    accels: tuple[Truth, ...] = (ACCEL,)
    gyros: tuple[Truth, ...] = (GYRO,)
    mags: tuple[Truth, ...] = (MAG,)
    rate: float = 50.0
    seed: int = 1
    start: float = 100.0
    temperature: Callable[[np.ndarray], np.ndarray] = lambda t: np.full(len(t), 35.0)
    field_ned: np.ndarray = field(default_factory=lambda: FIELD.copy())
    _parts: list[Rotation] = field(default_factory=list)
    _step: float = 1.0 / 200.0

    @property
    def now(self) -> float:
        return self.start + sum(len(p) for p in self._parts) * self._step

    @property
    def _last(self) -> Rotation:
        return self._parts[-1][-1] if self._parts else attitude(0.0, 0.0)

    def hold(self, seconds: float, pose: Rotation | None = None, *, tremor: float = 0.0, move: float = 1.5) -> Bench:
        """Turn to `pose` within `move` seconds, then hold it with a tremor of that many degrees rms."""
        rng = np.random.default_rng([self.seed, len(self._parts)])
        if pose is not None and self._parts:
            self._turn_to(pose, move)
        pose = pose or self._last
        n = round(seconds / self._step)
        t = np.arange(n) * self._step
        shake = np.zeros((n, 3))
        for f in (1.0, 1.7, 2.6):
            shake += np.radians(tremor) / np.sqrt(1.5) * np.sin(2 * np.pi * (f * t[:, None] + rng.random(3)))
        self._parts.append(pose * Rotation.from_rotvec(shake))
        return self

    def turn(self, seconds: float, rate_dps: Sequence[float]) -> Bench:
        """Turn at a steady body rate."""
        n = round(seconds / self._step)
        angles = np.outer(np.arange(1, n + 1) * self._step, np.radians(rate_dps))
        self._parts.append(self._last * Rotation.from_rotvec(angles))
        return self

    def tumble(self, seconds: float, rate_dps: float = 40.0) -> Bench:
        """Turn about three axes at once, so that every direction comes by."""
        n = round(seconds / self._step)
        angles = np.outer(np.arange(1, n + 1) * self._step, np.array([0.59, 0.47, 0.66]) * rate_dps)
        self._parts.append(self._last * Rotation.from_euler("ZYX", angles, degrees=True))
        return self

    def _turn_to(self, pose: Rotation, seconds: float) -> None:
        n = round(seconds / self._step)
        s = np.linspace(0.0, 1.0, n)
        smooth = s * s * (3 - 2 * s)
        both = Rotation.concatenate([self._last, pose])
        self._parts.append(Slerp([0.0, 1.0], both)(smooth))

    def record(self) -> Recording:
        rng = np.random.default_rng([self.seed, 99])
        path = Rotation.concatenate(self._parts)
        t = self.start + np.arange(len(path)) * self._step
        every = round(1.0 / self.rate / self._step)
        body = path.inv()
        force = body.apply([0.0, 0.0, -G])
        rates = np.zeros((len(path), 3))
        rates[1:] = (path[:-1].inv() * path[1:]).as_rotvec() / self._step
        field_b = body.apply(self.field_ned)
        temperature = self.temperature(t)
        channels = []
        for sensor, truths, values, unit in (
            (Sensor.ACCEL, self.accels, force, "m/s2"),
            (Sensor.GYRO, self.gyros, rates, "rad/s"),
        ):
            for i, truth in enumerate(truths):
                measured = truth.measure(values[::every], temperature[::every], rng)
                channels.append(_channel(sensor, i, t[::every], measured, unit, truth.quantum))
        for i, truth in enumerate(self.mags):
            n = len(t) // 20
            mean = field_b[: n * 20].reshape(n, 20, 3).mean(axis=1)
            times = t[19 : n * 20 : 20]
            measured = truth.measure(mean, temperature[19 : n * 20 : 20], rng)
            channels.append(_channel(Sensor.MAG, i, times, measured, "uT", truth.quantum))
        for i in range(len(self.accels)):
            second = slice(None, None, 200)
            channels.append(
                Channel(Sensor.TEMPERATURE, i, t[second], temperature[second][:, None], "degC", Stage.RAW, f"S{i}")
            )
        return Recording(tuple(channels))


def _channel(sensor: Sensor, i: int, t: np.ndarray, values: np.ndarray, unit: str, quantum: float) -> Channel:
    zero, rounding = None, Rounding.NONE
    if quantum:
        k = np.trunc(values / quantum)
        values = (k + 0.5 * np.sign(k)) * quantum
        zero, rounding = k == 0, Rounding.TOWARD_ZERO
    return Channel(sensor, i, t, values, unit, Stage.RAW, f"S{i}", quantum, rounding, zero)


def _chunks(recording: Recording, cuts: Sequence[float]) -> Iterator[Recording]:
    edges = [-np.inf, *sorted(cuts), np.inf]
    for a, b in itertools.pairwise(edges):
        yield recording.between(a, b)


@pytest.fixture
def bench() -> type[Bench]:
    return Bench


@pytest.fixture
def chunks() -> Callable[[Recording, Sequence[float]], Iterator[Recording]]:
    return _chunks


@pytest.fixture
def with_channel() -> Callable[..., Recording]:
    def change(recording: Recording, sensor: Sensor, instance: int, **fields: object) -> Recording:
        return recording.with_channels(
            replace(c, **fields) if (c.sensor, c.instance) == (sensor, instance) else c for c in recording.channels
        )

    return change
