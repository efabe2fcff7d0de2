"""Which parameters make an autopilot stream a quantity. A telemetry log holds only what was sent over its link.

ArduPilot: ``SRn_*`` of each port, ``MAVn_*`` from 4.7 on (``GCS_MAVLink_Parameters.cpp``, groups of messages of
``GCS_MAVLink_Copter.cpp`` and its like). PX4: ``MAV_n_MODE`` (``mavlink_main.cpp``). Both take SET_MESSAGE_INTERVAL.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Final

from mavcal.calib.firmware.log_options import Logged

if TYPE_CHECKING:
    from collections.abc import Mapping

    from mavcal.calib.firmware.plan import Value
    from mavcal.calib.recording import Identity

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


def how_to_stream(what: Logged, identity: Identity, parameters: Mapping[str, Value], rate: float = 0.0) -> str:
    """How to have it streamed, at `rate` Hz or more if given; empty for an unknown autopilot."""
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
