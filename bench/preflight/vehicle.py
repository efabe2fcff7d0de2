"""A simulated vehicle at rest, as a preflight sees it: streams, parameters, history, its own view.

The sensors are drawn with what a good calibration leaves over. A fault changes the vehicle before it is read.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mavcal.calib import STANDARD_GRAVITY
from mavcal.calib.earth import EarthField, earth_field
from mavcal.calib.firmware.names import (
    OFFSET,
    Role,
    ardupilot_compass_names,
    ardupilot_imu_names,
    px4_names,
)
from mavcal.calib.firmware.plan import Value
from mavcal.calib.firmware.stream.messages import CDEGC, MG, MGAUSS_UT, MRAD_S
from mavcal.calib.preflight.snapshot import OwnView, Shaking, Snapshot, VerifiedCalibration
from mavcal.calib.recording import Channel, Identity, Recording, Rounding, Sensor, Stage

Array = NDArray[np.float64]

SECONDS = 6.0
NOW = 1798000000.0  # December 2026
YEAR = 2026.95
DAY_S = 86400.0

# Residual of a calibration per axis (1 sd), and the noise of a sample.
GYRO_LEFT, ACCEL_LEFT, MAG_LEFT = np.radians(0.05), 0.015, 0.4
GLUED = np.radians(0.1)
GYRO_NOISE, ACCEL_NOISE, MAG_NOISE = 1e-3, 0.02, 0.2
LEAST_LEVEL_FIELD = 15.0
"""uT: nearer to a magnetic pole a heading cannot be checked to 10 deg."""
QUIET = Shaking((0.1, 0.1, 0.1), (0, 0, 0))


@dataclass
class BenchVehicle:
    """Everything that a fault may change; the errors are of the corrected readings, in the body frame."""

    rng: np.random.Generator
    autopilot: str
    field: EarthField
    place: tuple[float, float, float]
    body_from_ned: Array
    gyro_errors: list[Array]
    accel_errors: list[Array]
    mag_errors: list[Array]
    mag_turns: list[Array]
    temperatures: list[float]
    parameters: dict[str, Value]
    verified: VerifiedCalibration
    uid: str = "0badcafe"
    shaking: Shaking = QUIET
    rattle: float = 0.0
    """Standard deviation that vibration adds to a sample of the accelerometer, m/s2."""
    texts: tuple[str, ...] = ()
    _channels: list[Channel] = dataclasses.field(default_factory=list)

    @property
    def imus(self) -> int:
        """How many inertial units it has."""
        return len(self.accel_errors)

    def snapshot(self) -> Snapshot:
        """Six seconds of it."""
        force = self.body_from_ned @ np.array([0.0, 0.0, -STANDARD_GRAVITY])
        earth = self.body_from_ned @ self.field.north_east_down
        for i in range(self.imus):
            shaken = 0.02 * self.rattle  # rad/s for a m/s2
            self._add(Sensor.ACCEL, i, force + self.accel_errors[i], np.hypot(ACCEL_NOISE, self.rattle), 50.0, MG)
            self._add(Sensor.GYRO, i, self.gyro_errors[i], np.hypot(GYRO_NOISE, shaken), 50.0, MRAD_S)
            self._add(Sensor.TEMPERATURE, i, np.array([self.temperatures[i]]), 0.05, 50.0, CDEGC)
        rate = 10.0 if self.autopilot == "ardupilot" else 50.0
        for i, error in enumerate(self.mag_errors):
            self._add(Sensor.MAG, i, self.mag_turns[i] @ earth + error, MAG_NOISE, rate, MGAUSS_UT)
        self._add(Sensor.ATTITUDE, 0, _quaternion(self.body_from_ned.T), 1e-3, 10.0, 0.0)
        self._add(Sensor.POSITION, 0, np.array(self.place), 0.0, 1.0, 0.0)
        return Snapshot(
            Recording(tuple(self._channels)),
            Identity(self.autopilot, uid=self.uid, firmware=(4, 6, 0)),
            self.parameters,
            NOW,
            (self.verified,),
            self.shaking,
            OwnView(present=True, ready=not self.texts, asked=True, texts=self.texts, calibrating=False),
            current_known=True,
        )

    def _add(self, sensor: Sensor, i: int, value: Array, noise: float, rate: float, quantum: float) -> None:
        t = np.arange(0.0, SECONDS, 1.0 / rate)
        values = value + self.rng.normal(0.0, noise, (len(t), len(value)))
        zero_bin = None
        if quantum > 0.0:
            whole = np.trunc(values / quantum)
            zero_bin, values = whole == 0.0, quantum * (whole + 0.5 * np.sign(whole))
        rounding = Rounding.TOWARD_ZERO if quantum > 0.0 else Rounding.NONE
        channel = Channel(sensor, i, t, values, "", Stage.CORRECTED, "bench", quantum, rounding, zero_bin)
        self._channels.append(channel)


def healthy(seed: int, *, redundant: bool = False) -> BenchVehicle:
    """A good vehicle somewhere on Earth; `redundant`: with two of everything at least."""
    rng = np.random.default_rng([2026, seed])
    autopilot = ("ardupilot", "px4")[seed % 2]
    least = 2 if redundant else 1
    imus, mags = int(rng.integers(least, 4)), int(rng.integers(least, 4))
    field_, place = _somewhere(rng)
    parameters = _parameters(rng, autopilot, imus, mags)
    covered = _calibration_temperature(parameters, autopilot)
    temperatures = [float(rng.uniform(covered - 15.0, covered + 15.0)) + float(rng.uniform(-1, 1)) for _ in range(imus)]
    ids = _ids(autopilot, imus, mags)
    then = NOW - float(rng.uniform(1.0, 200.0)) * DAY_S
    sensors = frozenset({Sensor.ACCEL, Sensor.GYRO, Sensor.MAG})
    at = dict.fromkeys(range(imus), covered)
    return BenchVehicle(
        rng,
        autopilot,
        field_,
        place,
        rotation(rng, np.radians(4.0)) @ _about_down(float(rng.uniform(-np.pi, np.pi))).T,
        [rng.normal(0.0, GYRO_LEFT, 3) for _ in range(imus)],
        [rng.normal(0.0, np.hypot(ACCEL_LEFT, GLUED * STANDARD_GRAVITY), 3) for _ in range(imus)],
        [rng.normal(0.0, MAG_LEFT, 3) for _ in range(mags)],
        [rotation(rng, GLUED * 3.0) for _ in range(mags)],
        temperatures,
        parameters,
        VerifiedCalibration("job", then, sensors, ids, dict(parameters), at, "0badcafe"),
    )


def rotation(rng: np.random.Generator, sd: float) -> Array:
    """A turn about a random axis by a random angle."""
    return about(rng.normal(size=3), float(rng.normal(0.0, sd)))


def about(axis: Array, angle: float) -> Array:
    """A turn about `axis` by `angle` (rad)."""
    x, y, z = axis / np.linalg.norm(axis)
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + np.sin(angle) * K + (1.0 - np.cos(angle)) * K @ K)


def _about_down(yaw: float) -> Array:
    return about(np.array([0.0, 0.0, 1.0]), yaw)


def _somewhere(rng: np.random.Generator) -> tuple[EarthField, tuple[float, float, float]]:
    while True:
        latitude = float(np.degrees(np.arcsin(rng.uniform(-0.94, 0.94))))
        place = latitude, float(rng.uniform(-180.0, 180.0)), float(rng.uniform(0.0, 2000.0))
        found = earth_field(*place, YEAR)
        if found.horizontal > LEAST_LEVEL_FIELD:
            return found, place


def _quaternion(matrix: Array) -> Array:
    w = 0.5 * np.sqrt(max(1.0 + np.trace(matrix), 1e-12))
    odd = matrix - matrix.T
    vector = np.array([odd[2, 1], odd[0, 2], odd[1, 0]]) / (4.0 * w)
    q = np.concatenate([[w], vector])
    return np.asarray(q / np.linalg.norm(q))


def _ids(autopilot: str, imus: int, mags: int) -> dict[str, int]:
    base = 2753028 if autopilot == "ardupilot" else 1310988
    ids = {f"accel{i}": base + 8 * i for i in range(imus)} | {f"gyro{i}": base + 8 * i - 256 for i in range(imus)}
    return ids | {f"mag{i}": 97539 + 256 * i for i in range(mags)}


def _parameters(rng: np.random.Generator, autopilot: str, imus: int, mags: int) -> dict[str, Value]:
    ids = _ids(autopilot, imus, mags)
    found: dict[str, Value] = (
        {"ARMING_CHECK": 1, "INS_GYR_CAL": 1}
        if autopilot == "ardupilot"
        else {
            "COM_ARM_MAG_STR": 2,
            "IMU_GYRO_CAL_EN": 1,
        }
    )
    thermal = bool(rng.integers(0, 2))
    caltemp = float(rng.uniform(15.0, 35.0))
    for sensor, count in ((Sensor.ACCEL, imus), (Sensor.GYRO, imus), (Sensor.MAG, mags)):
        for i in range(count):
            names = _names(autopilot, sensor, i)
            found[names[Role.ID]] = ids[f"{sensor}{i}"]
            size = {Sensor.ACCEL: 0.2, Sensor.GYRO: 0.01, Sensor.MAG: 80.0 if autopilot == "ardupilot" else 0.08}
            found |= {names[role]: float(np.float32(rng.normal(0.0, size[sensor]))) for role in OFFSET}
            if Role.TEMPERATURE in names:
                found[names[Role.TEMPERATURE]] = caltemp
            if thermal and Role.THERMAL_ENABLE in names:
                found |= {names[Role.THERMAL_ENABLE]: 1}
                found |= {names[Role.THERMAL_MIN]: caltemp - 25.0, names[Role.THERMAL_MAX]: caltemp + 25.0}
    return found


def _names(autopilot: str, sensor: Sensor, i: int) -> dict[Role, str]:
    if autopilot == "px4":
        return dict(px4_names(sensor, i))
    return dict(ardupilot_compass_names(i, i) if sensor == Sensor.MAG else ardupilot_imu_names(sensor, i))


def _calibration_temperature(parameters: dict[str, Value], autopilot: str) -> float:
    return float(parameters["INS_ACC1_CALTEMP"]) if autopilot == "ardupilot" else 25.0
