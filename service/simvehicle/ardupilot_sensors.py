"""ArduPilot's sensor front end: raw readings through the formulas with the parameters in force."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mavcal.service.simvehicle import ardupilot_parameters as names
from mavcal.service.simvehicle.corrections import ArduPilotThermal, ardupilot_accel, ardupilot_compass, ardupilot_gyro
from mavcal.service.simvehicle.magreader import MagReader
from mavcal.service.simvehicle.mounting import CustomRotations
from mavcal.service.simvehicle.parameters import ParameterTable
from mavcal.service.simvehicle.rotation import Array
from mavcal.service.simvehicle.sensor_faults import SensorFaults
from mavcal.service.simvehicle.world import ImuReading, MotionState, SimWorld

MGAUSS_PER_UT = 10.0
COMPASS_PERIOD_S = 0.1  # Copter's battery and compass task
COMPASS_SUBSAMPLES = 10
LOOP_S = 0.0025  # tasks run at a main loop of 400 Hz
MOTOR_COMPENSATION_THROTTLE, MOTOR_COMPENSATION_CURRENT = 1, 2


@dataclass(frozen=True)
class ImuCalibration:
    """The calibration in force of one inertial unit."""

    accel_offset: Array
    accel_scale: Array
    gyro_offset: Array
    accel_thermal: ArduPilotThermal | None
    gyro_thermal: ArduPilotThermal | None
    accel_caltemp: float
    gyro_caltemp: float


def compass_reader(world: SimWorld) -> MagReader:
    """ArduPilot's compass task; its phase is drawn from the vehicle's seed."""
    phase = float(np.random.default_rng([world.config.seed, 4]).uniform(0.0, COMPASS_PERIOD_S))
    return MagReader(world, COMPASS_PERIOD_S, COMPASS_SUBSAMPLES, phase=phase, late=LOOP_S)


class ArduPilotSensors:
    """Corrected readings of every instance; chips are assigned to instances at boot."""

    def __init__(self, world: SimWorld, table: ParameterTable, faults: SensorFaults) -> None:
        self.world, self.table, self._faults = world, table, faults
        self.reader = compass_reader(world)
        self.accel_calibrating = False
        self._custom = CustomRotations(table)
        self._cache: dict[int, ImuCalibration] = {}
        self._cached_version = -1
        self.detect()

    def detect(self) -> None:
        """Find the chips that are present and not masked, and latch settings that need a reboot."""
        mask = int(self.table.get("INS_ENABLE_MASK", 127))
        chips = range(len(self.world.truth.accels))
        self.chips = [k for k in chips if mask >> k & 1 and not self._faults.absent("accel", k)]
        self._custom.boot()
        self.board = self._custom.mounting(self.table.get("AHRS_ORIENTATION"))
        mags = [k for k in range(len(self.world.truth.mags)) if not self._faults.absent("mag", k)]
        by_id = {names.MAG_IDS[k]: k for k in mags}
        wanted = [int(self.table.get(f"COMPASS_PRIO{k}_ID")) for k in (1, 2, 3)]
        first = [by_id[i] for i in wanted if i in by_id]
        self.compasses = first + [k for k in mags if k not in first]
        if not self.table.get("COMPASS_ENABLE", 1.0):
            self.compasses = []
        self.reader.restart()

    def unhealthy(self, kind: str) -> bool:
        """Whether the firmware notices a fault: of any inertial unit, or of the first compass."""
        return self._faults.fails("mag", 0) if kind == "mag" else self._faults.any(kind)

    @property
    def primary(self) -> int:
        """The first instance that is used and works."""
        usable = [
            i
            for i in range(len(self.chips))
            if self.table.get(names.use_name(i), 1.0) and not self._faults.absent("accel", i)
        ]
        return usable[0] if usable else 0

    def imu(self, instance: int, state: MotionState, noise_scale: float = 1.0) -> ImuReading:
        """Corrected readings of one instance at the times of a state; zeros where there is no such instance."""
        if instance >= len(self.chips) or self._faults.absent("accel", instance):
            zero = np.zeros((len(state.t), 3))
            return ImuReading(zero, zero, np.zeros(len(state.t)))
        chip = self.chips[instance]
        c = self._calibration(instance)
        temperature = self.world.temperature_read(chip, state.t)
        raw_accel = self.world.accel(chip, state, noise_scale)
        raw_gyro = self.world.gyro(chip, state, noise_scale)
        thermal = None if c.accel_thermal is None else c.accel_thermal.correction(temperature, c.accel_caltemp)
        accel = ardupilot_accel(raw_accel, c.accel_offset, c.accel_scale, thermal, self.board)
        if self.accel_calibrating:
            accel = raw_accel @ self.board.T
        thermal = None if c.gyro_thermal is None else c.gyro_thermal.correction(temperature, c.gyro_caltemp)
        gyro = ardupilot_gyro(raw_gyro, c.gyro_offset, thermal, self.board)
        return self._faults.imu(instance, accel, gyro, temperature)

    def raw(self, instance: int, state: MotionState) -> tuple[Array, Array]:
        """Uncorrected accelerometer and gyroscope of an instance, as the onboard calibrations take them."""
        chip = self.chips[instance]
        return self.world.accel(chip, state), self.world.gyro(chip, state)

    def _calibration(self, instance: int) -> ImuCalibration:
        if self._cached_version != self.table.version:
            self._cache.clear()
            self._cached_version = self.table.version
        if instance not in self._cache:
            self._cache[instance] = self._read(instance)
        return self._cache[instance]

    def _read(self, instance: int) -> ImuCalibration:
        t = self.table
        return ImuCalibration(
            t.vector(names.accel_offset_name(instance)),
            t.vector(names.accel_scale_name(instance), 1.0),
            t.vector(names.gyro_offset_name(instance)),
            self._thermal(instance, "ACC"),
            self._thermal(instance, "GYR"),
            t.get(names.caltemp_name("ACC", instance), names.UNKNOWN_CALTEMP),
            t.get(names.caltemp_name("GYR", instance), names.UNKNOWN_CALTEMP),
        )

    def _thermal(self, instance: int, sensor: str) -> ArduPilotThermal | None:
        group, t = f"INS_TCAL{instance + 1}", self.table
        if t.get(f"{group}_ENABLE") != 1:
            return None
        coefficients = np.stack([t.vector(f"{group}_{sensor}{order}") for order in (1, 2, 3)])
        return ArduPilotThermal(coefficients, t.get(f"{group}_TMIN"), t.get(f"{group}_TMAX", 70.0))

    def compass_body(self, instance: int, t: Array) -> Array:
        """Raw field in the body frame of a priority instance, mGauss, before offsets."""
        chip = self.compasses[instance]
        raw = self.reader.raw(chip, t) * MGAUSS_PER_UT
        external = self.table.get(names.compass_external_name(chip)) != 0
        stated = self.table.get(names.compass_name("ORIENT", chip))
        rotation = self._custom.mounting(stated) if external else self.board
        return np.asarray(raw @ rotation.T)

    def compass(self, instance: int, t: Array) -> Array:
        """Corrected field of a priority instance at times t, mGauss (N, 3); zeros where there is none."""
        if instance >= len(self.compasses) or self._faults.absent("mag", instance):
            return np.zeros((len(t), 3))
        slot, table = self.compasses[instance], self.table
        corrected = ardupilot_compass(
            self.compass_body(instance, t),
            table.vector(names.compass_name("OFS", slot)),
            table.vector(names.compass_name("DIA", slot), 1.0),
            table.vector(names.compass_name("ODI", slot)),
            table.get(names.compass_name("SCALE", slot)),
            self._motor_term(slot, t),
        )
        return self._faults.apply("mag", instance, corrected)

    def _motor_term(self, slot: int, t: Array) -> Array | None:
        kind = int(self.table.get("COMPASS_MOTCT"))
        read_at = self.reader.read_at(t)
        if kind == MOTOR_COMPENSATION_THROTTLE:
            level = self.world.throttle.at(read_at)
        elif kind == MOTOR_COMPENSATION_CURRENT:
            level = self.world.current.at(read_at)
        else:
            return None
        return np.asarray(level[:, None] * self.table.vector(names.compass_name("MOT", slot)))
