"""Compares the sensors of a recording with those of a vehicle, by device id and position."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Final

from mavcal.calib.errors import FirmwareError
from mavcal.calib.firmware.in_force.fingerprint import SENSOR_IDS
from mavcal.calib.firmware.names import ARDUPILOT_CUSTOM, BOARD_ROTATION, ROTATION_EULER, Role
from mavcal.calib.firmware.plan import Value
from mavcal.calib.firmware.slots import CALIBRATED, ardupilot_calibration_names, px4_calibration_names
from mavcal.calib.fit import FitResult, FitStatus
from mavcal.calib.recording import Identity, Recording, Sensor

_NAMES: Final = {"ardupilot": ardupilot_calibration_names, "px4": px4_calibration_names}
_MOUNTING: Final = (Role.ROTATION, Role.EXTERNAL, *ROTATION_EULER)


@dataclass(frozen=True)
class Origin:
    """Origin of the fits of a recording.

    `sensors` are the fitted ones as (sensor, instance, device id), the id 0 where the recording does not say it;
    `mounting` holds the parameters that say how they are mounted. `uid` is None where the recording does not say it.
    """

    autopilot: str
    uid: str | None
    sensors: tuple[tuple[str, int, int], ...]
    mounting: Mapping[str, Value]


def origin_of(recording: Recording, fits: Iterable[FitResult]) -> Origin:
    """The origin of `fits` of `recording`; refused fits do not count.

    Raises
    ------
    FirmwareError
        If the recording is of neither ArduPilot nor PX4, or does not hold the vehicle's parameters.
    """
    autopilot = recording.identity.autopilot
    parameters = recording.parameters.final()
    if autopilot is None or autopilot not in SENSOR_IDS:
        raise FirmwareError(
            "the recording does not say which vehicle it is of (a table never does): give the vehicle's own log"
        )
    if not parameters:
        raise FirmwareError("the recording holds no parameters, so nothing says which sensors it is of")
    ids: Mapping[tuple[Sensor, int], int] = SENSOR_IDS[autopilot](parameters)
    fitted = {(f.sensor, f.instance) for f in fits if f.status != FitStatus.REFUSED and f.sensor in CALIBRATED}
    mounting = {BOARD_ROTATION[autopilot]}
    for sensor, instance in fitted:
        roles = _NAMES[autopilot](parameters, sensor, instance)
        mounting |= {roles[role] for role in _MOUNTING if role in roles}
    if autopilot == "ardupilot":
        used = [ARDUPILOT_CUSTOM.get(int(parameters.get(name, 0)), ()) for name in mounting]
        mounting.update(name for angles in used for name in angles)
    return Origin(
        autopilot,
        recording.identity.uid,
        tuple(sorted((s.value, i, ids.get((s, i), 0)) for s, i in fitted)),
        {name: parameters[name] for name in sorted(mounting) if name in parameters},
    )


def differences(origin: Origin, identity: Identity, parameters: Mapping[str, Value]) -> tuple[str, ...]:
    """Reasons against writing fits of that origin to this vehicle, one sentence each; empty: none."""
    if identity.autopilot != origin.autopilot:
        return (f"the recording is of {origin.autopilot}, the vehicle runs {identity.autopilot}",)
    found = []
    if not origin.sensors:
        found.append("no sensor has a usable fit")
    if origin.uid and identity.uid and _without_padding(origin.uid) != _without_padding(identity.uid):
        found.append(f"the recording is of the board {origin.uid}, this is {identity.uid}")
    ids: Mapping[tuple[Sensor, int], int] = SENSOR_IDS[origin.autopilot](parameters)
    for name, instance, logged in origin.sensors:
        held = ids.get((Sensor(name), instance), 0)
        if not logged:
            found.append(f"the recording does not say the device id of {name} {instance + 1}")
        elif held != logged:
            found.append(f"{name} {instance + 1} had the device id {logged}, on this vehicle it has {held or 'none'}")
    for name, then in origin.mounting.items():
        now = parameters.get(name)
        if now != then:
            found.append(f"{name} was {then} in the recording and is {'not known' if now is None else now} here")
    return tuple(found)


def unproved(origin: Origin, identity: Identity) -> str:
    """Doubt that a recording is of this very vehicle, as a sentence; empty: the boards' ids show it."""
    if not origin.uid:
        reason = "the recording does not say which board it is of (no AUTOPILOT_VERSION in it)"
    elif not identity.uid:
        reason = "this vehicle does not say which board it is (no AUTOPILOT_VERSION)"
    else:
        return ""
    return f"{reason}, and equal builds share the device ids of their sensors"


def _without_padding(uid: str) -> str:
    """Digits without the zero bytes that fill the end."""
    uid = uid.lower()
    while uid.endswith("00"):
        uid = uid[:-2]
    return uid
