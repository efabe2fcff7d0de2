"""A simulated vehicle at rest, as a preflight sees it: streams, parameters, history, its own view.

The sensors are drawn with what a good calibration leaves over. A fault changes the vehicle before it is read.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mavcal.calib import STANDARD_GRAVITY
from mavcal.calib.earth import EarthField, earth_field
from mavcal.calib.firmware.names import (
    OFFSET,
    PX4_SLOTS,
    Role,
    ardupilot_compass_names,
    ardupilot_imu_names,
    px4_names,
)
from mavcal.calib.firmware.plan import Value
from mavcal.calib.firmware.stream.messages import CDEGC, MG, MGAUSS_UT, MRAD_S
from mavcal.calib.preflight.check import OwnView, Shaking, Snapshot, VerifiedCalibration
from mavcal.calib.recording import Channel, Identity, Recording, Rounding, Sensor, Stage

Array = NDArray[np.float64]

SECONDS, STILL_SECONDS = 6.0, 13.0
NOW = 1798000000.0  # December 2026
YEAR = 2026.95
DAY_S = 86400.0

# Residual of a calibration per axis (1 sd).
GYRO_LEFT, ACCEL_LEFT, MAG_LEFT = np.radians(0.05), 0.015, 0.4
GLUED = np.radians(0.1)
LEAST_LEVEL_FIELD = 15.0
"""uT: nearer to a magnetic pole a heading cannot be checked to 10 deg."""
TURN_FROM, TURN_S = 2.0, 2.0
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
    noises: dict[Sensor, list[float]] = dataclasses.field(default_factory=dict)
    """Noise of a sample, by sensor and instance: parts differ."""
    culprit: str = ""
    """What is off, as the report should name it; empty: nothing has a name."""
    dead: dict[tuple[Sensor, int], str] = dataclasses.field(default_factory=dict)
    """``zero``, ``frozen`` or ``nan``."""
    lost: frozenset[int] = frozenset()
    """Instances whose messages do not come."""
    ill: frozenset[Sensor] = frozenset()
    turned_deg: float = 0.0
    """By how much it is turned about its vertical in the middle of the capture."""
    settings: frozenset[str] = frozenset()
    """Names of the parameters that no calibration writes."""
    heading_error: float = 0.0
    tilt_error: float = 0.0
    """How far the vehicle's own attitude is off, rad."""
    believed: tuple[float, float, float] | None = None
    """Where it believes to be; None: where it is."""
    _channels: list[Channel] = dataclasses.field(default_factory=list)
    _seconds: float = SECONDS

    @property
    def imus(self) -> int:
        """How many inertial units it has."""
        return len(self.accel_errors)

    def snapshot(self) -> Snapshot:
        """Six seconds of it; as long as the service watches a compass that does not change by a step."""
        short = self._snapshot(SECONDS)
        mags = [c.values for c in short.recording.channels if c.sensor == Sensor.MAG]
        still = [bool((values == values[0]).all()) for values in mags]
        if not any(still) or (len(still) > 1 and all(still)):
            return short
        self._channels.clear()
        return self._snapshot(STILL_SECONDS)

    def _snapshot(self, seconds: float) -> Snapshot:
        self._seconds = seconds
        down = self.body_from_ned @ np.array([0.0, 0.0, 1.0])
        earth = self.body_from_ned @ self.field.north_east_down
        for i in range(self.imus):
            if i in self.lost:
                continue
            shaken = 0.02 * self.rattle  # rad/s for a m/s2
            accel = np.hypot(self.noises[Sensor.ACCEL][i], self.rattle)
            gyro = np.hypot(self.noises[Sensor.GYRO][i], shaken)
            force, rate = -STANDARD_GRAVITY * down + self.accel_errors[i], self.gyro_errors[i]
            for quantum_a, quantum_g in ((MG, MRAD_S), *(((0.0, 0.0),) if self.floats(i) else ())):
                self._add(Sensor.ACCEL, i, lambda _t, f=force: f, accel, 50.0, quantum_a)
                self._add(Sensor.GYRO, i, lambda t, r=rate: r + self._rate(t) * down, gyro, 50.0, quantum_g)
            self._add(Sensor.TEMPERATURE, i, lambda _t, i=i: np.array([self.temperatures[i]]), 0.05, 50.0, CDEGC)
        read = 10.0 if self.autopilot == "ardupilot" else 50.0
        for i, error in enumerate(self.mag_errors):
            if i in self.lost:
                continue
            turn, noise = self.mag_turns[i], self.noises[Sensor.MAG][i]
            self._add(
                Sensor.MAG,
                i,
                lambda t, turn=turn, error=error: turn @ about(down, -self._yaw(t)) @ earth + error,
                noise,
                read,
                MGAUSS_UT,
            )
        self._add(Sensor.ATTITUDE, 0, self._attitude, 1e-4, 10.0, 0.0)
        self._add(Sensor.POSITION, 0, lambda _t: np.array(self.believed or self.place), 0.0, 1.0, 0.0)
        count = int(seconds * 50.0)
        messages = {i: 0 if i in self.lost else count for i in range(max(self.imus, len(self.mag_errors)))}
        ready = not self.texts
        return Snapshot(
            Recording(tuple(self._channels)),
            Identity(self.autopilot, uid=self.uid, firmware=(4, 6, 0)),
            self.parameters,
            NOW,
            (self.verified,),
            self.shaking,
            OwnView(
                present=self.autopilot == "ardupilot",
                ready=ready,
                asked=True,
                texts=self.texts,
                calibrating=False,
                ill=self.ill,
            ),
            current_known=True,
            messages=messages,
        )

    def floats(self, instance: int) -> bool:
        """Whether a message carries this unit without rounding: ArduPilot's HIGHRES_IMU, of the first."""
        return self.autopilot == "ardupilot" and instance == 0

    def _yaw(self, t: float) -> float:
        return float(np.radians(self.turned_deg) * np.clip((t - TURN_FROM) / TURN_S, 0.0, 1.0))

    def _rate(self, t: float) -> float:
        return float(np.radians(self.turned_deg) / TURN_S) if TURN_FROM <= t < TURN_FROM + TURN_S else 0.0

    def _attitude(self, t: float) -> Array:
        """What the vehicle says of itself, with what its estimator has wrong."""
        down = self.body_from_ned @ np.array([0.0, 0.0, 1.0])
        tilted = about(np.cross(down, [0.6, 0.8, 0.0]), self.tilt_error)
        ned_from_body = (tilted @ about(down, -self._yaw(t)) @ self.body_from_ned).T
        return _quaternion(_about_down(self.heading_error) @ ned_from_body)

    def _add(
        self, sensor: Sensor, i: int, truth: Callable[[float], Array], noise: float, rate: float, quantum: float
    ) -> None:
        t = np.arange(0.0, self._seconds, 1.0 / rate)
        moves = self.turned_deg and sensor not in (Sensor.TEMPERATURE, Sensor.POSITION)
        true = np.array([truth(x) for x in t.tolist()]) if moves else np.tile(truth(0.0), (len(t), 1))
        values = true + self.rng.normal(0.0, noise, true.shape)
        fault = self.dead.get((sensor, i))
        if fault == "zero" and sensor != Sensor.GYRO:
            return  # three zeros are no reading of an accelerometer or a compass
        if fault in ("frozen", "zero"):
            values = np.tile(values[0] if fault == "frozen" else 0.0 * values[0], (len(t), 1))
        elif fault == "nan":
            values = np.full_like(values, np.nan)
        zero_bin = None
        if quantum > 0.0:
            whole = np.trunc(values / quantum)
            zero_bin, values = whole == 0.0, quantum * (whole + 0.5 * np.sign(whole))
        rounding = Rounding.TOWARD_ZERO if quantum > 0.0 else Rounding.NONE
        source = f"bench {quantum:g}"
        channel = Channel(sensor, i, t, values, "", Stage.CORRECTED, source, quantum, rounding, zero_bin)
        self._channels.append(channel)


def healthy(seed: int, *, redundant: bool = False) -> BenchVehicle:
    """A good vehicle somewhere on Earth; `redundant`: with two of everything at least."""
    rng = np.random.default_rng([2026, seed])
    autopilot = ("ardupilot", "px4")[seed % 2]
    least = 2 if redundant else 1
    quiet = np.random.default_rng([2027, seed])
    imus, mags = int(rng.integers(least, 4)), int(rng.integers(least, 4))
    field_, place = somewhere(rng)
    parameters = _parameters(rng, autopilot, imus, mags)
    covered = _calibration_temperature(parameters, autopilot)
    temperatures = [float(rng.uniform(covered - 15.0, covered + 15.0)) + float(rng.uniform(-1, 1)) for _ in range(imus)]
    ids = _ids(autopilot, imus, mags)
    then = NOW - float(rng.uniform(1.0, 200.0)) * DAY_S
    sensors = frozenset({Sensor.ACCEL, Sensor.GYRO, Sensor.MAG})
    at = dict.fromkeys(range(imus), covered)
    settings = _settings(quiet, autopilot, imus, mags, field_)
    parameters |= settings
    noises = {
        Sensor.GYRO: (4e-5 if not redundant else 5e-4, 1.5e-3, imus),
        Sensor.ACCEL: (9e-4 if not redundant else 0.01, 0.03, imus),
        Sensor.MAG: (0.015 if not redundant else 0.1, 0.4, mags),  # uT; the least is an RM3100's (datasheet)
    }
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
        VerifiedCalibration("job", then, sensors, ids, dict(parameters), at, frozenset(ids.values()), "0badcafe"),
        noises={
            sensor: np.exp(quiet.uniform(np.log(low), np.log(high), count)).tolist()
            for sensor, (low, high, count) in noises.items()
        },
        settings=frozenset(settings),
    )


def _settings(rng: np.random.Generator, autopilot: str, imus: int, mags: int, field: EarthField) -> dict[str, Value]:
    """How firmwares and their users leave parameters that no calibration writes."""
    found: dict[str, Value]
    if autopilot == "px4":
        found = {"COM_ARM_MAG_STR": 2, "IMU_GYRO_CAL_EN": 1}
        for i in range(imus):
            found |= {f"CAL_ACC{i}_PRIO": int(rng.choice([-1, 50, 75])), f"CAL_GYRO{i}_PRIO": 50}
        for i in range(mags):  # where an external compass was calibrated, PX4 switches those inside off
            found[f"CAL_MAG{i}_PRIO"] = int(rng.choice([0, 50, 75])) if i else 75
        return found | {"SYS_HAS_MAG": 1, "EKF2_DECL_TYPE": 3, "EKF2_MAG_DECL": float(rng.normal(0.0, 10.0))}
    found = {"ARMING_CHECK": 1, "INS_GYR_CAL": 1}
    found |= {"COMPASS_ENABLE": 1, "COMPASS_AUTODEC": 1, "COMPASS_DEC": float(rng.normal(0.0, 0.2))}
    found |= {f"INS_USE{i + 1 if i else ''}": int(i < 2 or rng.integers(2)) for i in range(imus)}
    found |= {f"COMPASS_USE{i + 1 if i else ''}": int(i < 1 or rng.integers(2)) for i in range(mags)}
    if rng.integers(4) == 0:
        found |= {"COMPASS_AUTODEC": 0, "COMPASS_DEC": field.declination + float(rng.normal(0.0, 0.02))}
    return found


def unheard(
    autopilot: str = "ardupilot",
    parameters: Mapping[str, Value] | None = None,
    recording: Recording | None = None,
    **more: Any,
) -> Snapshot:
    """A vehicle of which no more is heard than these."""
    return Snapshot(recording or Recording(()), Identity(autopilot=autopilot), parameters or {}, NOW, **more)


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


def somewhere(rng: np.random.Generator) -> tuple[EarthField, tuple[float, float, float]]:
    """A place on Earth with enough of a level field."""
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
    found: dict[str, Value] = {}
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
        if autopilot == "px4":
            found |= {_names(autopilot, sensor, i)[Role.ID]: 0 for i in range(count, PX4_SLOTS)}
    return found


def _names(autopilot: str, sensor: Sensor, i: int) -> dict[Role, str]:
    if autopilot == "px4":
        return dict(px4_names(sensor, i))
    return dict(ardupilot_compass_names(i, i) if sensor == Sensor.MAG else ardupilot_imu_names(sensor, i))


def _calibration_temperature(parameters: dict[str, Value], autopilot: str) -> float:
    return float(parameters["INS_ACC1_CALTEMP"]) if autopilot == "ardupilot" else 25.0
