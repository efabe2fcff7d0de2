"""Means of the inertial units at rest with uncertainty and noise, a test of the rest, and readings for the record."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from mavcal.calib.errors import CalibError
from mavcal.calib.firmware import calibration_in_force, sensor_ids
from mavcal.calib.preflight.check import Snapshot
from mavcal.calib.preflight.history import calibrates_gyros, sensor_of
from mavcal.calib.preflight.limits import MOVING_FORCE, MOVING_RATE_DEG_S
from mavcal.calib.recording import Array, Channel, Recording, Sensor
from mavcal.calib.stats.quantisation import mean_of
from mavcal.calib.stats.windows import finite_rows, without_spikes

_BLOCK_S = 0.5
LEAST = 20
"""Least number of samples of a sensor."""


@dataclass(frozen=True, eq=False)
class Mean:
    """A sensor's mean (3,) over the capture, its standard deviations (3,), and the noise of a sample (3,)."""

    value: Array
    sd: Array
    noise: Array
    change: float
    """Largest difference of a half-second mean from the overall mean."""
    samples: int = 0
    seconds: float = 0.0
    """Length of the capture by the vehicle's clock."""

    @property
    def norm(self) -> float:
        """Length of the mean."""
        return float(np.linalg.norm(self.value))

    @property
    def norm_sd(self) -> float:
        """Standard deviation of the length: along the mean, or the total one if the mean is zero."""
        length = self.norm
        if length <= 3.0 * float(np.linalg.norm(self.sd)):
            return float(np.linalg.norm(self.sd))
        return float(np.linalg.norm(self.sd * self.value / length))


@dataclass(frozen=True)
class Silent:
    """A sensor with too few samples."""

    why: str


def mean_at_rest(recording: Recording, sensor: Sensor, instance: int) -> Mean | Silent:
    """Mean of one sensor over the capture."""
    found = [c for c in recording.find(sensor, instance) if len(c)]
    if not found:
        return Silent(f"{sensor} {instance + 1} was not heard")
    channel = recording.channel(sensor, instance)
    channel = channel.take(finite_rows(channel.values))
    channel = channel.take(without_spikes(channel.values))
    if len(channel) < LEAST:
        return Silent(f"only {len(channel)} samples of {sensor} {instance + 1} came")
    fitted = mean_of(channel)
    sd = np.sqrt(np.diag(fitted.covariance))
    span = float(channel.t[-1] - channel.t[0])
    return Mean(fitted.mean, sd, fitted.sd, _change(channel), len(channel), span)


def evidence_lines(means: Mapping[int, Mean], what: str) -> tuple[str, ...]:
    """Samples of each sensor, as lines of evidence."""
    return tuple(f"{what} {i + 1}: {m.samples} samples over {m.seconds:.1f} s" for i, m in sorted(means.items()))


def moved(gyros: Mapping[int, Mean], accels: Mapping[int, Mean]) -> str | None:
    """Movement during the capture; None: it was a rest. Movement on one of several units alone is that unit's fault."""
    rate = min((math.degrees(m.change) for m in gyros.values()), default=0.0)
    force = min((m.change for m in accels.values()), default=0.0)
    if rate > MOVING_RATE_DEG_S:
        return f"the vehicle was moved: its rate changed by {rate:.1f} deg/s meanwhile"
    if force > MOVING_FORCE:
        return f"the vehicle was moved or shaken: its specific force changed by {force:.2f} m/s2 meanwhile"
    return None


def _change(channel: Channel) -> float:
    """Largest distance of a block's mean from the whole mean."""
    return float(np.linalg.norm(block_means(channel) - channel.values.mean(axis=0), axis=1).max())


def block_means(channel: Channel) -> Array:
    """Means (M, k) over blocks of half a second; blocks with few samples are left out."""
    blocks = np.floor((channel.t - channel.t[0]) / _BLOCK_S).astype(int)
    counts = np.bincount(blocks)
    sums = np.stack([np.bincount(blocks, weights=column) for column in channel.values.T], axis=1)
    full = counts >= 0.5 * np.median(counts[counts > 0])
    return np.asarray(sums[full] / counts[full][:, None])


Triple = tuple[float, float, float]


@dataclass(frozen=True)
class RestReading:
    """One unit at rest. `value` and `sd` are of a corrected sample's mean, in rad/s or m/s2, body frame."""

    sensor: Sensor
    instance: int
    device_id: int
    temperature: float | None
    """degC; None: not known."""
    value: Triple
    sd: Triple
    bias: Triple | None
    """A gyroscope's raw bias: what it read without the calibration in force. None: an accelerometer, or not known."""
    by_itself: bool
    """Whether the vehicle calibrates it by itself."""

    @property
    def norm(self) -> float:
        """Norm of the rate or of the specific force."""
        return float(np.linalg.norm(self.value))


def rest_readings(snapshot: Snapshot) -> tuple[RestReading, ...]:
    """Every gyroscope and accelerometer whose device id is known; none if the vehicle was moved."""
    try:
        ids = sensor_ids(snapshot.identity.autopilot, snapshot.parameters)
    except CalibError:
        return ()
    means: dict[tuple[Sensor, int], Mean] = {
        (sensor, instance): mean
        for sensor, instance in ids
        if sensor in (Sensor.GYRO, Sensor.ACCEL)
        and not isinstance(mean := mean_at_rest(snapshot.recording, sensor, instance), Silent)
    }
    if moved(_of(means, Sensor.GYRO), _of(means, Sensor.ACCEL)) is not None:
        return ()
    warm = {instance: _temperature(snapshot.recording, instance) for _, instance in means}
    return tuple(
        RestReading(
            sensor,
            instance,
            ids[sensor, instance],
            warm[instance],
            _triple(mean.value),
            _triple(mean.sd),
            _raw(snapshot, sensor, instance, mean, warm[instance]),
            sensor == Sensor.GYRO and calibrates_gyros(snapshot.identity.autopilot or "", snapshot.parameters),
        )
        for (sensor, instance), mean in sorted(means.items())
    )


def _of(means: Mapping[tuple[Sensor, int], Mean], sensor: Sensor) -> dict[int, Mean]:
    return {instance: mean for (of, instance), mean in means.items() if of == sensor}


def _raw(snapshot: Snapshot, sensor: Sensor, instance: int, mean: Mean, at: float | None) -> Triple | None:
    calibrated_meanwhile = any(sensor_of(name) == sensor for name in snapshot.rewritten)
    if sensor != Sensor.GYRO or calibrated_meanwhile:
        return None
    try:
        model = calibration_in_force(snapshot.identity.autopilot, snapshot.parameters, sensor, instance)
        return _triple(model.invert(mean.value, at))
    except CalibError:
        return None


def _temperature(recording: Recording, instance: int) -> float | None:
    found = recording.find(Sensor.TEMPERATURE, instance)
    return float(np.median(found[0].values[:, 0])) if found and len(found[0]) else None


def _triple(values: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> Triple:
    x, y, z = (float(v) for v in values)
    return x, y, z
