"""Streams to request from a vehicle.

Both firmwares give 25 and 50 Hz exactly: ArduPilot cuts intervals to whole milliseconds, PX4 rounds up to its 4 ms
loop. At 100 Hz and more the steps become uneven. FLIGHT_CONTROLLERS 2, 9, 10.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import Final

from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.calib.errors import FirmwareError
from mavcal.calib.firmware.stream import auxiliary
from mavcal.calib.firmware.stream.messages import HIGHRES_IMU, RAW_IMU, SCALED_IMU, SCALED_IMU2, SCALED_IMU3
from mavcal.calib.recording import Sensor

INERTIAL_HZ: Final = 50.0
COMPASS_HZ: Final = 25.0
STATE_HZ: Final = 2.0
DRIVE_HZ: Final = 5.0
POSITION_HZ: Final = 1.0
ATTITUDE_HZ: Final = 25.0
LIVE_MOST_HZ: Final = 200.0
"""More is granted unevenly, or refused: PX4 rounds up to its 4 ms, ArduPilot denies 400 Hz (FLIGHT_CONTROLLERS 9)."""

BY_INSTANCE: Final = {
    "ardupilot": (RAW_IMU, SCALED_IMU2, SCALED_IMU3),
    "px4": (SCALED_IMU, SCALED_IMU2, SCALED_IMU3),
}
"""The message that carries inertial unit and compass number 0, 1, 2. More are not streamed by either firmware."""


def requested_streams(autopilot: str, sensors: Collection[Sensor]) -> dict[int, float]:
    """Rates in Hz by message id that a job over `sensors` asks for.

    ArduPilot's HIGHRES_IMU is asked for besides: it carries the first inertial unit without rounding (boards with
    little flash refuse it). PX4's is not: the bias that one looks for is already subtracted from it.

    Raises
    ------
    FirmwareError
        If the autopilot is neither ArduPilot nor PX4.
    """
    if autopilot not in BY_INSTANCE:
        raise FirmwareError(f"mavcal asks ArduPilot and PX4 for streams, not autopilot {autopilot!r}")
    inertial = {Sensor.ACCEL, Sensor.GYRO} & set(sensors)
    rate = INERTIAL_HZ if inertial else COMPASS_HZ
    wanted = dict.fromkeys(BY_INSTANCE[autopilot], rate)
    if autopilot == "ardupilot":
        wanted[HIGHRES_IMU] = rate
        # silent while no onboard calibration runs, and always silent unless asked for (FLIGHT_CONTROLLERS 9)
        wanted[dialect.MAVLINK_MSG_ID_MAG_CAL_PROGRESS] = STATE_HZ
        wanted[dialect.MAVLINK_MSG_ID_MAG_CAL_REPORT] = STATE_HZ
    wanted[dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE] = STATE_HZ
    wanted[auxiliary.VFR_HUD] = STATE_HZ
    if Sensor.MAG in sensors:
        # the Earth's field needs the place; ArduPilot's motor compensation has to be undone
        wanted[auxiliary.GLOBAL_POSITION_INT] = POSITION_HZ
        wanted[auxiliary.BATTERY_STATUS] = DRIVE_HZ
        wanted[auxiliary.VFR_HUD] = DRIVE_HZ
    return wanted


def live_streams(autopilot: str, rate_hz: float) -> dict[int, float]:
    """Rates in Hz by message id for who watches: every inertial unit and compass at `rate_hz`, the attitude too.

    The messages are those of a job over the same sensors, so that both restore the same ones. Messages of the vehicle's
    state are no slower than in a job.

    Raises
    ------
    FirmwareError
        If the autopilot is neither ArduPilot nor PX4.
    """
    wanted = requested_streams(autopilot, (Sensor.ACCEL, Sensor.GYRO, Sensor.MAG))
    samples = {HIGHRES_IMU, *BY_INSTANCE[autopilot]}
    rates = {message_id: rate_hz if message_id in samples else rate for message_id, rate in wanted.items()}
    return rates | {auxiliary.ATTITUDE_QUATERNION: min(rate_hz, ATTITUDE_HZ)}
