"""ArduPilot's onboard calibrations of gyroscope, level and simple accelerometer, on simulated raw samples."""

from __future__ import annotations

import math

import numpy as np

from mavcal.service.simvehicle import ardupilot_parameters as names
from mavcal.service.simvehicle.ardupilot_sensors import ArduPilotSensors
from mavcal.service.simvehicle.parameters import Value
from mavcal.service.simvehicle.rotation import Array

GYRO_WINDOW_SAMPLES = 50
GYRO_SAMPLE_S = 0.005
GYRO_CONVERGED = math.radians(0.1)
GYRO_TIMEOUT_S = 30.0
ACCEL_MOVED = 0.2  # m/s² of change that makes a window unusable
LEVEL_S = 0.4
LEVEL_LIMIT = math.radians(10.0)
SLOTS = 3
G = 9.80665


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
    """What a gyro calibration stores: three slots; absent ones become zero."""
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
    """One level pose taken as exact: the whole error goes into the offset; scale 1, trim 0."""
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
