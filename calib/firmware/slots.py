"""Assignment of parameter rows to streamed instances.

ArduPilot's inertial units stream by slot. Its compasses stream by *rank* (``COMPASS_PRIOn_ID``) while their parameters
lie in state slots (``COMPASS_DEV_IDn``). PX4 matches every row by device id. FLIGHT_CONTROLLERS 1.3, 1.4, 2.2.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, Final

from mavcal.calib.errors import FirmwareError
from mavcal.calib.firmware import names
from mavcal.calib.firmware.names import Role
from mavcal.calib.recording import Sensor

if TYPE_CHECKING:
    from mavcal.calib.firmware.plan import Value

CALIBRATED = (Sensor.ACCEL, Sensor.GYRO, Sensor.MAG)
"""The sensors that have calibration parameters."""
NO_DEVICE_IDS: Final[Mapping[tuple[Sensor, int], int]] = MappingProxyType({})


def ardupilot_compass_slot(parameters: Mapping[str, Value], priority: int) -> int:
    """State slot (0-based) of the compass that streams as instance `priority`.

    A vehicle that stores no ranks uses its slots in order.

    Raises
    ------
    FirmwareError
        If the ranked device id is in no slot that has calibration parameters.
    """
    wanted = int(parameters.get(f"COMPASS_PRIO{priority + 1}_ID", 0))
    if wanted == 0:
        return priority
    for slot in range(names.ARDUPILOT_COMPASS_IDS):
        digit = "" if slot == 0 else str(slot + 1)
        if int(parameters.get(f"COMPASS_DEV_ID{digit}", 0)) == wanted:
            if slot >= names.ARDUPILOT_COMPASS_SLOTS:
                break
            return slot
    raise FirmwareError(
        f"compass {priority + 1} has device id {wanted} (COMPASS_PRIO{priority + 1}_ID), but none of COMPASS_DEV_ID, "
        "COMPASS_DEV_ID2, COMPASS_DEV_ID3 holds it; restart the vehicle so that it registers its compasses again"
    )


def ardupilot_calibration_names(parameters: Mapping[str, Value], sensor: Sensor, instance: int) -> Mapping[Role, str]:
    """Names by role of the parameters that correct `sensor` `instance` (0-based, as streamed) of an ArduPilot.

    Raises
    ------
    FirmwareError
        If ArduPilot has no parameters for it.
    """
    _check_sensor(sensor)
    if sensor != Sensor.MAG:
        return names.ardupilot_imu_names(sensor, instance)
    return names.ardupilot_compass_names(ardupilot_compass_slot(parameters, instance), instance)


def px4_rows(
    parameters: Mapping[str, Value], sensor: Sensor, device_ids: Mapping[tuple[Sensor, int], int] = NO_DEVICE_IDS
) -> tuple[int, ...]:
    """``CAL_*`` row of each streamed instance of `sensor`; rows that are left count as those of further instances.

    The stream does not carry device ids. The rows that hold an id are taken in their order, which is how the firmware
    fills them, then the free ones. That is a guess: PX4 keeps the id of a removed sensor in its row. `device_ids` are
    stated by an operator, by streamed instance. Such a sensor has the row with its id, else its row by order if that is
    free, else the first free one.

    Raises
    ------
    FirmwareError
        If there is no row left for a sensor that was told.
    """
    ids = _px4_ids(parameters, sensor)
    ordered = [slot for slot, held in enumerate(ids) if held != 0] + [slot for slot, held in enumerate(ids) if not held]
    known = {i: device for (kind, i), device in sorted(device_ids.items()) if kind == sensor and i < len(ordered)}
    rows = {i: ids.index(device) for i, device in known.items() if device in ids}
    for i in sorted(known.keys() - rows.keys()):
        free = [slot for slot in (ordered[i], *ordered) if not ids[slot] and slot not in rows.values()]
        if not free:
            names_of = ", ".join(names.px4_names(sensor, slot)[Role.ID] for slot in range(names.PX4_SLOTS))
            raise FirmwareError(
                f"every row holds an id ({names_of}), and none is {known[i]}: set that of a sensor that is gone to 0"
            )
        rows[i] = free[0]
    left = iter([slot for slot in ordered if slot not in rows.values()])
    return tuple(rows[i] if i in rows else next(left) for i in range(len(ordered)))


def px4_slot(
    parameters: Mapping[str, Value],
    sensor: Sensor,
    instance: int,
    device_ids: Mapping[tuple[Sensor, int], int] = NO_DEVICE_IDS,
) -> int:
    """``CAL_*`` row of `sensor` `instance`; see :func:`px4_rows`.

    Raises
    ------
    FirmwareError
        If there is no row left.
    """
    rows = px4_rows(parameters, sensor, device_ids)
    if instance >= len(rows):
        raise FirmwareError(f"PX4 has {names.PX4_SLOTS} rows for {sensor}; instance {instance} has none")
    return rows[instance]


def px4_instance(parameters: Mapping[str, Value], sensor: Sensor, slot: int) -> int:
    """The instance that has `slot` by order."""
    return px4_rows(parameters, sensor).index(slot)


def px4_thermal_slot(parameters: Mapping[str, Value], sensor: Sensor, device_id: int) -> int | None:
    """``TC_*`` row that holds `device_id`, else the free row assigned to it; None: there is no row.

    Sensors without a row share out the free rows in the order of their ``CAL_*`` rows. A plan over several of them
    therefore never takes one row twice. A magnetometer has none: PX4 computes its thermal term and never uses it.
    """
    if device_id == 0 or not names.px4_thermal_names(sensor, 0):
        return None
    held = [
        int(parameters.get(names.px4_thermal_names(sensor, slot)[Role.THERMAL_ID], 0))
        for slot in range(names.PX4_SLOTS)
    ]
    if device_id in held:
        return held.index(device_id)
    without = [i for i in _px4_ids(parameters, sensor) if i not in (0, *held)]
    free = [slot for slot, owner in enumerate(held) if owner == 0]
    return dict(zip(without, free, strict=False)).get(device_id)


def px4_calibration_names(parameters: Mapping[str, Value], sensor: Sensor, instance: int) -> Mapping[Role, str]:
    """Names by role of the parameters that correct `sensor` `instance` of a PX4, thermal row included.

    The thermal row is the one that holds the sensor's device id, else a free one (the value of its ``THERMAL_ID`` says
    which). A sensor without a known id has none.
    """
    _check_sensor(sensor)
    row = names.px4_names(sensor, px4_slot(parameters, sensor, instance))
    thermal = px4_thermal_slot(parameters, sensor, int(parameters.get(row[Role.ID], 0)))
    if thermal is None:
        return row
    return MappingProxyType({**row, **names.px4_thermal_names(sensor, thermal)})


def _px4_ids(parameters: Mapping[str, Value], sensor: Sensor) -> list[int]:
    return [int(parameters.get(names.px4_names(sensor, slot)[Role.ID], 0)) for slot in range(names.PX4_SLOTS)]


def ardupilot_sensor_ids(parameters: Mapping[str, Value]) -> dict[tuple[Sensor, int], int]:
    """Device id of every sensor that the vehicle knows, by streamed instance."""
    found = {}
    for sensor in (Sensor.ACCEL, Sensor.GYRO):
        for slot in range(names.ARDUPILOT_IMU_SLOTS):
            found[sensor, slot] = int(parameters.get(names.ardupilot_imu_names(sensor, slot)[Role.ID], 0))
    for priority in range(names.ARDUPILOT_COMPASS_SLOTS):
        ranked = int(parameters.get(f"COMPASS_PRIO{priority + 1}_ID", 0))
        own = names.ardupilot_compass_names(priority, priority)[Role.ID]
        found[Sensor.MAG, priority] = ranked or int(parameters.get(own, 0))
    return {key: value for key, value in found.items() if value != 0}


def px4_sensor_ids(
    parameters: Mapping[str, Value], device_ids: Mapping[tuple[Sensor, int], int] = NO_DEVICE_IDS
) -> dict[tuple[Sensor, int], int]:
    """Device id of every calibrated sensor, by streamed instance; see :func:`px4_rows`."""
    found = {}
    for sensor in CALIBRATED:
        ids = _px4_ids(parameters, sensor)
        rows = px4_rows(parameters, sensor, device_ids)
        found.update({(sensor, i): ids[slot] for i, slot in enumerate(rows) if ids[slot] != 0})
    return found


def still_held(
    stated: Mapping[tuple[Sensor, int], int], parameters: Mapping[str, Value]
) -> dict[tuple[Sensor, int], int]:
    """The `stated` device ids that a row of a PX4 with `parameters` holds."""
    held = {(sensor, device) for (sensor, _), device in px4_sensor_ids(parameters).items()}
    return {key: device for key, device in stated.items() if (key[0], device) in held}


def _check_sensor(sensor: Sensor) -> None:
    if sensor not in CALIBRATED:
        raise FirmwareError(f"an autopilot holds no calibration of {sensor}; ask for accel, gyro or mag")
