"""Messages beside the inertial ones: attitude, position, current, throttle; and whether channels are messages."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray
from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.calib.firmware.stream.messages import INERTIAL
from mavcal.calib.geometry import quaternion_from_euler
from mavcal.calib.recording import Array, Channel, Sensor, Stage

if TYPE_CHECKING:
    from collections.abc import Callable

    from mavcal.calib.recording import Recording


Values = tuple[NDArray[np.bool_], Array]

ATTITUDE: Final = dialect.MAVLINK_MSG_ID_ATTITUDE
ATTITUDE_QUATERNION: Final = dialect.MAVLINK_MSG_ID_ATTITUDE_QUATERNION
GLOBAL_POSITION_INT: Final = dialect.MAVLINK_MSG_ID_GLOBAL_POSITION_INT
GPS_RAW_INT: Final = dialect.MAVLINK_MSG_ID_GPS_RAW_INT
SYS_STATUS: Final = dialect.MAVLINK_MSG_ID_SYS_STATUS
BATTERY_STATUS: Final = dialect.MAVLINK_MSG_ID_BATTERY_STATUS
VFR_HUD: Final = dialect.MAVLINK_MSG_ID_VFR_HUD


def _attitude(rows: NDArray[Any]) -> Values:
    q = quaternion_from_euler(*(rows[name].astype(np.float64) for name in ("roll", "pitch", "yaw")))
    return np.asarray(np.isfinite(q).all(axis=1)), q


def _quaternion(rows: NDArray[Any]) -> Values:
    q = np.stack([rows[name].astype(np.float64) for name in ("q1", "q2", "q3", "q4")], axis=1)
    norm = np.linalg.norm(q, axis=1)
    good = np.isfinite(norm) & (norm > 0.5)
    return good, q / np.where(good, norm, 1.0)[:, None]


def _position(rows: NDArray[Any]) -> Values:
    values = np.stack([rows["lat"] * 1e-7, rows["lon"] * 1e-7, rows["alt"] * 1e-3], axis=1)
    return (rows["lat"] != 0) | (rows["lon"] != 0), values


def _gps(rows: NDArray[Any]) -> Values:
    known, values = _position(rows)
    return known & (rows["fix_type"] >= dialect.GPS_FIX_TYPE_3D_FIX), values


def _current(rows: NDArray[Any]) -> Values:
    return rows["current_battery"] >= 0, rows["current_battery"][:, None] * 0.01  # cA; -1: not measured


def _battery(rows: NDArray[Any]) -> Values:
    known, values = _current(rows)
    return known & (rows["id"] == 0), values  # the first battery is the one that compensations use


def _throttle(rows: NDArray[Any]) -> Values:
    return rows["throttle"] <= 100, rows["throttle"][:, None] * 0.01  # per cent


_READERS: Final[dict[int, tuple[Sensor, str, Callable[[NDArray[Any]], Values]]]] = {
    ATTITUDE: (Sensor.ATTITUDE, "1", _attitude),
    ATTITUDE_QUATERNION: (Sensor.ATTITUDE, "1", _quaternion),
    GLOBAL_POSITION_INT: (Sensor.POSITION, "deg deg m", _position),
    GPS_RAW_INT: (Sensor.POSITION, "deg deg m", _gps),
    SYS_STATUS: (Sensor.CURRENT, "A", _current),
    BATTERY_STATUS: (Sensor.CURRENT, "A", _battery),
    VFR_HUD: (Sensor.THROTTLE, "1", _throttle),
}


class Auxiliary:
    """Makes channels of these messages; a late frame is left out."""

    message_ids: Final = frozenset(_READERS)

    def __init__(self) -> None:
        self._newest: dict[int, float] = {}

    def feed(self, message_id: int, t: Array, rows: NDArray[Any]) -> list[Channel]:
        """The channel of `rows` at times `t`; none if nothing in them is valid."""
        sensor, unit, reader = _READERS[message_id]
        valid, values = reader(rows)
        reached = np.maximum.accumulate(np.concatenate(([self._newest.get(message_id, -np.inf)], t)))
        self._newest[message_id] = float(reached[-1])
        keep = valid & (t >= reached[:-1]) & np.isfinite(t)
        if not keep.any():
            return []
        name = str(dialect.mavlink_map[message_id].msgname)
        return [Channel(sensor, 0, t[keep], values[keep], unit, Stage.RAW, name)]


STREAMED: Final = frozenset(
    str(dialect.mavlink_map[number].msgname)
    for number in {*(n for messages in INERTIAL.values() for n in messages), *Auxiliary.message_ids}
)
"""Sources of the channels that messages of MAVLink bring. No logger on board calls its own so."""


def telemetry(recording: Recording) -> bool:
    """Whether the samples came over a link: what they are and how often is set by stream rates, not by a logger."""
    return any(channel.source in STREAMED for channel in recording.channels)
