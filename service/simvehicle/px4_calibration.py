"""PX4's onboard calibrations: those a ground station starts (texts, states, values), and the one PX4 runs by itself."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import numpy as np

from mavcal.service.simvehicle import px4_parameters as names
from mavcal.service.simvehicle.parameters import Value
from mavcal.service.simvehicle.px4_memory import GYRO_OFFSET_THRESHOLD, SensorMemory
from mavcal.service.simvehicle.px4_parameters import DEFAULT_PRIORITY, SLOTS, UNINITIALISED, vector_names
from mavcal.service.simvehicle.px4_protocol import Px4Parameters
from mavcal.service.simvehicle.px4_sensors import Px4Sensors
from mavcal.service.simvehicle.rotation import Array
from mavcal.service.simvehicle.vehicle import FlightController

GYRO_S = 1.05
GYRO_SAMPLES = 250
STEP_S = 0.1
DONE_AFTER_S = 0.12  # from the values to the last text
STATE_AFTER_S = 1.0  # HEARTBEAT goes on saying CALIBRATING for this long
WAIT_FOR_SIDES_S = 90.0
G = 9.80665
SAMPLE_S = 0.02
WINDOW_S = 5.0
MOVED = 0.5  # m/s² from the sample that began the window
HEAVY = 1.3 * 9.80665
TEMPERATURE_CHANGE = 1.0  # °C


class Px4OnboardCalibration:
    """One calibration at a time; everything after the first ACK is text."""

    def __init__(self, vehicle: FlightController, sensors: Px4Sensors, parameters: Px4Parameters) -> None:
        self._vehicle, self._sensors, self._parameters = vehicle, sensors, parameters
        self.running: str | None = None
        self._until = -math.inf

    def boot(self) -> None:
        """End any calibration at a boot."""
        self.running, self._until = None, -math.inf

    @property
    def shown(self) -> bool:
        """Whether HEARTBEAT says CALIBRATING."""
        return self.running is not None or self._vehicle.time < self._until

    def gyro(self) -> None:
        """Averages 250 samples of every gyroscope, whether or not it turns."""
        self._begin("gyro")
        vehicle, sensors = self._vehicle, self._sensors
        t = vehicle.time + np.arange(1, GYRO_SAMPLES + 1) * (GYRO_S / GYRO_SAMPLES)
        state = vehicle.world.state(t)
        memories = sensors.gyros
        means = [sensors.gyro_before_offset(k, state).mean(axis=0) for k in range(len(memories))]
        for percent in range(0, 100, 10):
            vehicle.at(0.058 + percent / 10 * STEP_S, self._texter(f"[cal] progress <{percent}>"))
        vehicle.at(GYRO_S, lambda: self._finish(_slots("GYRO", memories, means)))

    def level(self) -> None:
        """Half a second of attitude becomes the board offset; the gyroscopes are written on the way."""
        self._begin("level")
        vehicle, sensors = self._vehicle, self._sensors
        state = vehicle.world.state(vehicle.time + np.arange(1, 51) * 0.01)
        mean = sensors.imu(sensors.primary, state).accel.mean(axis=0)
        roll = math.degrees(math.atan2(-mean[1], -mean[2]))
        pitch = math.degrees(math.atan2(mean[0], math.hypot(mean[1], mean[2])))
        table = vehicle.table
        memories = sensors.gyros
        gyro = [sensors.gyro_before_offset(k, state).mean(axis=0) for k in range(len(memories))]
        values: dict[str, Value] = {
            "SENS_BOARD_X_OFF": table.get("SENS_BOARD_X_OFF") + roll,
            "SENS_BOARD_Y_OFF": table.get("SENS_BOARD_Y_OFF") + pitch,
            **_slots("GYRO", memories, gyro),
        }
        vehicle.at(0.5, lambda: self._finish(values))

    def quick_accel(self) -> None:
        """One pose, a few samples: the whole difference from gravity, noise included, becomes the offset."""
        self._begin("accel")
        vehicle, sensors = self._vehicle, self._sensors
        state = vehicle.world.state(vehicle.time + np.arange(1, 4) * 0.004)
        offsets = [vehicle.world.accel(k, state).mean(axis=0) - state.force[0] for k in range(len(sensors.accels))]
        values = _slots("ACC", sensors.accels, offsets)
        for memory in sensors.accels:
            if memory.slot is not None:
                values |= dict.fromkeys(vector_names(f"CAL_ACC{memory.slot}", "SCALE"), 1.0)
        vehicle.at(0.01, lambda: self._finish(values))

    def wait_for_sides(self, what: str) -> None:
        """Six-sided calibrations wait for an operator who never comes, then fail."""
        self._begin(what)
        vehicle = self._vehicle
        vehicle.at(0.1, self._texter("[cal] pending: back front left right up down"))
        boots = vehicle.boots

        def give_up() -> None:
            if self.running == what and vehicle.boots == boots:
                self._end("[cal] calibration failed: timeout: no motion")

        vehicle.at(WAIT_FOR_SIDES_S, give_up)

    def block(self, what: str) -> None:
        """Start a calibration that never ends; all others are refused until a restart."""
        self._begin(what)

    def cancel(self) -> None:
        """Cancel, as MAV_CMD 241 with all parameters zero does."""
        if self.running is not None:
            self._end("[cal] calibration cancelled")

    def _begin(self, what: str) -> None:
        self.running = what
        self._vehicle.at(0.004, self._texter(f"[cal] calibration started: 2 {what}"))

    def _finish(self, values: dict[str, Value]) -> None:
        what = self.running
        if what is None:
            return
        self._parameters.write(values)
        self._vehicle.at(0.06, self._texter("[cal] progress <100>"))
        self._vehicle.at(DONE_AFTER_S, lambda: self._end(f"[cal] calibration done: {what}"))

    def _end(self, text: str) -> None:
        self.running, self._until = None, self._vehicle.time + STATE_AFTER_S
        self._vehicle.say(text)

    def _texter(self, text: str) -> Callable[[], None]:
        running = self.running

        def say() -> None:
            if self.running == running:
                self._vehicle.say(text)

        return say


def _slots(kind: str, memories: list[SensorMemory], offsets: list[Array]) -> dict[str, Value]:
    """Values that ParametersSave writes for each calibrated sensor."""
    values: dict[str, Value] = {}
    for memory, offset in zip(memories, offsets, strict=True):
        if memory.slot is None:
            continue
        base = f"CAL_{kind}{memory.slot}"
        values |= {f"{base}_ID": memory.device_id, f"{base}_PRIO": names.DEFAULT_PRIORITY, f"{base}_ROT": -1}
        values |= {n: float(v) for n, v in zip(vector_names(base, "OFF"), offset, strict=True)}
    return values


class GyroWriter:
    """PX4's module gyro_calibration: it writes the mean gyroscope into CAL_GYRO by itself.

    It looks only at the accelerometer for motion, so a steady turn about the vertical counts as rest. Measured: 5 s
    after the last parameter change, if the offset would move by more than 0.01 rad/s. A gyroscope without a row gets
    one, whatever its mean. Each save of a row stores its id, priority and rotation too (Gyroscope::ParametersSave).
    """

    def __init__(
        self, vehicle: FlightController, sensors: Px4Sensors, parameters: Px4Parameters, busy: Callable[[], bool]
    ) -> None:
        self._vehicle, self._sensors, self._parameters, self._busy = vehicle, sensors, parameters, busy
        self.boot()

    def boot(self) -> None:
        """Read IMU_GYRO_CAL_EN, which takes effect only at a restart."""
        self._enabled = self._vehicle.table.get("IMU_GYRO_CAL_EN", 1.0) != 0
        self._done = 0  # samples taken since vehicle time zero
        self._reset(0)

    def _reset(self, sample: int) -> None:
        self._began = sample
        self._reference: Array | None = None
        self._temperature: float | None = None
        self._sums = [np.zeros(3) for _ in self._sensors.gyros]

    def advance(self, until: float) -> None:
        """Take the samples up to a time."""
        first, last = self._done + 1, int(np.floor(until / SAMPLE_S + 1e-9))
        if not self._enabled or last < first:
            return
        self._done = last
        changed = int(np.ceil(self._parameters.last_change / SAMPLE_S))
        if self._vehicle.armed or self._busy() or changed > last:
            self._reset(last)
            return
        if changed > self._began:
            self._reset(changed)
        self._collect(max(first, self._began + 1), last)

    def _collect(self, first: int, last: int) -> None:
        if last < first:
            return
        world, sensors = self._sensors.world, self._sensors
        samples = list(range(first, last + 1))
        state = world.state(np.array(samples) * SAMPLE_S)
        accel = world.accel(0, state)
        temperature = world.temperature_read(0, state.t)
        gyros = [sensors.gyro_before_offset(k, state) for k in range(len(sensors.gyros))]
        begin = self._last_motion(samples, accel, temperature)
        for k, values in enumerate(gyros):
            self._sums[k] = self._sums[k] + values[begin:].sum(axis=0)
        if (last - self._began) * SAMPLE_S > WINDOW_S:
            self._write(last)

    def _last_motion(self, samples: list[int], accel: Array, temperature: Array) -> int:
        """Index of the first sample after the last sign of motion; begins a new window there."""
        begin = 0
        for i, (force, degrees) in enumerate(zip(accel, temperature, strict=True)):
            if self._reference is None or self._temperature is None:
                self._reference, self._temperature = force, float(degrees)
            moved = np.linalg.norm(force - self._reference) > MOVED or np.linalg.norm(force) > HEAVY
            if moved or abs(degrees - self._temperature) > TEMPERATURE_CHANGE:
                self._reset(samples[i])
                self._reference, self._temperature = force, float(degrees)
                begin = i + 1
        return begin

    def _write(self, sample: int) -> None:
        """Store every mean that is far enough from what is in memory."""
        count = sample - self._began
        values: dict[str, Value] = {}
        for memory, total in zip(self._sensors.gyros, self._sums, strict=True):
            mean = total / count
            if memory.slot is None or np.linalg.norm(mean - memory.offset) > GYRO_OFFSET_THRESHOLD:
                slot = self._free_slot(values) if memory.slot is None else memory.slot
                base = f"CAL_GYRO{slot}"
                values |= {f"{base}_ID": memory.device_id, f"{base}_PRIO": self._priority(base), f"{base}_ROT": -1}
                values |= {n: float(v) for n, v in zip(vector_names(base, "OFF"), mean, strict=True)}
        values = {name: value for name, value in values.items() if self._vehicle.table[name].value != value}
        if values:
            self._parameters.write(values)
            for name, value in values.items():
                self._vehicle.note_own_write(name, float(value))
        self._reset(sample)

    def _free_slot(self, claimed: Mapping[str, Value]) -> int:
        """The first row without a gyroscope."""
        taken = [claimed.get(f"CAL_GYRO{n}_ID", self._vehicle.table.get(f"CAL_GYRO{n}_ID")) for n in range(SLOTS)]
        return taken.index(0)

    def _priority(self, base: str) -> int:
        """The priority in force: the default where none was ever stored."""
        stored = int(self._vehicle.table.get(f"{base}_PRIO"))
        return DEFAULT_PRIORITY if stored == UNINITIALISED else stored
