"""ArduPilot's onboard compass calibration, as much of it as others can see: progress, report, stored result."""

from __future__ import annotations

from typing import Any

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.service.simvehicle import ardupilot_parameters as names
from mavcal.service.simvehicle.ardupilot_sensors import ArduPilotSensors
from mavcal.service.simvehicle.ardupilot_stored import StoredCalibrations
from mavcal.service.simvehicle.mounting import true_mounting
from mavcal.service.simvehicle.parameters import Value
from mavcal.service.simvehicle.vehicle import FlightController

MOVING_RATE = 0.2  # rad/s: slower motion brings no new samples
FULL_AFTER_S = 20.0  # of motion
TICK_S = 0.1
MGAUSS_PER_UT = 10.0
ACCEPTED, FAILED = 0, 4


class MagCalibration:
    """Collects while the vehicle moves; then reports, and stores what a perfect fit would find."""

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
