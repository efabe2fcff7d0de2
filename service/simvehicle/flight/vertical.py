"""Climb rates of take-off and landing, m/s upwards."""

from __future__ import annotations

from mavcal.service.simvehicle.flight.parameters import FlightParameters

CLOSE_ENOUGH = 0.3
"""m below the height that was asked for."""
_TAKEOFF_CLIMB = 2.0
_LANDING_FAST = 1.5
"""m/s, above LAND_ALT_LOW."""


def takeoff_climb(height: float, target: float) -> float:
    """Climb rate towards `target`; heights in m above the ground."""
    return min(_TAKEOFF_CLIMB, max(target - height, 0.0) + CLOSE_ENOUGH)


def landing_climb(height: float, parameters: FlightParameters) -> float:
    """Climb rate of a landing, slower below LAND_ALT_LOW."""
    low, slow = 0.01 * parameters["LAND_ALT_LOW"], 0.01 * parameters["LAND_SPEED"]
    return -(_LANDING_FAST if height > low else slow)
