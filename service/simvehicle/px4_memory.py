"""PX4's calibration in memory, which may differ from its parameters: small changes are ignored.

FLIGHT_CONTROLLERS 1.4: a loaded vector replaces the one in memory only if it is farther away than a threshold. After
boot memory holds offset 0, scale 1, off-diagonal 0; the first gyroscope offset after boot is taken whatever its size.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from mavcal.service.simvehicle.mounting import ANGLES, PX4_CUSTOM
from mavcal.service.simvehicle.parameters import ParameterTable
from mavcal.service.simvehicle.px4_parameters import SLOTS, vector_names
from mavcal.service.simvehicle.rotation import Array

ACCEL_OFFSET_THRESHOLD = 0.01  # m/s²
GYRO_OFFSET_THRESHOLD = 0.01  # rad/s
MAG_OFFSET_THRESHOLD = 0.005  # Gauss
SCALE_THRESHOLD = 0.01
OFF_DIAGONAL_THRESHOLD = 0.01
FLT_EPSILON = 1.1920929e-07


@dataclass
class SensorMemory:
    """Calibration values of one sensor in PX4's memory, which its corrections use.

    Attributes:
        kind: ACC, GYRO or MAG.
        device_id: the chip.
        slot: the calibration slot that carries this id; None: uncalibrated.
        priority: 0 disables the sensor.
    """

    kind: str
    device_id: int
    slot: int | None = None
    priority: int = -1
    rotation: int = -1
    offset: Array = field(default_factory=lambda: np.zeros(3))
    scale: Array = field(default_factory=lambda: np.ones(3))
    off_diagonal: Array = field(default_factory=lambda: np.zeros(3))
    power: Array = field(default_factory=lambda: np.zeros(3))
    loaded: bool = False

    def load(self, table: ParameterTable) -> None:
        """ParametersUpdate: take over what differs enough."""
        self.slot = next((n for n in range(SLOTS) if table.get(f"CAL_{self.kind}{n}_ID") == self.device_id), None)
        if self.slot is None:
            return
        base = f"CAL_{self.kind}{self.slot}"
        self.priority = int(table.get(f"{base}_PRIO", -1))
        self.rotation = self._rotation(table, base)
        self.set_offset(_vector(table, base, "OFF", 0.0))
        if self.kind != "GYRO":
            self._set_scale(_vector(table, base, "SCALE", 1.0))
        if self.kind == "MAG":
            self._set_off_diagonal(_vector(table, base, "ODIAG", 0.0))
            self.power = _vector(table, base, "COMP", 0.0)
        self.loaded = True

    def _rotation(self, table: ParameterTable, base: str) -> int:
        """ROT; a number beside angles that are not zero becomes "custom" (Magnetometer.cpp, ParametersLoad)."""
        number = int(table.get(f"{base}_ROT", -1))
        angles = [table.get(f"{base}_{angle}") for angle in ANGLES]
        if self.kind != "MAG" or number < 0 or number == PX4_CUSTOM or not any(abs(a) > FLT_EPSILON for a in angles):
            return number
        table.store(f"{base}_ROT", PX4_CUSTOM)
        table.save(f"{base}_ROT")
        return PX4_CUSTOM

    def set_offset(self, offset: Array) -> bool:
        """Replace the offset if it is farther away than the threshold; whether it was replaced."""
        threshold = {
            "ACC": ACCEL_OFFSET_THRESHOLD,
            "GYRO": 0.0 if not self.loaded else GYRO_OFFSET_THRESHOLD,
            "MAG": MAG_OFFSET_THRESHOLD,
        }[self.kind]
        if np.isfinite(offset).all() and np.linalg.norm(offset - self.offset) > threshold:
            self.offset = offset
            return True
        return False

    def _set_scale(self, scale: Array) -> None:
        usable = np.isfinite(scale).all() and (scale > 0).all()
        if usable and np.linalg.norm(scale - self.scale) > SCALE_THRESHOLD:
            self.scale = scale

    def _set_off_diagonal(self, off_diagonal: Array) -> None:
        moved = np.linalg.norm(off_diagonal - self.off_diagonal) > OFF_DIAGONAL_THRESHOLD
        if np.isfinite(off_diagonal).all() and moved:
            self.off_diagonal = off_diagonal

    def as_parameters(self) -> dict[str, Any]:
        """The values in memory under the names of the slot they came from."""
        if self.slot is None:
            return {}
        base = f"CAL_{self.kind}{self.slot}"
        quantities = {"OFF": self.offset}
        if self.kind != "GYRO":
            quantities["SCALE"] = self.scale
        if self.kind == "MAG":
            quantities |= {"ODIAG": self.off_diagonal, "COMP": self.power}
        return {
            name: float(value)
            for quantity, vector in quantities.items()
            for name, value in zip(vector_names(base, quantity), vector, strict=True)
        }


def _vector(table: ParameterTable, base: str, quantity: str, default: float) -> Array:
    return np.array([table.get(name, default) for name in vector_names(base, quantity)])
