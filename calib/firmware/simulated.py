"""Distinguishes a simulator from a real vehicle by properties that only a simulator's firmware has.

ArduPilot has ``SIM_SPEEDUP`` only where it was built to simulate (``AP_SIM_ENABLED``: ArduCopter/Parameters.cpp,
boards.py). Such a build may also run on a flight controller and drive its outputs (``SIM_OH_MASK``). It then states the
numbers of its board in AUTOPILOT_VERSION, where a program has zeros (GCS_Common.cpp).

PX4's simulator gives the UUID "SIMULATIONID0000" (boards/px4/sitl). ``SIH_*`` and ``SYS_HITL`` prove nothing: flight
controllers have both, and the motors may be connected.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import Final

from mavcal.calib.firmware.device_ids import is_simulation_id

ARDUPILOT_NAME: Final = "SIM_SPEEDUP"
"""Parameter that ArduPilot has only where it simulates."""


@dataclass(frozen=True)
class StatedHardware:
    """The fields of AUTOPILOT_VERSION that describe the hardware."""

    uid: int
    board: int
    vendor: int
    product: int


def proofs_needed(autopilot: str | None) -> tuple[str, ...]:
    """Parameters whose presence must be asked for."""
    return (ARDUPILOT_NAME,) if autopilot == "ardupilot" else ()


def why_no_simulator(autopilot: str | None, stated: StatedHardware | None, parameters: Collection[str]) -> str | None:
    """Why the vehicle may not be a simulator, or what is missing to show it; None: it is proved to be one.

    Parameters
    ----------
    autopilot
        "ardupilot" or "px4"; another firmware cannot show it.
    stated
        From AUTOPILOT_VERSION; None if it did not come.
    parameters
        Names of parameters that it has.
    """
    if autopilot not in ("ardupilot", "px4"):
        return "its firmware is neither ArduPilot nor PX4"
    if stated is None:
        return "it does not say on what it runs (AUTOPILOT_VERSION)"
    if autopilot == "px4":
        named = is_simulation_id(stated.uid)
        return None if named else f"its unit id is {stated.uid:016x}, not that of PX4's simulator"
    if stated.board or stated.vendor or stated.product:
        usb = f"{stated.vendor:04x}:{stated.product:04x}"
        return f"it runs on a flight controller (board {stated.board >> 16}, USB {usb})"
    has = ARDUPILOT_NAME in parameters
    return None if has else f"it has no parameter {ARDUPILOT_NAME}, as ArduPilot's simulator has"
