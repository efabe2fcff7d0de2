"""Mounting of the sensors: the true one, by the configuration, and that of the parameters."""

from __future__ import annotations

from collections.abc import Iterator

from mavcal.service.simvehicle.config import VehicleConfig
from mavcal.service.simvehicle.errors import ConfigurationError
from mavcal.service.simvehicle.parameters import ParameterTable
from mavcal.service.simvehicle.rotation import Array, matrix_from_degrees, mounting_matrix

ANGLES = ("ROLL", "PITCH", "YAW")
ARDUPILOT_CUSTOM = {101: "CUST_ROT1", 102: "CUST_ROT2"}
PX4_CUSTOM = 100
CUSTOM_SWITCH = "CUST_ROT_ENABLE"


def true_mounting(config: VehicleConfig, mag: int) -> Array:
    """True R body_from_sensor of a magnetometer."""
    angles = true_angles(config, mag)
    return mounting_matrix(config.mag_orientations[mag]) if angles is None else matrix_from_degrees(*angles)


def true_angles(config: VehicleConfig, mag: int) -> tuple[float, float, float] | None:
    """Roll, pitch, yaw in degrees of a magnetometer whose mounting has no number."""
    return config.mag_angles_deg[mag] if mag < len(config.mag_angles_deg) else None


def stated(config: VehicleConfig) -> Iterator[tuple[int, tuple[float, float, float] | None]]:
    """Mounting of each magnetometer in the parameters of a new vehicle: a number, and angles where it has none."""
    for mag in range(config.mag_count):
        if config.mag_orientation_parameters is not None:
            yield config.mag_orientation_parameters[mag], None
        else:
            yield config.mag_orientations[mag], true_angles(config, mag)


def numbered_mounting(number: int) -> Array:
    """R of a mounting number; an unknown one acts as none, as an out-of-range enum does in the firmware."""
    try:
        return mounting_matrix(number)
    except ConfigurationError:
        return mounting_matrix(0)


class CustomRotations:
    """ArduPilot's two rotations by angles (AP_CustomRotations.cpp).

    Each is made from its angles when first used, or at boot if they are switched on. Later changes of its angles act at
    the next boot only. The first use switches them on.
    """

    def __init__(self, table: ParameterTable) -> None:
        self._table = table
        self._made: dict[int, Array] = {}

    def boot(self) -> None:
        """Reset both rotations, and make them where they are switched on."""
        self._made.clear()
        if self._table.get(CUSTOM_SWITCH):
            for number in ARDUPILOT_CUSTOM:
                self.matrix(number)

    def matrix(self, number: int) -> Array:
        """R of one of them."""
        if number not in self._made:
            stem = ARDUPILOT_CUSTOM[number]
            self._made[number] = matrix_from_degrees(*(self._table.get(f"{stem}_{angle}") for angle in ANGLES))
            if CUSTOM_SWITCH in self._table and not self._table.get(CUSTOM_SWITCH):
                self._table.store(CUSTOM_SWITCH, 1)
                self._table.save(CUSTOM_SWITCH)
        return self._made[number]

    def mounting(self, number: float) -> Array:
        """R of a mounting number, including those of rotations by angles."""
        return self.matrix(int(number)) if int(number) in ARDUPILOT_CUSTOM else numbered_mounting(int(number))
