"""PX4's sensor corrections: the only place with its formulas and thresholds (FLIGHT_CONTROLLERS 1.4, 10).

=============  ============================================================
accelerometer  ``b = L R [(a - TC(T) - OFF) o SCALE]``
gyroscope      ``b = L R (g - TC(T) - OFF)``
magnetometer   ``b = L R S (m + p COMP - OFF)``: the offset is subtracted, in the sensor's frame
=============  ============================================================

``TC(T) = X0 + X1 d + X2 d^2 + X3 d^3``, ``d = clamp(T) - TREF``; L = Euler(SENS_BOARD_*_OFF), R the board's rotation or
an external sensor's own. A stored value does not always reach the memory that corrects: see :class:`Px4Calibration`.

No stream carries a device id, and PX4 leaves the id of a removed sensor in its row. Its own arming checks are the only
sign that a row is stale.
"""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

import numpy as np

from mavcal.calib.errors import FirmwareError
from mavcal.calib.firmware import names
from mavcal.calib.firmware.names import PX4_PREFIXES as CALIBRATION_PREFIXES
from mavcal.calib.firmware.names import Role
from mavcal.calib.firmware.rotations import euler_matrix, rotation_matrix
from mavcal.calib.firmware.slots import px4_calibration_names as calibration_names
from mavcal.calib.firmware.slots import px4_sensor_ids as sensor_ids
from mavcal.calib.firmware.values import need, vector
from mavcal.calib.recording import Array, Event, ParameterEntry, Sensor
from mavcal.calib.triad import ThermalPolynomial, TriadModel

if TYPE_CHECKING:
    from collections.abc import Mapping

    from mavcal.calib.firmware.plan import Value

__all__ = [
    "CALIBRATION_PREFIXES",
    "THRESHOLDS",
    "UT_PER_GAUSS",
    "Px4Calibration",
    "Thresholds",
    "board_rotation",
    "by_angles",
    "calibration_in_force",
    "calibration_names",
    "level_adjustment",
    "motor_term",
    "mounting",
    "sensor_ids",
]
UT_PER_GAUSS: Final = 100.0
MOTOR_BY_THRUST, MOTOR_BY_CURRENT = 1, 2
"""CAL_MAG_COMP_TYP: thrust; from 2 on the current of battery 0, 1, in kA."""
ROTATION_CUSTOM: Final = names.PX4_CUSTOM
NO_ANGLE: Final = float(np.finfo(np.float32).eps)
"""An angle of a row up to this counts as none, degrees."""
_SAID: Final = re.compile(r"\b(Accel|Gyro|Compass|Mag) #?(\d) uncalibrated")
"""``HealthAndArmingChecks/checks/``: accelerometerCheck, gyroCheck and magnetometerCheck; instances from 0."""
_SENSORS: Final = {"Accel": Sensor.ACCEL, "Gyro": Sensor.GYRO, "Compass": Sensor.MAG, "Mag": Sensor.MAG}
_ID: Final = re.compile(r"CAL_(ACC|GYRO|MAG)\d_ID")
_ROWS: Final = {"ACC": Sensor.ACCEL, "GYRO": Sensor.GYRO, "MAG": Sensor.MAG}


@dataclass(frozen=True)
class Thresholds:
    """Least norm of the difference by which a new vector replaces the one in memory (parameter units)."""

    offset: float
    scale: float = 0.01
    cross: float = 0.01


THRESHOLDS: Final[Mapping[Sensor, Thresholds]] = {
    Sensor.ACCEL: Thresholds(offset=0.01),  # m/s2
    Sensor.GYRO: Thresholds(offset=0.01),  # rad/s; waived for the first load after boot
    Sensor.MAG: Thresholds(offset=0.005),  # Gauss
}


@dataclass(frozen=True, eq=False)
class Px4Calibration:
    """The values of one sensor that are in PX4's memory, which is what corrects it (parameter units).

    After boot memory starts at offset 0, scale 1, cross terms 0. Every parameter change loads the row again, vector by
    vector. A vector within its threshold of the one in memory is ignored (``sensor_calibration/*.cpp`` ``set_offset``,
    ``set_scale``, ``set_offdiagonal``).

    Examples
    --------
    >>> row = {f"CAL_ACC0_{a}OFF": 0.0 for a in "XYZ"} | {f"CAL_ACC0_{a}SCALE": 1.0 for a in "XYZ"} | {"CAL_ACC0_ID": 1}
    >>> memory = Px4Calibration.load(row, Sensor.ACCEL, 0)
    >>> memory = memory.update(row | {"CAL_ACC0_XOFF": 0.05})  # 0.05 away from memory: taken
    >>> float(memory.update(row | {"CAL_ACC0_XOFF": 0.057}).offset[0])  # 0.007 away: ignored
    0.05
    """

    sensor: Sensor
    instance: int
    offset: Array = field(default_factory=lambda: np.zeros(3))
    scale: Array = field(default_factory=lambda: np.ones(3))
    cross: Array = field(default_factory=lambda: np.zeros(3))
    loaded: bool = False
    """Whether any value was taken since boot."""

    @classmethod
    def load(cls, parameters: Mapping[str, Value], sensor: Sensor, instance: int) -> Px4Calibration:
        """PX4's memory after a boot with `parameters`."""
        return cls(sensor, instance).update(parameters)

    def update(self, parameters: Mapping[str, Value]) -> Px4Calibration:
        """PX4's memory after the firmware has looked at `parameters` again.

        Raises
        ------
        FirmwareError
            If the row of this sensor is not among `parameters`.
        """
        roles = calibration_names(parameters, self.sensor, self.instance)
        if need(parameters, roles[Role.ID]) == 0:
            return Px4Calibration(self.sensor, self.instance)  # no row of its own: reset
        limits = THRESHOLDS[self.sensor]
        first_gyro = self.sensor == Sensor.GYRO and not self.loaded
        offset, scale, cross = self.offset, self.scale, self.cross
        stored = _stored(parameters, roles, names.OFFSET)
        if stored is not None and (first_gyro or _longer(stored - offset, limits.offset)):
            offset = stored
        stored = _stored(parameters, roles, names.SCALE)
        if stored is not None and (stored > 0).all() and _longer(stored - scale, limits.scale):
            scale = stored
        stored = _stored(parameters, roles, names.CROSS)
        if stored is not None and _longer(stored - cross, limits.cross):
            cross = stored
        changed = offset is not self.offset or scale is not self.scale or cross is not self.cross
        return dataclasses.replace(
            self, offset=offset, scale=scale, cross=cross, loaded=self.loaded or changed or first_gyro
        )


def calibration_in_force(
    parameters: Mapping[str, Value], sensor: Sensor, instance: int, memory: Px4Calibration | None = None
) -> TriadModel:
    """The correction that a PX4 with `parameters` applies: raw sensor frame to corrected body frame, SI and uT.

    `memory` is what earlier writes left in memory; None: as after a boot with `parameters`. For a magnetometer this is
    what the firmware does inside; the streamed field is raw. The thermal part counts as running where TC_*_ENABLE is 1.

    Raises
    ------
    FirmwareError
        If a parameter that decides the correction is not among `parameters`.
    """
    held = memory or Px4Calibration.load(parameters, sensor, instance)
    roles = calibration_names(parameters, sensor, instance)
    turn = mounting(parameters, sensor, instance)
    if sensor == Sensor.MAG:
        xy, xz, yz = held.cross
        soft_iron = np.diag(held.scale) + np.array([[0.0, xy, xz], [xy, 0.0, yz], [xz, yz, 0.0]])
        return TriadModel(UT_PER_GAUSS * held.offset, turn @ soft_iron)
    constant, polynomial = _thermal(parameters, roles)
    return TriadModel(held.offset + constant, turn @ np.diag(held.scale), polynomial)


def motor_term(
    parameters: Mapping[str, Value], instance: int, throttle: Array | None, currents: Mapping[int, Array]
) -> Array | None:
    """``p COMP`` of a magnetometer in its own frame, uT (N, 3); None where no compensation is in force.

    Parameters
    ----------
    parameters, instance
        The vehicle's parameters, and which magnetometer.
    throttle : shape (N,) or None
        |thrust setpoint| 0..1 at each sample; None: not recorded.
    currents
        Battery currents in A (N,) by battery number, as far as they were recorded.

    Raises
    ------
    FirmwareError
        If what the compensation follows was not recorded.
    """
    kind = int(parameters.get("CAL_MAG_COMP_TYP", 0))
    if kind == 0:
        return None
    roles = calibration_names(parameters, Sensor.MAG, instance)
    gain = vector(parameters, roles, names.MOTOR)
    if not gain.any():
        return None
    thrust = kind == MOTOR_BY_THRUST
    power = throttle if thrust else currents.get(kind - MOTOR_BY_CURRENT)
    if power is None:
        what = "thrust" if thrust else f"current of battery {kind - MOTOR_BY_CURRENT + 1}"
        raise FirmwareError(f"its correction follows the {what} (CAL_MAG_COMP_TYP {kind}), which was not recorded")
    return np.asarray((power if thrust else 1e-3 * power)[:, None] * gain * UT_PER_GAUSS)


def board_rotation(parameters: Mapping[str, Value]) -> Array:
    """``L R``: SENS_BOARD_ROT, then the level adjustment SENS_BOARD_*_OFF; body from board, shape (3, 3)."""
    return level_adjustment(parameters) @ rotation_matrix("px4", int(need(parameters, names.BOARD_ROTATION["px4"])))


def level_adjustment(parameters: Mapping[str, Value]) -> Array:
    """L: the level adjustment SENS_BOARD_*_OFF, applied behind every sensor's rotation, shape (3, 3)."""
    return euler_matrix(*(need(parameters, name) for name in names.PX4_LEVEL))


def mounting(parameters: Mapping[str, Value], sensor: Sensor, instance: int) -> Array:
    """``R_body_from_sensor`` of one sensor (L R), shape (3, 3)."""
    roles = calibration_names(parameters, sensor, instance)
    number = int(need(parameters, roles[Role.ROTATION]))
    if number < 0:  # an internal sensor follows the board
        return board_rotation(parameters)
    if Role.ROTATION_ROLL in roles and (number == ROTATION_CUSTOM or by_angles(parameters, roles)):
        return level_adjustment(parameters) @ euler_matrix(*vector(parameters, roles, names.ROTATION_EULER))
    return level_adjustment(parameters) @ rotation_matrix("px4", number)


def by_angles(parameters: Mapping[str, Value], roles: Mapping[Role, str]) -> bool:
    """Whether a magnetometer's row holds angles: they make its number "custom" (Magnetometer.cpp, ParametersLoad)."""
    return any(abs(float(parameters.get(roles[role], 0.0))) > NO_ANGLE for role in names.ROTATION_EULER)


def _thermal(parameters: Mapping[str, Value], roles: Mapping[Role, str]) -> tuple[Array, ThermalPolynomial | None]:
    none = np.zeros(3), None
    if Role.THERMAL_ID not in roles or int(parameters.get(roles[Role.THERMAL_ENABLE], 0)) != 1:
        return none
    if int(parameters.get(roles[Role.THERMAL_ID], 0)) == 0:
        return none  # the names are those of a free row: none is the sensor's own (slots.px4_thermal_slot)
    polynomial = ThermalPolynomial(
        t_ref=need(parameters, roles[Role.THERMAL_REF]),
        t_min=need(parameters, roles[Role.THERMAL_MIN]),
        t_max=need(parameters, roles[Role.THERMAL_MAX]),
        coefficients=np.stack([vector(parameters, roles, names.THERMAL[k]) for k in (1, 2, 3)], axis=1),
    )
    return vector(parameters, roles, names.THERMAL[0]), polynomial


def _stored(parameters: Mapping[str, Value], roles: Mapping[Role, str], triple: names.Triple) -> Array | None:
    """The stored vector; None where the sensor has none, or it is not finite (the firmware then keeps its own)."""
    if triple[0] not in roles:
        return None
    missing = [roles[role] for role in triple if roles[role] not in parameters]
    if missing:
        need(parameters, missing[0])
    stored = np.array([float(parameters[roles[role]]) for role in triple])
    return stored if np.isfinite(stored).all() else None


def _longer(difference: Array, limit: float) -> bool:
    # in single precision, as matrix::Vector::longerThan compares
    d = difference.astype(np.float32)
    return bool(np.dot(d, d) > np.float32(limit) * np.float32(limit))


def without_row(events: Iterable[Event], entries: Iterable[ParameterEntry] = ()) -> frozenset[tuple[Sensor, int]]:
    """The sensors that PX4 calls uncalibrated in these texts, by streamed instance.

    `entries` are the parameters as they were heard. A text from before a change of that sensor's ids no longer counts:
    PX4 fills the row of a gyroscope by itself.

    >>> sorted(without_row([Event(0.0, "text", "Preflight Fail: Compass 1 uncalibrated")]))
    [(<Sensor.MAG: 'mag'>, 1)]
    """
    since = _last_change_of_ids(entries)
    matches = [(event.t, match) for event in events for match in _SAID.finditer(event.text)]
    found = [(t, _SENSORS[match[1]], int(match[2])) for t, match in matches]
    return frozenset((sensor, instance) for t, sensor, instance in found if t >= since.get(sensor, -math.inf))


def _last_change_of_ids(entries: Iterable[ParameterEntry]) -> dict[Sensor, float]:
    held: dict[str, float] = {}
    since: dict[Sensor, float] = {}
    for entry in entries:
        match = _ID.fullmatch(entry.name)
        if match is None:
            continue
        if held.setdefault(entry.name, entry.value) != entry.value:
            held[entry.name] = entry.value
            since[_ROWS[match[1]]] = entry.t
    return since
