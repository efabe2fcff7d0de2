"""Parameters that make an autopilot log or stream a quantity.

Logs: bits of LOG_BITMASK (ArduPilot: ``@Bitmask`` in ArduCopter, ArduPlane, Rover and ArduSub ``Parameters.cpp``) and
of SDLOG_PROFILE (PX4: ``logged_topics.cpp``). Streams: ``SRn_*`` of each port, ``MAVn_*`` from 4.7 on (ArduPilot:
``GCS_MAVLink_Parameters.cpp``, groups of messages of ``GCS_MAVLink_Copter.cpp`` and its like), ``MAV_n_MODE`` (PX4:
``mavlink_main.cpp``). Both take SET_MESSAGE_INTERVAL. A telemetry log holds only what was sent over its link.
"""

from __future__ import annotations

import re
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
    """Contents that a log may have."""

    ATTITUDE = "attitude"
    POSITION = "position"
    INERTIAL = "inertial"  # samples at 25 Hz or so, temperatures, VIBE
    FAST_INERTIAL = "fast_inertial"  # at the rate of the control loop
    RAW_INERTIAL = "raw_inertial"  # every sample, before the filters
    COMPASS = "compass"
    CURRENT = "current"
    THROTTLE = "throttle"


MESSAGES: Final[Mapping[Logged, tuple[str, str]]] = {
    Logged.ATTITUDE: ("EXTRA1", "ATTITUDE"),
    Logged.POSITION: ("POSITION", "GLOBAL_POSITION_INT"),
    Logged.INERTIAL: ("RAW_SENS", "SCALED_IMU"),
    Logged.FAST_INERTIAL: ("RAW_SENS", "RAW_IMU"),
    Logged.RAW_INERTIAL: ("RAW_SENS", "RAW_IMU"),
    Logged.COMPASS: ("RAW_SENS", "RAW_IMU"),
    Logged.CURRENT: ("EXT_STAT", "SYS_STATUS"),
    Logged.THROTTLE: ("EXTRA2", "VFR_HUD"),
}
"""ArduPilot's stream group, and the message that carries the quantity."""
RENAMED_SINCE: Final = (4, 7)
"""First ArduPilot version that names the stream groups MAVn_*, not SRn_*."""
_PORT: Final = re.compile(r"(SR|MAV)(\d+)_(RAW_SENS|EXT_STAT|POSITION|EXTRA[123])")


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


"""By kind of vehicle as :func:`calib.logs.dataflash.events.identity_of` tells them; copters of every shape are one."""
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
    """Instruction to have it logged, one sentence; empty for a vehicle of another autopilot."""
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


def how_to_stream(what: Logged, identity: Identity, parameters: Mapping[str, Value], rate: float = 0.0) -> str:
    """Instruction to have it streamed, at `rate` Hz or more if given; empty for an unknown autopilot."""
    if identity.autopilot not in ("ardupilot", "px4"):
        return ""
    group, message = MESSAGES[what]
    if identity.autopilot == "px4" and message == "RAW_IMU":
        message = "SCALED_IMU"
    often = f" at {rate:.0f} Hz or more" if rate else ""
    if identity.autopilot == "px4":
        return f"Ask for {message}{often} (SET_MESSAGE_INTERVAL), or set MAV_n_MODE of the link to 2 (Onboard)."
    name = _group_name(group, identity, parameters)
    value = parameters.get(name)
    now = "" if value is None else f" (it is {value:g})"
    return f"Raise {name}{f' to {rate:.0f}' if rate else ''}{now}, or ask for {message}{often} (SET_MESSAGE_INTERVAL)."


def _group_name(group: str, identity: Identity, parameters: Mapping[str, Value]) -> str:
    """The parameter of the link that was recorded: the only one that is known, else with n for its number."""
    known = {match.group(1, 2) for name in parameters if (match := _PORT.fullmatch(name))}
    if len(known) == 1:
        stem, port = next(iter(known))
        return f"{stem}{port}_{group}"
    late = any(stem == "MAV" for stem, _ in known)
    if not known:
        late = identity.firmware is not None and identity.firmware[:2] >= RENAMED_SINCE
    return f"{'MAV' if late else 'SR'}n_{group}"
