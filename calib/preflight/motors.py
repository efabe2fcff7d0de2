"""Plausibility of the compasses' motor compensation, at rest."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from mavcal.calib.errors import FirmwareError
from mavcal.calib.firmware import calibration_names
from mavcal.calib.firmware.names import MOTOR, Role
from mavcal.calib.firmware.plan import Value
from mavcal.calib.preflight import limits
from mavcal.calib.preflight.check import Check, CheckId, Measure, Verdict, judged, unknown
from mavcal.calib.preflight.snapshot import Snapshot
from mavcal.calib.recording import Sensor

_UT = {"ardupilot": 0.1, "px4": 100.0}
_PX4_PER_KA = 1e-3
_BY_CURRENT = {"ardupilot": (2,), "px4": (2, 3)}
_TYPES = {"ardupilot": "COMPASS_MOTCT", "px4": "CAL_MAG_COMP_TYP"}
_PER_MOTOR = 3
_REMEDY = "Measure the motor compensation again, or switch it off."


def motor_compensation(snapshot: Snapshot, strength: float) -> Check:
    """What the compensation in force takes away at full power, as a share of the field of `strength` (uT)."""
    of = CheckId.MOTOR_COMPENSATION
    autopilot, parameters = snapshot.identity.autopilot or "", snapshot.parameters
    name = _TYPES.get(autopilot, "")
    kind = int(parameters.get(name, 0))
    read = (f"{name} = {kind}" if name in parameters else f"the vehicle has no {name or 'such parameter'}",)
    if name not in parameters and not snapshot.complete:
        return unknown(of, f"{name} could not be read in time.", "Check again on a faster link.")
    if kind == 0:
        return Check(of, Verdict.PASS, None, None, None, "", "No motor compensation is in force.", evidence=read)
    if autopilot == "ardupilot" and kind == _PER_MOTOR:
        return unknown(of, "Compensation by single motors is not judged.", evidence=read)
    by_current = kind in _BY_CURRENT[autopilot]
    if by_current and snapshot.current_known is False:
        reason = "The compensation goes by battery current, and the vehicle measures none."
        return Check(
            of, Verdict.FAIL, None, None, None, "", reason, "Set up the current sensor, or switch it off.", read
        )
    limit = limits.MOTOR_SHARE
    measures = []
    for instance in snapshot.recording.instances(Sensor.MAG):
        taken = _compensation_length(autopilot, parameters, instance, by_current=by_current)
        if taken:
            name = f"compensation of compass {instance + 1} at full power, of the field"
            measures.append(Measure(name, taken / strength, 0.0, limit.value, limit.unit))
    if not measures:
        reason = "Motor compensation is switched on, and its vectors are all zero."
        return Check(of, Verdict.WARN, 0.0, 0.0, limit.value, "", reason, _REMEDY, read)
    full = f"{limits.FULL_CURRENT_A:.0f} A" if by_current else "full throttle"
    good = f"The compensation is small beside the field at {full}."
    return judged(of, measures, good=good, remedy=_REMEDY, notes=read)


def _compensation_length(autopilot: str, parameters: Mapping[str, Value], instance: int, *, by_current: bool) -> float:
    """Length of the compensation at full power, uT."""
    try:
        names = calibration_names(autopilot, parameters, Sensor.MAG, instance)
    except FirmwareError:
        return 0.0
    vector = np.array([float(parameters.get(names.get(role, Role.ID), 0.0)) for role in MOTOR])
    full = 1.0
    if by_current:
        full = limits.FULL_CURRENT_A * (_PX4_PER_KA if autopilot == "px4" else 1.0)
    return float(np.linalg.norm(vector)) * _UT[autopilot] * full
