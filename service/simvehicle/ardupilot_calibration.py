"""ArduPilot's onboard calibrations on simulated raw samples: gyroscope, level, accelerometer and compass.

`StoredCalibrations` keeps what they have found, and what arming checks require afterwards.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.service.simvehicle import ardupilot_parameters as names
from mavcal.service.simvehicle.ardupilot_sensors import ArduPilotSensors
from mavcal.service.simvehicle.mounting import true_mounting
from mavcal.service.simvehicle.parameters import ParameterTable, Value
from mavcal.service.simvehicle.rotation import Array
from mavcal.service.simvehicle.vehicle import FlightController

GYRO_WINDOW_SAMPLES = 50
GYRO_SAMPLE_S = 0.005
GYRO_CONVERGED = math.radians(0.1)
GYRO_TIMEOUT_S = 30.0
ACCEL_MOVED = 0.2  # m/s² of change that makes a window unusable
LEVEL_S = 0.4
LEVEL_LIMIT = math.radians(10.0)
SLOTS = 3
G = 9.80665
POSES = ("level", "on its LEFT side", "on its RIGHT side", "nose DOWN", "nose UP", "on its BACK")
SUCCESS, FAILURE = 16777215.0, 16777216.0
ASK_AGAIN_S = 1.0
SAMPLE_S, SAMPLES = 0.5, 50
LEAST_APART = 0.765 * G
MAX_MEAN_SQUARE = 0.1  # (m/s²)²
SCALE_LIMITS = (0.8, 1.2)
ITERATIONS = 50
MOVING_RATE = 0.2  # rad/s: slower motion brings no new samples
FULL_AFTER_S = 20.0  # of motion
TICK_S = 0.1
MGAUSS_PER_UT = 10.0
ACCEPTED, FAILED = 0, 4


class StoredCalibrations:
    """Stores calibrations; knows which accelerometers count as calibrated and whether a reboot is due."""

    def __init__(self, table: ParameterTable, announce: Callable[[list[str]], None]) -> None:
        self._table, self._announce = table, announce
        self.accels: set[int] = set()
        """Instances whose ids are stored, and which therefore count as calibrated."""
        self.reboot_reason: str | None = None
        """Reason for which arming is refused until the next boot."""

    def boot(self) -> None:
        """Note that the vehicle has rebooted."""
        self.reboot_reason = None

    def mark_accels(self, count: int) -> None:
        """Store the ids of all accelerometers, which then count as calibrated."""
        self.accels = set(range(count))

    def require_reboot(self, reason: str) -> None:
        """Refuse arming with this reason until the next boot."""
        self.reboot_reason = reason

    def write(self, values: dict[str, Value], *, announce: bool = True) -> None:
        """Store what the firmware itself has found, save it, and tell every link."""
        for name, value in values.items():
            self._table.store(name, value)
            self._table.save(name)
        if announce:
            self._announce(list(values))


def gyro_offsets(sensors: ArduPilotSensors, now: float) -> tuple[list[Array], float]:
    """The offsets that converge first (one per instance, rad/s) and how long that takes from `now` on, in seconds.

    Means of 50 samples at 5 ms; done when two successive means agree within 0.1 °/s on every gyro. A steady rate
    converges too: nothing here knows that the vehicle turns.
    """
    count = len(sensors.chips)
    window = GYRO_WINDOW_SAMPLES * GYRO_SAMPLE_S
    last: list[Array] | None = None
    best: tuple[float, list[Array]] = (math.inf, [np.zeros(3)] * count)
    for step in range(int(GYRO_TIMEOUT_S / window)):
        t = now + step * window + np.arange(1, GYRO_WINDOW_SAMPLES + 1) * GYRO_SAMPLE_S
        state = sensors.world.state(t)
        force = state.force
        if np.linalg.norm(force[-1] - force[0]) > ACCEL_MOVED:
            last = None
            continue
        means = [sensors.raw(k, state)[1].mean(axis=0) for k in range(count)]
        if last is not None:
            change = max(float(np.linalg.norm(a - b)) for a, b in zip(means, last, strict=True))
            halfway = [(a + b) / 2 for a, b in zip(means, last, strict=True)]
            best = min(best, (change, halfway), key=lambda pair: pair[0])
            if change < GYRO_CONVERGED:
                return halfway, (step + 1) * window
        last = means
    return best[1], GYRO_TIMEOUT_S


def gyro_values(sensors: ArduPilotSensors, now: float, offsets: list[Array]) -> dict[str, Value]:
    """Parameters that a gyro calibration stores: three slots, zeros for those without a sensor."""
    values: dict[str, Value] = {}
    for slot in range(SLOTS):
        present = slot < len(offsets)
        base = names.gyro_offset_name(slot)
        for axis, value in zip("XYZ", offsets[slot] if present else np.zeros(3), strict=True):
            values[f"{base}_{axis}"] = float(value)
        chip = sensors.chips[slot] if present else 0
        values[names.id_name("GYR", slot)] = names.GYRO_IDS[chip] if present else 0
        if present:
            t = np.array([now])
            values[names.caltemp_name("GYR", slot)] = float(sensors.world.temperature_read(chip, t)[0])
    return values


def level_trim(sensors: ArduPilotSensors, now: float) -> tuple[float, float] | None:
    """AHRS_TRIM_X and _Y (rad) of the present pose from the corrected first accelerometer; None beyond 10°."""
    t = now + np.arange(1, 41) * LEVEL_S / 40
    mean = sensors.imu(0, sensors.world.state(t)).accel.mean(axis=0)
    roll = math.atan2(-mean[1], -mean[2])
    pitch = math.atan2(mean[0], math.hypot(mean[1], mean[2]))
    if not (abs(roll) < LEVEL_LIMIT and abs(pitch) < LEVEL_LIMIT):
        return None
    return roll, pitch


def simple_accel_values(sensors: ArduPilotSensors, now: float) -> dict[str, Value]:
    """Parameters from one level pose taken as exact: the whole error goes into the offset; scale 1, trim 0."""
    values: dict[str, Value] = {}
    t = now + np.arange(1, 41) * 0.01
    state = sensors.world.state(t)
    for slot in range(len(sensors.chips)):
        mean = sensors.raw(slot, state)[0].mean(axis=0)
        offset = mean - np.array([0.0, 0.0, -G])
        for axis, value in zip("XYZ", offset, strict=True):
            values[f"{names.accel_offset_name(slot)}_{axis}"] = float(value)
            values[f"{names.accel_scale_name(slot)}_{axis}"] = 1.0
        chip = sensors.chips[slot]
        values[names.caltemp_name("ACC", slot)] = float(sensors.world.temperature_read(chip, t[-1:])[0])
    for axis in "XYZ":
        values[f"AHRS_TRIM_{axis}"] = 0.0
    return values


class AccelCalibration:
    """The dialogue of COMMAND_LONG 42429: asks for six poses in a fixed order, averages each, stores what fits.

    Six means of |SCAL ∘ (m − OFFS)| = g for six unknowns: no residual is left that could reveal a bad pose.
    """

    def __init__(self, vehicle: FlightController, sensors: ArduPilotSensors, stored: StoredCalibrations) -> None:
        self._vehicle, self._sensors, self._stored = vehicle, sensors, stored
        self._means: list[list[Array]] = []
        self._sampling = False
        self.running = False

    def start(self) -> None:
        """Begin with the first pose: from now on the streams carry uncorrected accelerations."""
        self.running, self._sampling, self._means = True, False, []
        self._sensors.accel_calibrating = True
        self._vehicle.say(f"Place vehicle {POSES[0]} and press any key.", dialect.MAV_SEVERITY_CRITICAL)
        self._ask()

    def cancel(self) -> None:
        """End the dialogue at a reboot."""
        self.running = self._sensors.accel_calibrating = False

    def answer(self, pose: float) -> None:
        """Take the ground station's statement that the vehicle is in a pose; only the requested pose counts."""
        if not self.running or self._sampling or pose != len(self._means) + 1:
            return
        self._sampling = True
        vehicle, sensors = self._vehicle, self._sensors
        state = vehicle.world.state(vehicle.time + np.arange(1, SAMPLES + 1) * (SAMPLE_S / SAMPLES))
        means = [sensors.raw(k, state)[0].mean(axis=0) for k in range(len(sensors.chips))]
        vehicle.at(SAMPLE_S, lambda: self._taken(means))

    def _taken(self, means: list[Array]) -> None:
        if not self.running:
            return
        self._sampling = False
        first = means[0]
        if any(np.linalg.norm(first - earlier[0]) < LEAST_APART for earlier in self._means):
            self._finish(None)
            return
        self._means.append(means)
        if len(self._means) == len(POSES):
            self._finish(self._fit())
            return
        self._vehicle.say(f"Place vehicle {POSES[len(self._means)]} and press any key.", dialect.MAV_SEVERITY_CRITICAL)

    def _ask(self) -> None:
        if not self.running:
            return
        if not self._sampling:
            self._command(float(len(self._means) + 1))
        self._vehicle.at(ASK_AGAIN_S, self._ask)

    def _command(self, value: float) -> None:
        self._vehicle.broadcast(
            dialect.MAVLink_command_long_message(
                0, 0, dialect.MAV_CMD_ACCELCAL_VEHICLE_POS, 0, value, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            )
        )

    def _fit(self) -> list[tuple[Array, Array]] | None:
        solutions = [solve([pose[k] for pose in self._means]) for k in range(len(self._means[0]))]
        return None if any(s is None for s in solutions) else [s for s in solutions if s is not None]

    def _finish(self, solutions: list[tuple[Array, Array]] | None) -> None:
        vehicle, count = self._vehicle, len(self._sensors.chips)
        self.cancel()
        if solutions is None:
            vehicle.say("Calibration FAILED", dialect.MAV_SEVERITY_CRITICAL)
            self._command(FAILURE)
            # In memory only: the stored values come back with a reboot.
            for name, value in self._values([(np.zeros(3), np.ones(3))] * count).items():
                vehicle.table.store(name, value)
            return
        self._stored.write(self._values(solutions))
        self._stored.mark_accels(count)
        self._stored.require_reboot("Accels calibrated requires reboot")
        vehicle.say("Calibration successful", dialect.MAV_SEVERITY_CRITICAL)
        self._command(SUCCESS)

    def _values(self, solutions: list[tuple[Array, Array]]) -> dict[str, Value]:
        values: dict[str, Value] = {}
        now = np.array([self._vehicle.time])
        for k, (offset, scale) in enumerate(solutions):
            for axis, o, s in zip("XYZ", offset, scale, strict=True):
                values[f"{names.accel_offset_name(k)}_{axis}"] = float(o)
                values[f"{names.accel_scale_name(k)}_{axis}"] = float(s)
            chip = self._sensors.chips[k]
            values[names.caltemp_name("ACC", k)] = float(self._vehicle.world.temperature_read(chip, now)[0])
        return values


def solve(means: list[Array]) -> tuple[Array, Array] | None:
    """Offset and scale of six pose means (m/s²) by Gauss-Newton; None where the firmware would not accept them."""
    m = np.array(means)
    x = np.array([0.0, 0.0, 0.0, 1.0, 1.0, 1.0])
    for _ in range(ITERATIONS):
        scaled = (m - x[:3]) * x[3:]
        residual = np.sum(scaled**2, axis=1) - G * G
        jacobian = np.hstack([-2 * scaled * x[3:], 2 * scaled * (m - x[:3])])
        step, *_ = np.linalg.lstsq(jacobian, residual, rcond=None)
        x = x - step
        if np.abs(step).max() < 1e-10:
            break
    offset, scale = x[:3], x[3:]
    length = np.linalg.norm((m - offset) * scale, axis=1)
    accepted = (
        math.isfinite(float(x.sum()))
        and float(np.mean((length - G) ** 2)) < MAX_MEAN_SQUARE
        and (np.abs(offset) <= G).all()
        and (scale >= SCALE_LIMITS[0]).all()
        and (scale <= SCALE_LIMITS[1]).all()
    )
    return (offset, scale) if accepted else None


class MagCalibration:
    """Compass calibration: collects while the vehicle moves, then reports and stores the result of a perfect fit."""

    def __init__(self, vehicle: FlightController, sensors: ArduPilotSensors, stored: StoredCalibrations) -> None:
        self._vehicle, self._sensors, self._stored = vehicle, sensors, stored
        self.running = False
        self._moved_s = 0.0
        self._autosave = False
        self._report: Any = None

    def start(self, _mask: int, *, autosave: bool) -> int:
        """MAV_CMD_DO_START_MAG_CAL."""
        if not self._sensors.compasses:
            return FAILED
        self.running, self._moved_s, self._autosave, self._report = True, 0.0, autosave, None
        self._vehicle.at(TICK_S, self._tick)
        return ACCEPTED

    def cancel(self) -> int:
        """MAV_CMD_DO_CANCEL_MAG_CAL."""
        self.running, self._report = False, None
        return ACCEPTED

    def accept(self) -> int:
        """MAV_CMD_DO_ACCEPT_MAG_CAL: store what was reported."""
        if self._report is None:
            return FAILED
        self._store()
        return ACCEPTED

    def _tick(self) -> None:
        vehicle = self._vehicle
        if not self.running:
            return
        _, rate = vehicle.world.motion.evaluate(np.array([vehicle.time]))
        if np.linalg.norm(rate[0]) > MOVING_RATE:
            self._moved_s += TICK_S
        if self._moved_s < FULL_AFTER_S:
            vehicle.at(TICK_S, self._tick)
            return
        self.running = False
        self._report = self._values(0)
        if self._autosave:
            self._store()

    def _values(self, instance: int) -> dict[str, Value]:
        """OFS, DIA, ODI that undo this compass's truth, in the body frame."""
        world = self._sensors.world
        slot = self._sensors.compasses[instance]
        truth = world.truth.mags[slot]
        rotation = true_mounting(world.config, slot)
        correction = rotation @ np.linalg.inv(truth.matrix) @ rotation.T
        offset = -rotation @ truth.offset * MGAUSS_PER_UT
        vectors = {
            "OFS": offset,
            "DIA": np.diag(correction),
            "ODI": np.array([correction[0, 1], correction[0, 2], correction[1, 2]]),
        }
        return {
            f"{names.compass_name(kind, slot)}_{axis}": float(value)
            for kind, vector in vectors.items()
            for axis, value in zip("XYZ", vector, strict=True)
        }

    def _store(self) -> None:
        for instance in range(len(self._sensors.compasses)):
            self._stored.write(self._values(instance))
        self._stored.require_reboot("Compass calibrated requires reboot")

    def progress_message(self) -> Any:
        """MAG_CAL_PROGRESS; None while nothing runs."""
        if not self.running:
            return None
        percent = min(int(100 * self._moved_s / FULL_AFTER_S), 99)
        status = dialect.MAG_CAL_RUNNING_STEP_TWO if percent > 50 else dialect.MAG_CAL_RUNNING_STEP_ONE
        return dialect.MAVLink_mag_cal_progress_message(0, 1, status, 1, percent, [0] * 10, 0.0, 0.0, 0.0)

    def report_message(self) -> Any:
        """MAG_CAL_REPORT; None before a calibration has ended."""
        if self._report is None:
            return None
        values = [float(v) for v in self._report.values()]
        fitness = self._vehicle.world.truth.mags[0].noise * MGAUSS_PER_UT
        return dialect.MAVLink_mag_cal_report_message(0, 1, dialect.MAG_CAL_SUCCESS, 0, fitness, *values)
