"""ArduCopter's own simulator with the model ``calibration``, turned and warmed by a second connection.

Facts of the simulator: FLIGHT_CONTROLLERS 7.1 and 9; the model's four modes are those of ``SIM_Calibration.h``: servo 5
chooses the mode, servos 6 to 8 are roll, pitch and yaw, or the axis of a turn.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from bench.firmware.process import FirmwareProcess, SecondConnection
from bench.firmware.truth import FACES, MGAUSS, VehicleTruth

HOME: Final = "47.3769,8.5417,450,0"
STOP, ATTITUDE, TURN_FROM = 1050, 1150, 1300
FASTEST_DPS: Final = 360.0
"""At a mode servo of 2000."""
TICK_S: Final = 0.2
LONGEST_TAUS: Final = 6.0
"""A warm-up is over then: the simulator begins its curve again after a restart."""
AXIS_S: Final = 1.6
"""How long a tumbling vehicle turns about one axis."""
SET_SERVO, SIMSTATE, RAW_IMU = 183, 164, 27
MIDDLE_C: Final = 35.0
"""Middle of SIM_IMUTn_TMIN and _TMAX; ArduPilot's own polynomial refers to 35 degC too."""


class ArduCopter:
    """One simulated vehicle with the true firmware; moved by requests of :class:`simvehicle.Operator`."""

    autopilot: Final = "ardupilot"

    def __init__(self, binary: Path, folder: Path, truth: VehicleTruth, instance: int, *, noise_mgauss: float) -> None:
        self.truth, self._folder = truth, folder
        defaults = folder / "defaults.parm"
        lines = simulated(truth, noise_mgauss).items()
        defaults.write_text("".join(f"{name} {value:.9g}\n" for name, value in lines))
        command = [str(binary), "-I", str(instance), "--model", "calibration", "--speedup", "1", "--serial0", "tcp:0"]
        self._process = FirmwareProcess([*command, "--defaults", str(defaults), "--home", HOME], folder)
        self.url = f"tcp:127.0.0.1:{5760 + 10 * instance}"
        self.beside = SecondConnection(f"tcp:127.0.0.1:{5762 + 10 * instance}")
        self._moving = threading.Event()
        self._mover: threading.Thread | None = None
        self._warming = threading.Event()
        self._warmer: threading.Thread | None = None
        self._rng = np.random.default_rng([39, truth.seed])
        self._temperature = 25.0
        self._curve_used = False
        self._pose: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def start(self) -> None:
        """Start the firmware and connect beside mavcal."""
        self._process.start()
        self._curve_used = False
        self.beside.open()
        self.beside.stream(SIMSTATE, 5.0)
        self.beside.stream(RAW_IMU, 5.0)
        self._attitude(*self._pose)
        self._set("SIM_IMUT_FIXED", self._temperature)

    def stop(self) -> None:
        """End everything."""
        self._rest_threads()
        self.beside.close()
        self._process.stop()

    def restart(self) -> None:
        """Power off and on; what the firmware has saved stays."""
        self.stop()
        self.start()

    def restore_motion(self) -> None:
        """After a restart that mavcal asked for: the model forgets its pose."""
        self._attitude(*self._pose)

    def read(self, name: str) -> float | None:
        """The value that the vehicle holds now."""
        found: Any = self.beside.read_parameter(name)
        return None if found is None else float(found.param_value)

    def set(self, name: str, value: float) -> None:
        """Set a parameter from beside."""
        self._set(name, value)

    def call(self, do: str, **options: Any) -> dict[str, Any]:
        """One request of an Operator."""
        getattr(self, f"_do_{do}")(**options)
        return {"temperatures": [self._temperature], "quaternion": [1.0, 0.0, 0.0, 0.0]} if do == "state" else {}

    def _do_state(self) -> None:
        """Nothing to do: the reply says it."""

    def _do_hold(self, pose: str | Sequence[float], **_: Any) -> None:
        self._end_movement()
        roll, pitch, yaw = FACES[pose] if isinstance(pose, str) else pose
        tilt = self._rng.uniform(-4.0, 4.0, 2) if isinstance(pose, str) and pose != "level" else (0.0, 0.0)
        self._pose = (roll + tilt[0], pitch + tilt[1], yaw)
        self._attitude(*self._pose)

    def _do_still(self, **_: Any) -> None:
        self._end_movement()
        self._servo(5, STOP)

    def _do_tumble(self, rate_dps: float) -> None:
        self._end_movement()
        self._moving.clear()
        self._mover = threading.Thread(target=self._tumble, args=(rate_dps,), daemon=True)
        self._mover.start()

    def _do_temperature(self, value: float) -> None:
        self._end_warming()
        self._warm_to(value)

    def _do_warm_up(self, start: float, end: float, tau_s: float) -> None:
        """The simulator's own curve, which begins once a start, when no temperature is fixed; in small steps later."""
        self._end_warming()
        self._warming.clear()
        own, self._curve_used = not self._curve_used, True
        if own:
            for name, value in (("START", start), ("END", end), ("TCONST", tau_s)):
                self._set(f"SIM_IMUT_{name}", value)
            self._set("SIM_IMUT_FIXED", 0.0)
        self._warmer = threading.Thread(target=self._warm, args=(start, end, tau_s, own), daemon=True)
        self._warmer.start()

    def _tumble(self, rate_dps: float) -> None:
        while not self._moving.is_set():
            axis = self._rng.normal(size=3)
            for channel, part in zip((6, 7, 8), axis / np.linalg.norm(axis), strict=True):
                self._servo(channel, 1500 + round(450 * part))
            self._servo(5, TURN_FROM + round(700 * rate_dps / FASTEST_DPS))
            self._moving.wait(AXIS_S)

    def _warm(self, start: float, end: float, tau_s: float, own: bool) -> None:
        began = time.monotonic()
        while not self._warming.is_set() and time.monotonic() - began < LONGEST_TAUS * tau_s:
            self._temperature = end + (start - end) * math.exp((began - time.monotonic()) / tau_s)
            if not own:
                self._warm_to(self._temperature)
            self._warming.wait(TICK_S)
        self._warm_to(self._temperature)

    def _warm_to(self, celsius: float) -> None:
        self._temperature = celsius
        self._set("SIM_IMUT_FIXED", celsius)

    def _rest_threads(self) -> None:
        self._end_movement()
        self._end_warming()

    def _end_movement(self) -> None:
        self._moving.set()
        if self._mover is not None:
            self._mover.join()
            self._mover = None

    def _end_warming(self) -> None:
        self._warming.set()
        if self._warmer is not None:
            self._warmer.join()
            self._warmer = None

    def _attitude(self, roll: float, pitch: float, yaw: float) -> None:
        for channel, angle in zip((6, 7, 8), (roll, pitch, yaw), strict=True):
            self._servo(channel, round(1500 + 500 * ((angle + 180.0) % 360.0 - 180.0) / 180.0))
        self._servo(5, ATTITUDE)

    def _servo(self, channel: int, pwm: int) -> None:
        self.beside.command(SET_SERVO, channel, pwm)

    def _set(self, name: str, value: float) -> None:
        self.beside.send(lambda mav: mav.param_set_send(1, 1, name.encode(), value, 9))


def simulated(truth: VehicleTruth, noise_mgauss: float) -> Mapping[str, float]:
    """The simulator's own parameters for these errors, and what the model needs."""
    found: dict[str, float] = {"FRAME_CLASS": 1, "SIM_DRIFT_SPEED": 0, "SIM_MAG_RND": noise_mgauss}
    found |= {f"SERVO{channel}_FUNCTION": 0 for channel in (5, 6, 7, 8)}
    found |= {"SIM_IMU_COUNT": len(truth.units)}
    for i, unit in enumerate(truth.units, start=1):
        found |= _vector(f"SIM_ACC{i}_BIAS", unit.accel_offset)
        found |= _vector(f"SIM_ACC{i}_SCAL", 1.0 / unit.accel_scale)
        found |= _vector(f"SIM_GYR{i}_BIAS", unit.gyro_offset)
    for i, compass in enumerate(truth.compasses, start=1):
        found |= _vector(f"SIM_MAG{i}_OFS", compass.added / MGAUSS)
        found |= _vector(f"SIM_MAG{i}_DIA", np.diag(compass.matrix))
        found |= _vector(f"SIM_MAG{i}_ODI", compass.matrix[(0, 0, 1), (1, 2, 2)])
    return found


def drifting(truth: VehicleTruth, t_min: float, t_max: float) -> Mapping[str, float]:
    """The same for the drift with temperature, which refers to the middle of the range."""
    found: dict[str, float] = {}
    for i, unit in enumerate(truth.units, start=1):
        found |= {f"SIM_IMUT{i}_ENABLE": 1, f"SIM_IMUT{i}_TMIN": t_min, f"SIM_IMUT{i}_TMAX": t_max}
        for order in range(3):
            found |= _vector(f"SIM_IMUT{i}_ACC{order + 1}", 1e6 * unit.accel_drift[order])
            found |= _vector(f"SIM_IMUT{i}_GYR{order + 1}", 1e6 * unit.gyro_drift[order])
    return found


def _vector(stem: str, values: Sequence[float] | np.ndarray[Any, np.dtype[np.float64]]) -> dict[str, float]:
    return {f"{stem}_{axis}": float(value) for axis, value in zip("XYZ", values, strict=True)}
