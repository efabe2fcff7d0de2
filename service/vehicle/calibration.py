"""Is the vehicle calibrating itself? Reads every sign of it that a firmware gives, as a pure function."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.calib.wire import Message
from mavcal.service.vehicle.texts import StatusText

_POSE_SUCCESS, _POSE_FAILED = 16777215, 16777216
_MAG_RUNNING = {
    dialect.MAG_CAL_WAITING_TO_START,
    dialect.MAG_CAL_RUNNING_STEP_ONE,
    dialect.MAG_CAL_RUNNING_STEP_TWO,
}


class CalibrationSign(StrEnum):
    """The message that shows the calibration; the values are the names of messages."""

    HEARTBEAT = "HEARTBEAT"
    TEXT = "STATUSTEXT"
    POSE = "COMMAND_LONG"
    MAG = "MAG_CAL_PROGRESS"
    REPORT = "MAG_CAL_REPORT"


_STALE_S = {
    CalibrationSign.HEARTBEAT: 3.0,  # said again every second
    CalibrationSign.TEXT: 120.0,  # ends with a text, which may be lost
    CalibrationSign.POSE: 10.0,  # asked again every second
    CalibrationSign.MAG: 10.0,  # said again several times a second
    CalibrationSign.REPORT: 3.0,  # said again until it is accepted
}
"""How long after its last sign a calibration counts as running."""


@dataclass(frozen=True)
class OnboardCalibration:
    """A calibration that the vehicle runs by itself: what was heard of it, first and last time."""

    sign: CalibrationSign
    text: str
    since: float
    last: float

    def over(self, now: float) -> bool:
        """True if it was not heard of for so long that it must have ended unheard."""
        return now - self.last > _STALE_S[self.sign]


def watch_calibration(
    running: OnboardCalibration | None, message: Message, texts: tuple[StatusText, ...], now: float
) -> OnboardCalibration | None:
    """Take a message, and the texts that it completed, into account: the calibration that runs, or None."""
    kind = message.get_type()
    if kind == "HEARTBEAT":
        return _heartbeat(running, message, now)
    for text in texts:
        running = _text(running, text, now)
    if kind == "COMMAND_LONG" and message.command == dialect.MAV_CMD_ACCELCAL_VEHICLE_POS:
        if int(message.param1) in (_POSE_SUCCESS, _POSE_FAILED):
            return None
        return _goes_on(running, CalibrationSign.POSE, "an accelerometer calibration asks for poses", now)
    if kind == "MAG_CAL_PROGRESS":
        if message.cal_status in _MAG_RUNNING:
            what = f"a compass calibration is at {message.completion_pct} %"
            return _goes_on(running, CalibrationSign.MAG, what, now)
        return None if running and running.sign is CalibrationSign.MAG else running
    if kind == "MAG_CAL_REPORT":
        return _report(running, message, now)
    return running


def _goes_on(running: OnboardCalibration | None, sign: CalibrationSign, text: str, now: float) -> OnboardCalibration:
    return OnboardCalibration(sign, text, running.since if running else now, now)


def _heartbeat(running: OnboardCalibration | None, message: Message, now: float) -> OnboardCalibration | None:
    if message.system_status == dialect.MAV_STATE_CALIBRATING:
        return _goes_on(running, CalibrationSign.HEARTBEAT, "HEARTBEAT says that it is calibrating", now)
    if running is None or running.sign is CalibrationSign.HEARTBEAT:
        return None
    # the text that ends a calibration may be lost; the firmware that sends such texts shows the state here too
    ended_unheard = running.sign is CalibrationSign.TEXT and now - running.last > _STALE_S[CalibrationSign.HEARTBEAT]
    return None if ended_unheard else running


def _text(running: OnboardCalibration | None, text: StatusText, now: float) -> OnboardCalibration | None:
    what = text.text
    if not what.startswith("[cal]"):
        return running
    if any(word in what for word in ("calibration done", "calibration failed", "calibration cancelled")):
        return None
    if "started" in what or "progress" in what or "orientation detected" in what or "side done" in what:
        return _goes_on(running, CalibrationSign.TEXT, f"it said '{what}'", now)
    return running


def _report(running: OnboardCalibration | None, message: Message, now: float) -> OnboardCalibration | None:
    """ArduPilot repeats its report until it is accepted or cancelled; accepting writes parameters.

    PX4 sends the same message, with fitness 0 and no radius, whenever any parameter changes: that is no calibration.
    """
    if message.fitness == 0 and message.autosaved == 0:
        return running
    if message.autosaved:
        return None if running and running.sign in (CalibrationSign.MAG, CalibrationSign.REPORT) else running
    what = "a compass calibration has ended and waits to be accepted or cancelled"
    return _goes_on(running, CalibrationSign.REPORT, what, now)
