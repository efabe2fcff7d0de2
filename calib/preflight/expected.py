"""Parameters expected from the last verified calibrations, wherever their sensors are connected now.

A device id identifies a sensor. ArduPilot's rows follow the position of a sensor, so the values of a moved sensor
belong in another row. PX4 finds a row by its id, so any free row will do. A value common to several sensors, such as
the board's rotation, keeps its name.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass

from mavcal.calib.errors import FirmwareError
from mavcal.calib.firmware import calibration_names, names, sensor_ids
from mavcal.calib.firmware.compose.draft import Subject
from mavcal.calib.firmware.in_force.fingerprint import REWRITTEN
from mavcal.calib.firmware.names import Role
from mavcal.calib.firmware.options import Key
from mavcal.calib.firmware.plan import LeftOut, Value
from mavcal.calib.preflight.check import VerifiedCalibration
from mavcal.calib.recording import Sensor

SHARED: Mapping[str, tuple[str, ...]] = {
    "ardupilot": ("AHRS_ORIENTATION", "AHRS_TRIM_", "CUST_ROT"),
    "px4": ("SENS_BOARD_ROT", *names.PX4_LEVEL),
}
"""Name prefixes of parameters common to several sensors, by autopilot."""
GYRO_SWITCH: Mapping[str, str] = {"ardupilot": "INS_GYR_CAL", "px4": "IMU_GYRO_CAL_EN"}
"""Parameter that tells whether the vehicle writes gyro offsets itself, by autopilot."""
_WHO = frozenset({Role.ID, Role.PRIORITY})


@dataclass(frozen=True)
class ExpectedValue:
    """Value that one parameter should hold, and its source."""

    name: str
    value: Value
    about: Subject | None
    """The sensor as it streams now; None: common to several sensors."""
    role: Role | None
    then: str
    """Name of the parameter when it was verified: another row where the sensor moved."""
    entry: VerifiedCalibration


@dataclass(frozen=True)
class ExpectedCalibration:
    """Parameter values that the verified calibrations imply for a vehicle."""

    values: tuple[ExpectedValue, ...] = ()
    missing: tuple[str, ...] = ()
    """Sentences on verified sensors without a place for their values."""
    moved: tuple[str, ...] = ()
    """Sentences on sensors with another position now."""
    homeless: tuple[LeftOut, ...] = ()
    """The sensors of `missing`, by the instance that they had when they were verified."""
    by_place: frozenset[Sensor] = frozenset()
    """Sensors without distinguishing device ids: their values are expected in the old rows."""


def last_of_each(history: Sequence[VerifiedCalibration]) -> dict[Sensor, VerifiedCalibration]:
    """The newest calibration of each sensor."""
    return {sensor: entry for entry in history for sensor in sorted(entry.sensors)}


def expected(
    history: Sequence[VerifiedCalibration],
    autopilot: str | None,
    parameters: Mapping[str, Value],
    *,
    only: Collection[Key] = (),
) -> ExpectedCalibration:
    """Expected `parameters` by `history` (oldest first).

    Gyro offsets that the vehicle writes by itself are left out. `only`: these sensors, as they stream now, and nothing
    shared; empty: everything.

    Raises
    ------
    FirmwareError
        If the autopilot is neither ArduPilot nor PX4.
    """
    if autopilot is None or autopilot not in SHARED:
        raise FirmwareError(f"the calibration parameters of ArduPilot and PX4 are known, not those of {autopilot!r}")
    places = _Px4Places(parameters) if autopilot == "px4" else _ArduPilotPlaces(parameters)
    values: list[ExpectedValue] = []
    missing: list[str] = []
    homeless: list[LeftOut] = []
    moved: list[str] = []
    by_place: set[Sensor] = set()
    for sensor, entry in last_of_each(history).items():
        known = places.known(sensor, entry)
        if not known:
            by_place.add(sensor)
        for then, device in _verified_sensors(sensor, entry, autopilot):
            try:
                place = places.place(Sensor(sensor), then, device if known else 0, entry)
            except FirmwareError as error:
                missing.append(f"{Subject(sensor, then)} (device id {device}): {error}")
                homeless.append(LeftOut(Sensor(sensor), then, f"device id {device}: {error}"))
                continue
            if place is None:
                why = f"had the device id {device}, which is not on this vehicle now"
                missing.append(f"{Subject(sensor, then)} {why}")
                homeless.append(LeftOut(Sensor(sensor), then, why))
                continue
            if only and (sensor, place.about.instance) not in only:
                continue
            if place.moved:
                moved.append(f"device id {device} was {Subject(sensor, then)} and is {place.about} now")
            values += _of_sensor(autopilot, parameters, entry, place)
    values += () if only else _shared(history, autopilot)
    return ExpectedCalibration(
        tuple(_unique(values)), tuple(missing), tuple(moved), tuple(homeless), frozenset(by_place)
    )


@dataclass(frozen=True)
class _Place:
    """Place of a verified sensor: names by role then and now."""

    about: Subject
    then: Mapping[Role, str]
    now: Mapping[Role, str]
    moved: bool
    new_row: bool = False
    """PX4: no row holds the sensor yet."""
    with_ids: bool = False
    """Whether the id is a value like the others, not managed by the firmware."""


class _ArduPilotPlaces:
    """Rows by the position of a sensor; the firmware fills in the ids at every start."""

    def __init__(self, parameters: Mapping[str, Value]) -> None:
        self._parameters = parameters
        self._now = {(sensor, device): i for (sensor, i), device in sensor_ids("ardupilot", parameters).items()}

    def known(self, sensor: Sensor, entry: VerifiedCalibration) -> bool:
        """Whether ids distinguish the sensors, then and now."""
        return any(s == sensor for s, _ in self._now) and bool(_ids_of(sensor, entry))

    def place(self, sensor: Sensor, then: int, device: int, entry: VerifiedCalibration) -> _Place | None:
        """Present place of that sensor; None: absent. With `device` 0: its old place."""
        now = then if device == 0 else self._now.get((sensor, device))
        if now is None:
            return None
        before = calibration_names("ardupilot", entry.parameters, sensor, then)
        after = calibration_names("ardupilot", self._parameters, sensor, now)
        return _Place(Subject(sensor, now), before, after, before != after, with_ids=device == 0)


class _Px4Places:
    """Rows by device id: the row with the id, else the old row or another free one."""

    def __init__(self, parameters: Mapping[str, Value]) -> None:
        self._parameters = parameters
        self._taken: set[str] = set()

    def known(self, sensor: Sensor, entry: VerifiedCalibration) -> bool:
        """Whether the old ids are known, which is all that PX4 needs."""
        return bool(_ids_of(sensor, entry))

    def place(self, sensor: Sensor, then: int, device: int, entry: VerifiedCalibration) -> _Place | None:
        """The rows for that sensor. Raises FirmwareError if every row belongs to another one."""
        rows = [names.px4_names(sensor, slot) for slot in range(names.PX4_SLOTS)]
        held = [int(entry.parameters.get(row[Role.ID], 0)) for row in rows]
        if device == 0:
            same = dict(rows[then])
            return _Place(Subject(sensor, then), same, same, moved=False, with_ids=True)
        if device not in held:
            raise FirmwareError("its verified values are not known")
        before = held.index(device)
        row, new = self._row(rows, Role.ID, device, before)
        old_names, new_names = dict(rows[before]), dict(rows[row])
        thermal = [names.px4_thermal_names(sensor, slot) for slot in range(names.PX4_SLOTS)]
        if thermal[0]:
            old_names[Role.THERMAL_ENABLE] = new_names[Role.THERMAL_ENABLE] = thermal[0][Role.THERMAL_ENABLE]
            ids = [int(entry.parameters.get(each[Role.THERMAL_ID], 0)) for each in thermal]
            if device in ids:
                target, _ = self._row(thermal, Role.THERMAL_ID, device, ids.index(device))
                old_names |= thermal[ids.index(device)]
                new_names |= thermal[target]
        filled = {slot for slot, each in enumerate(rows) if self._id(each[Role.ID]) or each[Role.ID] in self._taken}
        about = Subject(sensor, sorted(filled).index(row))
        return _Place(about, old_names, new_names, row != before, new, with_ids=True)

    def _row(self, rows: Sequence[Mapping[Role, str]], role: Role, device: int, before: int) -> tuple[int, bool]:
        """The row for this id, and whether it is a new one."""
        for slot, row in enumerate(rows):
            if self._id(row[role]) == device:
                return slot, False
        for slot in (before, *range(len(rows))):
            name = rows[slot][role]
            if not self._id(name) and name not in self._taken:
                self._taken.add(name)
                return slot, True
        raise FirmwareError("every row of parameters belongs to another sensor")

    def _id(self, name: str) -> int:
        return int(self._parameters.get(name, 0))


def _ids_of(sensor: Sensor, entry: VerifiedCalibration) -> dict[int, int]:
    """Device id by instance, as it was when the calibration was verified."""
    return {int(k[len(sensor) :]): i for k, i in entry.device_ids.items() if k.rstrip("0123456789") == sensor}


def _verified_sensors(sensor: Sensor, entry: VerifiedCalibration, autopilot: str) -> Iterator[tuple[int, int]]:
    """Instances with their device ids; without any id, every instance that has values (the id is 0 then)."""
    ids = _ids_of(sensor, entry)
    if ids:
        yield from sorted(ids.items())
        return
    slots = names.PX4_SLOTS if autopilot == "px4" else names.ARDUPILOT_COMPASS_SLOTS
    yield from ((slot, 0) for slot in range(slots))


def _of_sensor(
    autopilot: str, parameters: Mapping[str, Value], entry: VerifiedCalibration, place: _Place
) -> Iterator[ExpectedValue]:
    switch = GYRO_SWITCH[autopilot]
    by_itself = bool(parameters.get(switch, 1)) and bool(entry.parameters.get(switch, 1)) and not place.new_row
    for role, then in place.then.items():
        name = place.now.get(role)
        if name is None or then not in entry.parameters or (role in _WHO and not place.with_ids):
            continue
        if by_itself and name in REWRITTEN:
            continue
        yield ExpectedValue(name, entry.parameters[then], place.about, role, then, entry)
    if place.about.sensor == Sensor.GYRO and autopilot == "ardupilot" and entry.parameters.get(switch, 1) == 0:
        yield ExpectedValue(switch, 0, place.about, None, switch, entry)


def _shared(history: Sequence[VerifiedCalibration], autopilot: str) -> Iterator[ExpectedValue]:
    for entry in history[-1:]:
        for name, value in sorted(entry.parameters.items()):
            if name.startswith(SHARED[autopilot]):
                yield ExpectedValue(name, value, None, None, name, entry)


def _unique(values: Sequence[ExpectedValue]) -> Iterator[ExpectedValue]:
    """The values with each name once, since the switch of a group comes with every member."""
    seen: set[str] = set()
    for value in values:
        if value.name not in seen:
            seen.add(value.name)
            yield value
