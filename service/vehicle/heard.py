"""Messages that a vehicle needs from its links."""

from pymavlink.dialects.v20 import ardupilotmega as dialect

VERSION_ID = dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION
STATE_IDS = frozenset(
    {
        dialect.MAVLINK_MSG_ID_HEARTBEAT,
        dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE,
        dialect.MAVLINK_MSG_ID_VFR_HUD,
        dialect.MAVLINK_MSG_ID_STATUSTEXT,
        dialect.MAVLINK_MSG_ID_MAG_CAL_PROGRESS,
        dialect.MAVLINK_MSG_ID_MAG_CAL_REPORT,
        dialect.MAVLINK_MSG_ID_COMMAND_LONG,
    }
)
"""Messages that make the state."""
_CLOCK_IDS = frozenset({dialect.MAVLINK_MSG_ID_SYSTEM_TIME, dialect.MAVLINK_MSG_ID_ATTITUDE})
CORE_IDS = (
    STATE_IDS
    | _CLOCK_IDS
    | {
        VERSION_ID,
        dialect.MAVLINK_MSG_ID_PARAM_VALUE,
        dialect.MAVLINK_MSG_ID_PARAM_ERROR,
        dialect.MAVLINK_MSG_ID_COMMAND_ACK,
        dialect.MAVLINK_MSG_ID_MESSAGE_INTERVAL,
    }
)
"""Messages that every vehicle needs of its link."""
