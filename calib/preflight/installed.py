"""Sensors that the parameters announce and use, by streamed instance.

FLIGHT_CONTROLLERS 1.1, 1.3, 1.4, 2.1, 2.2. ArduPilot clears the ids of inertial units that it did not find at its
start; a compass is announced by its rank or by its slot. PX4 keeps a row for each sensor that was ever calibrated. It
does not publish an inertial unit if its accelerometer or gyroscope has priority 0.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from mavcal.calib.firmware import names
from mavcal.calib.firmware.names import Role
from mavcal.calib.firmware.plan import Value
from mavcal.calib.firmware.slots import NO_DEVICE_IDS, px4_rows
from mavcal.calib.recording import Sensor

WORDS: Mapping[Sensor, tuple[str, str]] = {
    Sensor.GYRO: ("gyroscope", "gyroscopes"),
    Sensor.ACCEL: ("accelerometer", "accelerometers"),
    Sensor.MAG: ("compass", "compasses"),
}
"""Singular and plural names."""
STREAMED = 3
"""Instances that either firmware streams."""

Key = tuple[Sensor, int]


@dataclass(frozen=True)
class Announced:
    """A sensor that the parameters announce and use."""

    sensor: Sensor
    instance: int
    by: str
    """The parameter that holds its device id, with the value."""
    device: int
    kept: bool = True
    """Whether the firmware maintains the row itself. PX4 keeps rows of removed sensors."""
    presumed: bool = False
    """PX4: the priority is still -1, which the firmware replaces when it calibrates a present sensor."""

    @property
    def name(self) -> str:
        """Display name."""
        return f"{WORDS[self.sensor][0]} {self.instance + 1}"


def announced(
    autopilot: str, parameters: Mapping[str, Value], device_ids: Mapping[Key, int] = NO_DEVICE_IDS
) -> dict[Key, Announced]:
    """Every sensor that is announced and used; none for an autopilot that is neither ArduPilot nor PX4.

    `device_ids`: PX4's device ids by streamed instance, as :func:`calib.preflight.check.told_ids` finds them.
    """
    if autopilot not in names.CALIBRATION_PREFIXES:
        return {}
    found = _px4(parameters, device_ids) if autopilot == "px4" else _ardupilot(parameters)
    return {(one.sensor, one.instance): one for one in found}


def _ardupilot(parameters: Mapping[str, Value]) -> Iterator[Announced]:
    for sensor in (Sensor.ACCEL, Sensor.GYRO):
        for slot in range(names.ARDUPILOT_IMU_SLOTS):
            row = names.ardupilot_imu_names(sensor, slot)
            if parameters.get(row[Role.ID], 0) and parameters.get(row[Role.USE], 1):
                yield Announced(sensor, slot, _device_text(row[Role.ID], parameters), int(parameters[row[Role.ID]]))
    if not parameters.get("COMPASS_ENABLE", 1):
        return
    for rank in range(names.ARDUPILOT_COMPASS_SLOTS):
        row = names.ardupilot_compass_names(rank, rank)
        name = next((row[role] for role in (Role.PRIORITY, Role.ID) if parameters.get(row[role], 0)), None)
        if name is not None and parameters.get(row[Role.USE], 1):
            yield Announced(Sensor.MAG, rank, _device_text(name, parameters), int(parameters[name]))


def _px4(parameters: Mapping[str, Value], device_ids: Mapping[Key, int]) -> Iterator[Announced]:
    rows = {sensor: _px4_rows(sensor, parameters, device_ids) for sensor in WORDS}
    used = {sensor: [name for name, use in found if use] for sensor, found in rows.items()}
    units = _fewest(len(used[Sensor.ACCEL]), len(used[Sensor.GYRO]))
    for sensor in (Sensor.ACCEL, Sensor.GYRO):
        for instance, name in enumerate(used[sensor][:units]):
            yield _of_row(sensor, instance, name, parameters)
    if not parameters.get("SYS_HAS_MAG", 1):
        return
    for instance, (name, use) in enumerate(rows[Sensor.MAG]):
        if use:
            yield _of_row(Sensor.MAG, instance, name, parameters)


def _of_row(sensor: Sensor, instance: int, name: str, parameters: Mapping[str, Value]) -> Announced:
    priority = parameters.get(f"{name.removesuffix('_ID')}_PRIO", -1)
    device_ids = _device_text(name, parameters)
    return Announced(sensor, instance, device_ids, int(parameters[name]), kept=False, presumed=priority == -1)


def _fewest(accels: int, gyros: int) -> int:
    """Number of published units, which need both halves; rows of one kind count alone while the other has none."""
    return min(accels, gyros) if accels and gyros else max(accels, gyros)


def _px4_rows(sensor: Sensor, parameters: Mapping[str, Value], device_ids: Mapping[Key, int]) -> list[tuple[str, bool]]:
    """Names of the ids in the filled rows, in the order of the stream, and whether each is used."""
    rows = [names.px4_names(sensor, slot) for slot in px4_rows(parameters, sensor, device_ids)]
    return [
        (row[Role.ID], parameters.get(row[Role.PRIORITY], -1) != 0) for row in rows if parameters.get(row[Role.ID], 0)
    ]


def _device_text(name: str, parameters: Mapping[str, Value]) -> str:
    return f"{name} = {int(parameters[name])}"
