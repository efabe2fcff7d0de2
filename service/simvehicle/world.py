"""The physical vehicle: motion, temperature, motor current, and the raw readings of its sensors."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from mavcal.service.simvehicle.config import VehicleConfig
from mavcal.service.simvehicle.motion import CurrentMotion
from mavcal.service.simvehicle.mounting import true_mounting
from mavcal.service.simvehicle.rotation import Array, body_from_ned, mounting_matrix
from mavcal.service.simvehicle.truth import SensorTruth, draw_truth

HORIZON_S = 14400
"""Time from which the random walk of a bias is constant, s."""


@dataclass(frozen=True)
class Curve:
    """T(t) = end − (end − start)·exp(−(t − t0)/tau): a warm-up; constant where start equals end. Units °C and s."""

    start: float
    end: float
    tau: float = 60.0
    t0: float = 0.0

    def at(self, t: Array) -> Array:
        """Temperature at vehicle times t (N,)."""
        elapsed = np.maximum(t - self.t0, 0.0)
        return np.asarray(self.end - (self.end - self.start) * np.exp(-elapsed / self.tau))


class Thermal:
    """The board's temperature, and each IMU's own: an offset, and a lag of first order where configured."""

    def __init__(self, start: float, offsets: Array, lag_s: float = 0.0) -> None:
        self._curve = Curve(start, start)
        self._offsets = offsets
        self._lag = lag_s
        self._lagged = start
        self._lagged_at = 0.0

    def board(self, t: Array) -> Array:
        """Board temperature at times t, °C."""
        return self._curve.at(t)

    def imu(self, instance: int, t: Array) -> Array:
        """Temperature of one IMU at times t, °C."""
        return np.asarray(self._core(t) + self._offsets[instance])

    def _core(self, t: Array) -> Array:
        if self._lag <= 0:
            return self._curve.at(t)
        # Response of a first-order lag to an exponential: exact, from the state kept at the last change of curve.
        c, dt = self._curve, np.maximum(t - self._lagged_at, 0.0)
        span = c.start - c.end
        if abs(c.tau - self._lag) < 1e-9:
            forced = span * (dt / self._lag) * np.exp(-dt / self._lag)
        else:
            forced = span * c.tau / (c.tau - self._lag) * (np.exp(-dt / c.tau) - np.exp(-dt / self._lag))
        return np.asarray(c.end + forced + (self._lagged - c.end) * np.exp(-dt / self._lag))

    def warm_up(self, t: float, start: float, end: float, tau_s: float) -> None:
        """Begin a warm-up curve now; every IMU that lags keeps the temperature it has."""
        self._remember(t)
        self._curve = Curve(start, end, max(tau_s, 1e-6), t)

    def hold(self, t: float, value: float) -> None:
        """Hold the board at this temperature from now on."""
        self._remember(t)
        self._curve = Curve(value, value, t0=t)

    def _remember(self, t: float) -> None:
        self._lagged, self._lagged_at = float(self._core(np.array([t]))[0]), t

    def restart(self, elapsed: float) -> None:
        """Vehicle time begins again at zero after `elapsed` seconds; the temperature goes on."""
        c = self._curve
        self._curve = Curve(c.start, c.end, c.tau, c.t0 - elapsed)
        self._lagged_at -= elapsed


@dataclass
class RandomWalk:
    """A random walk (3,) in time: zero at first, one standard deviation a root second; the same however often read."""

    rng: np.random.Generator
    _elapsed: float = 0.0
    _walk: Array = field(init=False)

    def __post_init__(self) -> None:
        self._walk = np.vstack([np.zeros(3), np.cumsum(self.rng.normal(size=(HORIZON_S, 3)), axis=0)])

    def __call__(self, t: Array) -> Array:
        """The walk (N, 3) at vehicle times (N,), straight between whole seconds."""
        since = t + self._elapsed
        return np.column_stack([np.interp(since, np.arange(HORIZON_S + 1), axis) for axis in self._walk.T])

    def restart(self, elapsed: float) -> None:
        """Vehicle time begins again at zero after `elapsed` seconds; the bias goes on."""
        self._elapsed += elapsed


@dataclass
class Ramp:
    """A quantity that changes linearly to its new value."""

    value: float = 0.0
    start_value: float = 0.0
    start: float = 0.0
    duration: float = 0.0

    def at(self, t: Array) -> Array:
        """The value at times t (N,)."""
        if self.duration <= 0:
            return np.full(len(t), self.value)
        x = np.clip((t - self.start) / self.duration, 0.0, 1.0)
        return np.asarray(self.start_value + (self.value - self.start_value) * x)

    def go(self, t: float, value: float, ramp_s: float = 0.0) -> None:
        """Move to a new value from now on."""
        self.start_value = float(self.at(np.array([t]))[0])
        self.value, self.start, self.duration = value, t, ramp_s

    def restart(self, elapsed: float) -> None:
        """Vehicle time begins again at zero after `elapsed` seconds."""
        self.start -= elapsed


@dataclass
class VibrationState:
    """Vibration levels and clipping counts that the vehicle reports."""

    level: float = 0.1  # m/s²
    clips: int = 0  # of the first accelerometer since the start


WALK_PER_NOISE = 1.7e-3
"""Random walk of a bias in a root second, relative to the white noise of a sample at 50 Hz. The two are equal in the
Allan deviation at sqrt(3) N/K = 144 s, as is usual for small MEMS."""


@dataclass(frozen=True)
class MotionState:
    """True attitude (N, 4), body rate (N, 3) and body specific force (N, 3) at times (N,)."""

    t: Array
    q: Array
    rate: Array
    force: Array


@dataclass(frozen=True)
class ImuReading:
    """Corrected accelerometer and gyroscope (N, 3) in the body frame, and temperature (N,)."""

    accel: Array
    gyro: Array
    temperature: Array


class SimWorld:
    """Truth, motion, temperature and motors of one vehicle, and the raw readings that follow from them."""

    def __init__(self, config: VehicleConfig) -> None:
        self.config = config
        self.truth = draw_truth(config)
        self.motion = CurrentMotion(np.random.default_rng([config.seed, 1]), config.yaw_deg)
        self.thermal = Thermal(config.temperature, np.asarray(config.imu_temperature_offsets), config.temperature_lag_s)
        self.throttle = Ramp()
        self.current = Ramp()
        self.shaking = VibrationState()
        self.added: dict[tuple[str, int], Array] = {}
        """Offset that a fault adds to a reading, in the sensor's frame, by "accels", "gyros" or "mags" and instance."""
        self.bends: dict[int, Array] = {}
        """Rotation of a compass in the body frame by a bent mount."""
        self.field = np.asarray(config.field_ned_ut)
        self.gravity = np.array([0.0, 0.0, -config.gravity])
        self.sensor_from_body = mounting_matrix(config.board_orientation).T
        self.mag_from_body = tuple(true_mounting(config, k).T for k in range(config.mag_count))
        self._noise = np.random.default_rng([config.seed, 2])
        self._wander = {
            (truths, k): RandomWalk(np.random.default_rng([config.seed, 3, j, k]))
            for j, truths in enumerate(("accels", "gyros"))
            for k in range(config.imu_count)
        }

    def state(self, t: Array) -> MotionState:
        """The exact state at ascending times."""
        q, rate = self.motion.evaluate(t)
        force = body_from_ned(q, self.gravity) + self.motion.linear_acceleration(t)
        return MotionState(t, q, rate, force)

    def temperature_read(self, instance: int, t: Array) -> Array:
        """Temperature that the driver of an IMU reports: that of its last reading."""
        period = self.config.temperature_period_s
        read_at = t if period <= 0 else np.floor(t / period) * period
        return self.thermal.imu(instance, read_at)

    def accel(self, instance: int, state: MotionState, noise_scale: float = 1.0) -> Array:
        """Raw accelerometer (N, 3), m/s², in the sensor's frame."""
        return self._inertial("accels", instance, state.force, state.t, noise_scale)

    def gyro(self, instance: int, state: MotionState, noise_scale: float = 1.0) -> Array:
        """Raw gyroscope (N, 3), rad/s, in the sensor's frame."""
        return self._inertial("gyros", instance, state.rate, state.t, noise_scale)

    def bias(self, kind: str, instance: int, t: Array) -> Array:
        """Offset (N, 3) of one of the "accels" or "gyros" at times (N,): the one drawn, and what it wandered since."""
        truth: SensorTruth = getattr(self.truth, kind)[instance]
        return np.asarray(truth.offset + self._wandered(kind, instance, t))

    def _wandered(self, kind: str, instance: int, t: Array) -> Array:
        truth: SensorTruth = getattr(self.truth, kind)[instance]
        return np.asarray(truth.noise * WALK_PER_NOISE * self._wander[kind, instance](t))

    def _inertial(self, kind: str, instance: int, body: Array, t: Array, noise_scale: float) -> Array:
        truth: SensorTruth = getattr(self.truth, kind)[instance]
        raw = truth.distort(body @ self.sensor_from_body.T, self.thermal.imu(instance, t))
        raw = raw + self.added.get((kind, instance), 0.0)
        return raw + self._wandered(kind, instance, t) + self._noise.normal(0.0, truth.noise * noise_scale, raw.shape)

    def mag(self, instance: int, field_body: Array, t: Array) -> Array:
        """Raw magnetometer (N, 3), µT, in the chip's frame, from the Earth field in the body frame."""
        truth = self.truth.mags[instance]
        if instance in self.bends:
            field_body = field_body @ self.bends[instance].T
        raw = truth.distort(field_body @ self.mag_from_body[instance].T) + self.added.get(("mags", instance), 0.0)
        raw = raw + self.current.at(t)[:, None] * truth.motor
        return raw + self._noise.normal(0.0, truth.noise, raw.shape)

    def restart(self, elapsed: float) -> None:
        """The firmware reboots and its clock begins again at zero; the physical world goes on."""
        self.motion.restart(elapsed)
        for wander in self._wander.values():
            wander.restart(elapsed)
        self.thermal.restart(elapsed)
        self.throttle.restart(elapsed)
        self.current.restart(elapsed)
