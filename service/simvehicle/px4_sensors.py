"""PX4's sensor front end: raw readings through the formulas with what its memory holds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mavcal.service.simvehicle import px4_parameters as names
from mavcal.service.simvehicle.corrections import px4_accel, px4_gyro, px4_mag, px4_thermal
from mavcal.service.simvehicle.magreader import MagReader
from mavcal.service.simvehicle.mounting import ANGLES, PX4_CUSTOM, numbered_mounting
from mavcal.service.simvehicle.parameters import ParameterTable
from mavcal.service.simvehicle.px4_memory import SensorMemory
from mavcal.service.simvehicle.rotation import Array, matrix_from_degrees
from mavcal.service.simvehicle.sensor_faults import SensorFaults
from mavcal.service.simvehicle.world import ImuReading, MotionState, SimWorld

GAUSS_PER_UT = 0.01
MAG_PERIOD_S = 0.02  # raw magnetometers are new 50 times a second
COMPENSATION_THRUST, COMPENSATION_CURRENT = 1, (2, 3)


@dataclass(frozen=True)
class ThermalSet:
    """One TC_ set: coefficients (4 orders, 3 axes) and its temperatures."""

    coefficients: Array
    t_ref: float
    t_min: float
    t_max: float

    def at(self, temperature: Array) -> Array:
        """TC(T), shape (N, 3)."""
        return px4_thermal(self.coefficients, self.t_ref, self.t_min, self.t_max, temperature)


class Px4Sensors:
    """Corrected readings by uORB instance."""

    def __init__(self, world: SimWorld, table: ParameterTable, faults: SensorFaults) -> None:
        self.world, self._table, self._faults = world, table, faults
        self.reader = MagReader(world, MAG_PERIOD_S, 1)
        self.boot()

    def boot(self) -> None:
        """Empty the memory, load it, and read settings that only a restart changes."""
        count = len(self.world.truth.accels)
        self.accels = [SensorMemory("ACC", names.ACCEL_IDS[k]) for k in range(count)]
        self.gyros = [SensorMemory("GYRO", names.GYRO_IDS[k]) for k in range(count)]
        self.mags = [SensorMemory("MAG", names.MAG_IDS[k]) for k in range(len(self.world.truth.mags))]
        runs = not self.world.config.sitl
        self.thermal_on = {s: runs and self._table.get(f"TC_{s}_ENABLE") != 0 for s in ("A", "G")}
        self._board = numbered_mounting(int(self._table.get("SENS_BOARD_ROT")))
        self._thermal: dict[tuple[str, int], ThermalSet | None] = {}
        self.reader.restart()
        self.update(armed=False)

    def update(self, *, armed: bool) -> None:
        """A parameter_update was published: load what is loaded now. Magnetometers wait while armed."""
        for memory in (*self.accels, *self.gyros, *(() if armed else self.mags)):
            memory.load(self._table)
        self.level = matrix_from_degrees(*(self._table.get(f"SENS_BOARD_{axis}_OFF") for axis in "XYZ"))
        self.body_from_sensor = self.level @ self._board
        self._thermal = {
            (sensor, k): self._thermal_set(sensor, memory.device_id)
            for sensor, memories in (("A", self.accels), ("G", self.gyros))
            for k, memory in enumerate(memories)
        }

    def _thermal_set(self, sensor: str, device_id: int) -> ThermalSet | None:
        t = self._table
        if not self.thermal_on[sensor]:
            return None
        slot = next((n for n in range(names.SLOTS) if t.get(f"TC_{sensor}{n}_ID") == device_id), None)
        if slot is None:
            return None
        g = f"TC_{sensor}{slot}"
        coefficients = np.array([[t.get(f"{g}_X{order}_{axis}") for axis in range(3)] for order in range(4)])
        return ThermalSet(coefficients, t.get(f"{g}_TREF", 25.0), t.get(f"{g}_TMIN"), t.get(f"{g}_TMAX", 100.0))

    @property
    def calibrated(self) -> bool:
        """Whether every sensor has a slot."""
        return not self.uncalibrated()

    def uncalibrated(self) -> list[str]:
        """The sensors without a slot, as the firmware names them."""
        groups = (("Accel", self.accels), ("Gyro", self.gyros), ("Compass", self.mags))
        return [f"{name} {k}" for name, group in groups for k, memory in enumerate(group) if memory.slot is None]

    def present(self, instance: int) -> bool:
        """Whether vehicle_imu of this instance is published: both halves exist and neither is disabled."""
        if instance >= len(self.accels) or self._faults.absent("accel", instance):
            return False
        return self.accels[instance].priority != 0 and self.gyros[instance].priority != 0

    def silent_mag(self, instance: int) -> bool:
        """Whether this magnetometer publishes nothing."""
        return self._faults.absent("mag", instance)

    @property
    def primary(self) -> int:
        """The instance of highest priority, the first among equals."""
        present = [k for k in range(len(self.accels)) if self.present(k)]
        return max(present, key=lambda k: (self.accels[k].priority, -k)) if present else 0

    def imu(self, instance: int, state: MotionState, noise_scale: float = 1.0) -> ImuReading:
        """Corrected readings of one instance at the times of a state."""
        temperature = self.world.temperature_read(instance, state.t)
        a, g = self.accels[instance], self.gyros[instance]
        raw_accel = self.world.accel(instance, state, noise_scale)
        raw_gyro = self.world.gyro(instance, state, noise_scale)
        accel = px4_accel(raw_accel, a.offset, a.scale, self._tc("A", instance, temperature), self.body_from_sensor)
        gyro = px4_gyro(raw_gyro, g.offset, self._tc("G", instance, temperature), self.body_from_sensor)
        return self._faults.imu(instance, accel, gyro, temperature)

    def _tc(self, sensor: str, instance: int, temperature: Array) -> Array | None:
        thermal = self._thermal.get((sensor, instance))
        return None if thermal is None else thermal.at(temperature)

    def gyro_before_offset(self, instance: int, state: MotionState) -> Array:
        """Raw gyroscope minus its thermal term: what the onboard calibrations average."""
        raw = self.world.gyro(instance, state)
        thermal = self._tc("G", instance, self.world.temperature_read(instance, state.t))
        return raw if thermal is None else raw - thermal

    def raw_mag(self, instance: int, t: Array) -> Array:
        """sensor_mag in Gauss (N, 3): uncorrected and unrotated; zeros where there is none."""
        if instance >= len(self.mags) or self._faults.absent("mag", instance):
            return np.zeros((len(t), 3))
        raw = self.reader.raw(instance, t) * GAUSS_PER_UT
        return self._faults.apply("mag", instance, raw)

    def mag(self, instance: int, t: Array, *, armed: bool) -> Array:
        """Corrected field in the body frame, Gauss (N, 3)."""
        m = self.mags[instance]
        power = self._power(t, armed=armed)[:, None] * m.power
        rotation = self._mag_rotation(m)
        return px4_mag(self.raw_mag(instance, t), m.offset, m.scale, m.off_diagonal, power, rotation)

    def _mag_rotation(self, memory: SensorMemory) -> Array:
        if memory.rotation < 0:
            return self.body_from_sensor
        if memory.rotation == PX4_CUSTOM and memory.slot is not None:
            base = f"CAL_MAG{memory.slot}"
            return np.asarray(self.level @ matrix_from_degrees(*(self._table.get(f"{base}_{a}") for a in ANGLES)))
        return np.asarray(self.level @ numbered_mounting(memory.rotation))

    def _power(self, t: Array, *, armed: bool) -> Array:
        kind = int(self._table.get("CAL_MAG_COMP_TYP"))
        if kind == COMPENSATION_THRUST and armed:
            return self.world.throttle.at(t)
        if kind in COMPENSATION_CURRENT:
            return np.asarray(self.world.current.at(t) / 1000.0)
        return np.zeros(len(t))
