"""The PX4 personality."""

from __future__ import annotations

from service.simvehicle.ardupilot import ArduPilotVehicle


class Px4Vehicle(ArduPilotVehicle):
    """Placeholder."""
