"""Names of the parameters that a job needs, so that a slow link need not carry the whole list.

A name that decides about others (a device id, a switch, a mounting) is read first. Call :func:`needed` again with the
values read, until it names nothing new. Parameters that are not named are not used by :mod:`calib.firmware` for these
sensors.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping

from mavcal.calib.errors import FirmwareError
from mavcal.calib.firmware import names
from mavcal.calib.firmware.in_force.fingerprint import SETTINGS
from mavcal.calib.firmware.names import Role
from mavcal.calib.firmware.plan import Value
from mavcal.calib.recording import Sensor

DRIFT_KINDS = frozenset({"thermal"})
"""Jobs that write temperature coefficients."""
STREAMED = 3
"""Instances that either firmware streams."""
_OF_PX4 = ("SENS_", "IMU_")
_PER_MOTOR = 3


def needed(autopilot: str, sensors: Collection[Sensor], known: Mapping[str, Value], *, drift: bool) -> frozenset[str]:
    """Names of the parameters that a job over `sensors` needs, as far as `known` tells.

    Parameters
    ----------
    autopilot, sensors
        Whose, and which.
    known
        Values read so far; one that the vehicle does not have is simply not there.
    drift
        Whether temperature coefficients may be written, which otherwise count only while they are switched on.

    Raises
    ------
    FirmwareError
        If the autopilot is neither ArduPilot nor PX4.
    """
    if autopilot not in names.CALIBRATION_PREFIXES:
        raise FirmwareError(f"the calibration parameters of ArduPilot and PX4 are known, not those of {autopilot!r}")
    px4 = autopilot == "px4"
    found = {name for name in SETTINGS if name.startswith(_OF_PX4) == px4}
    found.add(names.BOARD_ROTATION[autopilot])
    if px4:
        found.update(names.PX4_LEVEL)
    for sensor in sensors:
        if sensor in (Sensor.ACCEL, Sensor.GYRO):
            found.update(_px4_rows(sensor, known, drift=drift) if px4 else _ardupilot_imus(sensor, known, drift=drift))
        elif sensor == Sensor.MAG:
            found.update(_px4_rows(sensor, known, drift=drift) if px4 else _ardupilot_compasses(known))
    if not px4:
        found.update(_custom_rotations(known))
    return frozenset(found)


def _ardupilot_imus(sensor: Sensor, known: Mapping[str, Value], *, drift: bool) -> Iterator[str]:
    for slot in range(names.ARDUPILOT_IMU_SLOTS):
        roles = names.ardupilot_imu_names(sensor, slot)
        before = names.ardupilot_imu_names(sensor, slot - 1)[Role.ID] if slot else ""
        if slot >= STREAMED and not known.get(before, 0):
            return  # the fourth and fifth are in few builds, and what is not there takes long to prove
        yield roles[Role.ID]
        if slot and not known.get(roles[Role.ID], 0):
            continue
        thermal = drift or bool(known.get(roles[Role.THERMAL_ENABLE], 0))
        yield from _roles(roles, thermal=thermal)


def _roles(roles: Mapping[Role, str], *, thermal: bool) -> Iterator[str]:
    """Names of a row; its coefficients only with `thermal`."""
    for role, name in roles.items():
        if thermal or role == Role.THERMAL_ENABLE or not role.value.startswith("thermal_"):
            yield name


def _ardupilot_compasses(known: Mapping[str, Value]) -> Iterator[str]:
    ids = [f"COMPASS_DEV_ID{'' if slot == 0 else slot + 1}" for slot in range(names.ARDUPILOT_COMPASS_IDS)]
    ranks = [f"COMPASS_PRIO{rank + 1}_ID" for rank in range(names.ARDUPILOT_COMPASS_SLOTS)]
    yield from (*ranks, *ids[: names.ARDUPILOT_COMPASS_SLOTS])
    held = [known.get(name, 0) for name in ids[: names.ARDUPILOT_COMPASS_SLOTS]]
    if any(known.get(name, 0) not in (0, *held) for name in ranks):
        yield from ids[names.ARDUPILOT_COMPASS_SLOTS :]
    for slot, device in enumerate(held):
        if slot == 0 or device:
            roles = names.ardupilot_compass_names(slot, slot)
            yield from roles.values()
            if known.get(roles[Role.EXTERNAL], 0):  # it may have to be turned by angles, in a place that is free
                yield names.ARDUPILOT_CUSTOM_SWITCH
                if known.get(names.ARDUPILOT_CUSTOM_SWITCH, 0):
                    yield from (name for angles in names.ARDUPILOT_CUSTOM.values() for name in angles)
    if known.get("COMPASS_MOTCT", 0) == _PER_MOTOR:
        yield "COMPASS_PMOT_EN"
        yield from (f"COMPASS_PMOT{motor}_{axis}" for motor in range(1, 5) for axis in "XYZ")


def _custom_rotations(known: Mapping[str, Value]) -> Iterator[str]:
    mountings = ("AHRS_ORIENTATION", "COMPASS_ORIENT", "COMPASS_ORIENT2", "COMPASS_ORIENT3")
    for number in {int(known.get(name, 0)) for name in mountings}:
        if number in names.ARDUPILOT_CUSTOM:
            yield names.ARDUPILOT_CUSTOM_SWITCH
            yield from names.ARDUPILOT_CUSTOM[number]


def _px4_rows(sensor: Sensor, known: Mapping[str, Value], *, drift: bool) -> Iterator[str]:
    rows = [names.px4_names(sensor, slot) for slot in range(names.PX4_SLOTS)]
    yield from (row[Role.ID] for row in rows)
    if not all(row[Role.ID] in known for row in rows):
        return  # which rows are whose is not known yet
    filled = [row for row in rows if known[row[Role.ID]]]
    free = [row for row in rows if not known[row[Role.ID]]]
    for row in [*filled, *free][: max(STREAMED, len(filled))]:
        yield from row.values()
    thermal = [names.px4_thermal_names(sensor, slot) for slot in range(names.PX4_SLOTS)]
    if not thermal[0]:
        return
    enable = thermal[0][Role.THERMAL_ENABLE]
    yield enable
    if drift or known.get(enable, 0):
        for row in thermal:
            yield row[Role.THERMAL_ID]
            if drift or known.get(row[Role.THERMAL_ID], 0):
                yield from row.values()
