"""What ArduPilot's onboard calibrations store, and what arming checks require afterwards."""

from __future__ import annotations

from collections.abc import Callable

from mavcal.service.simvehicle.parameters import ParameterTable, Value


class StoredCalibrations:
    """Stores calibrations; knows which accelerometers count as calibrated and whether a reboot is due."""

    def __init__(self, table: ParameterTable, announce: Callable[[list[str]], None]) -> None:
        self._table, self._announce = table, announce
        self.accels: set[int] = set()
        """Instances whose ids are stored: they count as calibrated."""
        self.reboot_reason: str | None = None
        """Arming is refused with this reason until the next boot."""

    def boot(self) -> None:
        """Note that the vehicle has rebooted."""
        self.reboot_reason = None

    def mark_accels(self, count: int) -> None:
        """The ids of all accelerometers are stored: they count as calibrated."""
        self.accels = set(range(count))

    def require_reboot(self, reason: str) -> None:
        """Refuse arming with this reason until the next boot."""
        self.reboot_reason = reason

    def write(self, values: dict[str, Value], *, announce: bool = True) -> None:
        """Store what the firmware itself has found, save it, and tell every link."""
        for name, value in values.items():
            self._table.store(name, value)
            self._table.save(name)
        if announce:
            self._announce(list(values))
