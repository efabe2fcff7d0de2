"""What keeps the vehicle from arming, and from flying a mission; in the firmware's words, empty where nothing does."""

from __future__ import annotations

from collections.abc import Sequence

from mavcal.service.simvehicle.flight.items import AT_ONCE, Command, Item
from mavcal.service.simvehicle.flight.parameters import FlightParameters

READY_S = 5.0
"""When the position estimate is good enough for arming. Chosen: SITL takes some seconds more."""


def arming_fault(parameters: FlightParameters, time: float) -> str:
    """Why it does not arm `time` seconds after boot."""
    if parameters["ARMING_CHECK"] == 0:
        return ""
    if not parameters["SIM_GPS1_ENABLE"]:
        return "GPS 1: Bad fix"
    return "Need Position Estimate" if time < READY_S else ""


def mission_fault(items: Sequence[Item], *, flying: bool) -> str:
    """Why AUTO does not fly these items, the first of which is home."""
    if len(items) < 2:
        return "No mission"
    moving = [item.command for item in items[1:] if item.command not in AT_ONCE]
    return "" if flying or moving[:1] == [Command.TAKEOFF] else "Missing Takeoff Cmd"
