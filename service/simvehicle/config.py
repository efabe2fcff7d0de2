"""Configuration of a simulated vehicle, frozen, read from a dict or a JSON file."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from enum import StrEnum
from pathlib import Path
from typing import Any

from mavcal.service.simvehicle.errors import ConfigurationError

MAX_IMUS = 3
MAX_MAGS = 3


class SimAutopilot(StrEnum):
    """The simulated firmware."""

    ARDUPILOT = "ardupilot"
    PX4 = "px4"


class Calibration(StrEnum):
    """Calibration in the parameters of a vehicle that is started for the first time."""

    EARLIER = "earlier"  # near the truth, as of a calibration some time ago
    FRESH = "fresh"  # the truth, as of a calibration just now
    NONE = "none"  # a new board: neutral everywhere


@dataclass(frozen=True)
class VehicleConfig:
    """Everything that is fixed for the life of the process. Units as in the package docstring."""

    autopilot: SimAutopilot = SimAutopilot.ARDUPILOT
    seed: int = 1
    system_id: int = 1
    imu_count: int = 3
    mag_count: int = 2
    # Canberra: the magnitude of the field changes least with the date there (0.007 µT a year).
    latitude_deg: float = -35.363262
    longitude_deg: float = 149.165237
    altitude_m: float = 584.0
    # World Magnetic Model 2025 at that place, decimal year 2026.9, north east down.
    field_ned_ut: tuple[float, float, float] = (23.0004, 5.1810, -53.0714)
    gravity: float = 9.80665
    yaw_deg: float = 0.0
    accel_noise: float = 0.02  # m/s², sd of one output sample
    gyro_noise: float = 1.0e-3  # rad/s
    mag_noise: float = 0.2  # µT
    thermal: bool = True  # False: no sensor depends on temperature
    temperature: float = 35.0  # °C at start
    temperature_period_s: float = 1.0  # the drivers read the temperature this often; 0: at every sample
    temperature_lag_s: float = 0.0
    imu_temperature_offsets: tuple[float, ...] = (0.0, 1.2, -0.8)
    mag_orientations: tuple[int, ...] = (0, 6, 0)  # how each magnetometer is really mounted
    mag_orientation_parameters: tuple[int, ...] | None = None  # what the parameters say; None: the truth
    # Roll, pitch, yaw in degrees of a magnetometer whose mounting has no number; None: by mag_orientations.
    mag_angles_deg: tuple[tuple[float, float, float] | None, ...] = ()
    mag_external: tuple[bool, ...] = (False, True, False)
    board_orientation: int = 0
    highres: bool = True  # False: ArduPilot up to 4.5, which has no HIGHRES_IMU and refuses every interval of it
    highres_mag_defect: bool = True  # ArduPilot 4.7-dev before 2026-02 multiplies by 1000 instead of dividing
    sitl: bool = False  # PX4: the simulator build refuses to reboot and knows no TC_* module
    calibration: Calibration = Calibration.EARLIER
    factory: bool = False  # never booted before: hidden groups hold zeros, no row of PX4 has an id; nothing calibrated
    gps: bool = True
    unique_id: bool = True  # False: zeros, as boards say that have none
    signing_key: str = ""  # 64 hexadecimal digits: what the vehicle signs with, and all that it listens to
    boot_s: float = 3.0
    agreement_s: float = 0.0  # ArduPilot: its IMUs must have agreed for so long since the start; the firmware wants 10
    stream_start_s: float = 0.0  # how long after the request a stream begins; ArduCopter was seen to take .97 s
    unix_time_s: float = 0.0  # 0: the wall clock's
    truth: Mapping[str, Any] = field(default_factory=dict)  # overrides of the drawn truth, merged deeply
    parameters: Mapping[str, float] = field(default_factory=dict)  # initial values by name
    further_parameters: int = 0  # so many more that act on nothing: a real list is long


def load_config(source: str | Mapping[str, Any] | None, base: VehicleConfig | None = None) -> VehicleConfig:
    """The configuration of a dict, a JSON text or a JSON file, on top of `base`.

    Raises ConfigurationError if the text is no JSON object, or an entry is unknown or of the wrong kind.
    """
    base = base or VehicleConfig()
    if source is None or source == "":
        return base
    given = source if isinstance(source, Mapping) else _read_json(source)
    known = {f.name: f for f in fields(VehicleConfig)}
    unknown = sorted(set(given) - set(known))
    if unknown:
        raise ConfigurationError(f"unknown configuration {', '.join(unknown)}; known: {', '.join(known)}")
    values = {name: _converted(name, value, getattr(base, name)) for name, value in given.items()}
    return _checked(replace(base, **values))


def _read_json(text: str) -> Mapping[str, Any]:
    try:
        raw = text if text.lstrip().startswith("{") else Path(text).read_text(encoding="utf-8")
        given = json.loads(raw)
    except OSError as error:
        raise ConfigurationError(f"configuration file {text} cannot be read: {error.strerror}") from error
    except ValueError as error:
        raise ConfigurationError(f"configuration is no JSON: {error}") from error
    if not isinstance(given, dict):
        raise ConfigurationError("configuration must be a JSON object")
    return given


def _converted(name: str, value: Any, present: Any) -> Any:
    try:
        if name == "autopilot":
            return SimAutopilot(value)
        if name == "calibration":
            return Calibration(value)
        if name == "mag_orientation_parameters":
            return None if value is None else tuple(int(v) for v in value)
        if name == "mag_angles_deg":
            return tuple(None if entry is None else _angles(entry) for entry in value)
        if isinstance(present, Mapping):
            return dict(value)
        if isinstance(present, tuple):
            kind = type(present[0])
            return tuple(kind(v) for v in value)
        if isinstance(present, bool):
            if not isinstance(value, bool):
                raise ValueError("must be true or false")
            return value
        return type(present)(value)
    except (TypeError, ValueError) as error:
        raise ConfigurationError(f"configuration {name} = {value!r} cannot be used: {error}") from error


def _angles(entry: Any) -> tuple[float, float, float]:
    roll, pitch, yaw = (float(angle) for angle in entry)
    if not all(math.isfinite(angle) for angle in (roll, pitch, yaw)):
        raise ValueError("an angle must be finite")
    return roll, pitch, yaw


def _checked(config: VehicleConfig) -> VehicleConfig:
    if config.factory:
        config = replace(config, calibration=Calibration.NONE)
    if not 1 <= config.imu_count <= MAX_IMUS:
        raise ConfigurationError(f"imu_count must be 1..{MAX_IMUS}, got {config.imu_count}")
    if not 0 <= config.mag_count <= MAX_MAGS:
        raise ConfigurationError(f"mag_count must be 0..{MAX_MAGS}, got {config.mag_count}")
    if not 1 <= config.system_id <= 255:
        raise ConfigurationError(f"system_id must be 1..255, got {config.system_id}")
    for name, least in (("imu_temperature_offsets", config.imu_count), ("mag_orientations", config.mag_count)):
        if len(getattr(config, name)) < least:
            raise ConfigurationError(f"{name} needs {least} entries")
    if config.signing_key and not re.fullmatch("[0-9a-fA-F]{64}", config.signing_key):
        raise ConfigurationError("signing_key needs 64 hexadecimal digits")
    if not config.stream_start_s >= 0:
        raise ConfigurationError(f"stream_start_s must not be below 0, got {config.stream_start_s}")
    if len(config.field_ned_ut) != 3:
        raise ConfigurationError("field_ned_ut needs three numbers: north, east, down in µT")
    return config
