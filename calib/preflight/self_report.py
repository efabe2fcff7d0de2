"""The vehicle's own report: onboard calibration, arming checks and their result."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from mavcal.calib.firmware.plan import Value
from mavcal.calib.firmware.values import shown
from mavcal.calib.preflight.check import Check, CheckId, OwnView, Snapshot, Subject, Verdict, unknown

_ALL_CHECKS = 1
"""ARMING_CHECK of ArduPilot before 4.7: a mask of what is checked, 1 for everything. ARMING_SKIPCHK, since then, is a
mask of what is skipped; both names with what they mean from the parameter documentation."""
ARMING = {
    "ardupilot": ("ARMING_CHECK", "ARMING_SKIPCHK", "COMPASS_ENABLE"),
    "px4": ("COM_ARM_MAG_STR", "COM_ARM_MAG_ANG", "SYS_HAS_MAG"),
}
"""What :func:`arming_checks` looks at, by autopilot."""
_LISTENED = ("MAG_CAL_PROGRESS, MAG_CAL_REPORT and the vehicle's texts on calibrations, listened to all the time",)
_ESTIMATOR = ("ekf", "ahrs", "dcm", "attitude", "estimator", "heading", "yaw")
"""Words in a firmware's complaints if a sensor makes its estimator wrong."""
AGREES_S = 11.0
"""ArduPilot arms once its IMUs have agreed for 10 s (``AP_Arming::ins_accels_consistent``, ``ins_gyros_consistent``).
One second more, because it checks once a second."""
_AGREEING = ("accels inconsistent", "gyros inconsistent")
_WORDS = {
    CheckId.SENSORS_HEARD: ("gyro", "accel", "imu", "ins", "compass", "mag", *_ESTIMATOR),
    CheckId.GYRO_REST: ("gyro", "imu", *_ESTIMATOR),
    CheckId.GYRO_NOISE: ("gyro", "imu", *_ESTIMATOR),
    CheckId.ACCEL_FORCE: ("accel", "imu", *_ESTIMATOR),
    CheckId.COMPASS_FIELD: ("compass", "mag", *_ESTIMATOR),
    CheckId.COMPASS_DIRECTION: ("compass", "mag", *_ESTIMATOR),
    CheckId.ATTITUDE: _ESTIMATOR,
    CheckId.VIBRATION: ("accel", "imu", "vibration", *_ESTIMATOR),
    CheckId.ONBOARD_CALIBRATION: ("calibration running", "calibrating", "calibration in progress"),
}
_GENERAL = (CheckId.PARAMETERS_CHANGED, CheckId.SENSOR_IDS, CheckId.TEMPERATURE)
"""Checks whose failure explains a vehicle's complaint about any sensor."""


def onboard_calibration(snapshot: Snapshot) -> Check:
    """A running calibration streams uncorrected values and refuses arming."""
    of, calibrating = CheckId.ONBOARD_CALIBRATION, snapshot.view.calibrating
    if calibrating is None:
        return unknown(of, "The vehicle did not say whether it calibrates by itself.")
    if calibrating:
        reason = "The vehicle runs a calibration of its own."
        return Check(of, Verdict.FAIL, None, None, None, "", reason, "Let it finish, or cancel it there.", _LISTENED)
    good = "The vehicle runs no calibration of its own."
    return Check(of, Verdict.PASS, None, None, None, "", good, evidence=_LISTENED)


def arming_checks(snapshot: Snapshot) -> Check:
    """Whether a parameter switches the vehicle's checks off: disabled is not pass."""
    of = CheckId.ARMING_CHECKS
    autopilot, parameters = snapshot.identity.autopilot or "", snapshot.parameters
    known = [name for name in ARMING.get(autopilot, ()) if name in parameters]
    if not known:
        return unknown(of, "No parameter tells whether the vehicle checks itself before arming.")
    off, read = switched_off(autopilot, parameters), [f"{name} = {shown(parameters[name], 6)}" for name in known]
    if off:
        reason = f"The vehicle does not check all of itself before arming: {'; '.join(off)}. Disabled is not pass."
        return Check(of, Verdict.WARN, None, None, None, "", reason, "Switch the checks on again.", (*off, *read))
    if not snapshot.complete and len(known) < len(ARMING[autopilot]):
        return unknown(of, "Not every arming parameter could be read in time.", "Check again on a faster link.", read)
    return Check(of, Verdict.PASS, None, None, None, "", "No arming check is switched off.", evidence=tuple(read))


def switched_off(autopilot: str, parameters: Mapping[str, Value]) -> list[str]:
    """Sentences on every check that a parameter switches off."""
    value = {name: int(parameters[name]) for name in ARMING.get(autopilot, ()) if name in parameters}
    off = []
    if autopilot == "ardupilot":
        if value.get("ARMING_CHECK", _ALL_CHECKS) != _ALL_CHECKS:
            off.append(f"ARMING_CHECK is {value['ARMING_CHECK']}, 1 is everything")
        if value.get("ARMING_SKIPCHK", 0) != 0:
            off.append(f"ARMING_SKIPCHK is {value['ARMING_SKIPCHK']}, 0 skips nothing")
        if value.get("COMPASS_ENABLE", 1) == 0:
            off.append("COMPASS_ENABLE is 0")
    else:
        if value.get("COM_ARM_MAG_STR", 1) == 0:
            off.append("COM_ARM_MAG_STR is 0: the strength of the field is not checked")
        if value.get("COM_ARM_MAG_ANG", 60) < 0:
            off.append("COM_ARM_MAG_ANG is negative: compasses are not compared")
        if value.get("SYS_HAS_MAG", 1) == 0:
            off.append("SYS_HAS_MAG is 0")
    return off


def vehicle_prearm(view: OwnView, autopilot: str, parameters: Mapping[str, Value], failed: Sequence[CheckId]) -> Check:
    """Check of the vehicle's own verdict, in its own words.

    `failed` are our failed checks, whose consequences do not count.
    """
    of, heard = CheckId.VEHICLE_PREARM, (*view.texts, *_bits(view))
    if view.texts or view.ready is False:
        own = "; ".join(f"'{text}'" for text in view.texts) or "it says that it is not ready, and not why"
        reason, remedy = f"The vehicle would not arm now: {own}.", "Do what the vehicle asks for, then check again."
        known = [of for of in failed if of in _WORDS or of in _GENERAL]
        if known and all(_explained(text, known) for text in view.texts):
            reason += f" This follows from {', '.join(known)}."
            return Check(of, Verdict.WARN, None, None, None, "", reason, "Mend that first.", heard)
        return Check(of, Verdict.FAIL, None, None, None, "", reason, remedy, heard)
    if autopilot == "ardupilot" and _nothing_checked(parameters):
        why = "Its arming checks are switched off, so its consent proves nothing."
        return unknown(of, why, "Switch them on again.", heard)
    if view.ready is None:
        why = "SYS_STATUS was not heard" if view.present is None else "SYS_STATUS does not carry the prearm check"
        remedy = "Check again over a better link." if view.present is None else ""
        return unknown(of, f"The vehicle does not say whether it would arm: {why}.", remedy, heard)
    asked = "its own checks, run now, pass" if view.asked else "its own checks pass"
    return Check(of, Verdict.PASS, None, None, None, "", f"This vehicle would arm now: {asked}.", evidence=heard)


def agrees_soon(autopilot: str, prearm: Check, texts: Sequence[str]) -> bool:
    """Whether waiting may help: ArduPilot reports inconsistent IMUs, and none of our checks explains that."""
    disagrees = any(words in text.lower() for text in texts for words in _AGREEING)
    return autopilot == "ardupilot" and prearm.verdict == Verdict.FAIL and disagrees


def _bits(view: OwnView) -> tuple[str, ...]:
    """Contents of SYS_STATUS and of the reply, as lines of evidence."""
    asked = "its checks were run on request" if view.asked else "its checks were not run on request"
    if view.present is None:
        return (asked, "SYS_STATUS was not heard")
    there = "is present and switched on" if view.present else "is not among what is present and switched on"
    state = {None: "", True: "; the vehicle says that it is ready", False: "; the vehicle says that it is not ready"}
    return asked, f"SYS_STATUS: the prearm check {there}{state[view.ready]}"


def _nothing_checked(parameters: Mapping[str, Value]) -> bool:
    return int(parameters.get("ARMING_CHECK", _ALL_CHECKS)) == 0 or int(parameters.get("ARMING_SKIPCHK", 0)) == -1


def _explained(text: str, failed: Sequence[CheckId]) -> bool:
    """Whether one of our failed checks explains the complaint in this text."""
    lower = text.lower()
    of_sensors = any(word in lower for words in _WORDS.values() for word in words)
    return any((of in _GENERAL and of_sensors) or any(word in lower for word in _WORDS.get(of, ())) for of in failed)


SUBJECT = Subject((onboard_calibration, arming_checks), ARMING)
