"""What has to be set so that an autopilot logs a thing: bits of LOG_BITMASK (ArduPilot) and of SDLOG_PROFILE (PX4).

Sources: ``@Bitmask`` of LOG_BITMASK in ArduCopter, ArduPlane, Rover and ArduSub ``Parameters.cpp``; ``SDLOG_PROFILE``
and ``logged_topics.cpp`` of PX4.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from types import MappingProxyType
from typing import TYPE_CHECKING, Final

from pymavlink.dialects.v20 import ardupilotmega as dialect

if TYPE_CHECKING:
    from mavcal.calib.firmware.plan import Value
    from mavcal.calib.recording import Identity


class Logged(StrEnum):
    """What a log may hold."""

    ATTITUDE = "attitude"
    POSITION = "position"
    INERTIAL = "inertial"  # samples at 25 Hz or so, temperatures, VIBE
    FAST_INERTIAL = "fast_inertial"  # at the rate of the control loop
    RAW_INERTIAL = "raw_inertial"  # every sample, before the filters
    COMPASS = "compass"
    CURRENT = "current"
    THROTTLE = "throttle"


@dataclass(frozen=True)
class LogBit:
    """A bit by its number and the name that ground stations show."""

    number: int
    name: str


_EVERY: Final = {
    Logged.ATTITUDE: LogBit(0, "Fast Attitude"),
    Logged.POSITION: LogBit(2, "GPS"),
    Logged.THROTTLE: LogBit(4, "Control Tuning"),
    Logged.INERTIAL: LogBit(7, "IMU"),
    Logged.FAST_INERTIAL: LogBit(19, "Raw IMU"),
    Logged.RAW_INERTIAL: LogBit(19, "Raw IMU"),
    Logged.CURRENT: LogBit(9, "Battery Monitor"),
}
_COPTER: Final[Mapping[Logged, LogBit]] = {
    **_EVERY,
    Logged.COMPASS: LogBit(13, "Compass"),
    Logged.FAST_INERTIAL: LogBit(18, "Fast IMU"),
}
_ARDUPILOT: Final[Mapping[int, Mapping[Logged, LogBit]]] = MappingProxyType(
    {
        dialect.MAV_TYPE_QUADROTOR: _COPTER,
        dialect.MAV_TYPE_SUBMARINE: _COPTER,
        dialect.MAV_TYPE_FIXED_WING: {**_EVERY, Logged.COMPASS: LogBit(10, "Compass")},
        dialect.MAV_TYPE_GROUND_ROVER: {
            **_EVERY,
            Logged.COMPASS: LogBit(11, "Compass"),
            Logged.THROTTLE: LogBit(4, "Throttle"),
        },
    }
)
"""By kind of vehicle as :func:`calib.logs.dataflash.said.identity_of` tells them; copters of every shape are one."""
_DISARMED: Final = {"ardupilot": "LOG_DISARMED 1", "px4": "SDLOG_MODE 2"}
_PX4: Final[Mapping[Logged, LogBit]] = {
    **dict.fromkeys(Logged, LogBit(0, "Default set")),
    Logged.FAST_INERTIAL: LogBit(3, "System identification"),
    Logged.RAW_INERTIAL: LogBit(9, "Raw FIFO high-rate IMU (Accel)"),
    Logged.COMPASS: LogBit(6, "Sensor comparison"),
}
_NAMES: Final[Mapping[Logged, LogBit]] = {
    **_COPTER,
    Logged.COMPASS: LogBit(-1, "Compass"),
    Logged.FAST_INERTIAL: LogBit(-1, "Fast IMU"),
}


def how_to_log(what: Logged, identity: Identity, parameters: Mapping[str, Value]) -> str:
    """What to do to have it logged, one sentence; empty for a vehicle of another autopilot."""
    if identity.autopilot == "px4":
        name, bits = "SDLOG_PROFILE", _PX4
    elif identity.autopilot == "ardupilot":
        name, bits = "LOG_BITMASK", _ARDUPILOT.get(identity.vehicle_type or -1, _NAMES)
    else:
        return ""
    bit = bits[what]
    if bits is _NAMES and bit.number < 0:  # its number depends on the vehicle, which the log does not say
        return f'Set "{bit.name}" in {name}.'
    text = f"{name} bit {bit.number} ({bit.name})"
    if _is_set(parameters.get(name), bit.number):
        return f"{text} is set already: this firmware does not log it, or the sensor is missing."
    return f"Set {text}."


def how_to_log_disarmed(autopilot: str | None) -> str:
    """The parameter and value by which a vehicle logs while disarmed; of both autopilots where it is not known."""
    return _DISARMED.get(autopilot or "", ", ".join(_DISARMED.values()))


def _is_set(mask: Value | None, bit: int) -> bool:
    """Whether that bit of `mask` is set; False where the mask is not known. Old firmwares store 16 signed bits."""
    return mask is not None and abs(mask) < 2**53 and bool(int(mask) >> bit & 1)
