"""What shows that a vehicle is a simulator, and what does not; numbers as the firmwares give them."""

from __future__ import annotations

import pytest

from mavcal.calib.firmware.simulated import StatedHardware, proofs_needed, why_no_simulator

PROGRAM = StatedHardware(uid=0, board=0, vendor=0, product=0)
CUBE_ORANGE = StatedHardware(uid=0, board=140 << 16, vendor=0x2DAE, product=0x1016)
NAVIO = PROGRAM  # a Linux board says no number either
PX4_SIMULATOR = 0x4954_414C_4449_4E4F
"""What PX4's SIH said of itself (system 1), 29 November 2026."""


@pytest.mark.parametrize(
    ("autopilot", "stated", "parameters", "why"),
    [
        ("ardupilot", PROGRAM, {"SIM_SPEEDUP"}, None),
        ("ardupilot", CUBE_ORANGE, {"SIM_SPEEDUP"}, "board 140, USB 2dae:1016"),  # simulates on the flight controller
        ("ardupilot", CUBE_ORANGE, set(), "board 140"),
        ("ardupilot", NAVIO, set(), "no parameter SIM_SPEEDUP"),
        ("ardupilot", NAVIO, {"SIM_WIND_SPD"}, "no parameter SIM_SPEEDUP"),  # a script may name its own so
        ("ardupilot", None, {"SIM_SPEEDUP"}, "AUTOPILOT_VERSION"),
        ("px4", StatedHardware(PX4_SIMULATOR, 1, 0, 0), set(), None),
        ("px4", StatedHardware(PX4_SIMULATOR + 254, 1, 0, 0), set(), None),  # system 255
        ("px4", StatedHardware(PX4_SIMULATOR - 1, 1, 0, 0), set(), "unit id"),
        ("px4", StatedHardware(0x3036_3530_3531_5106, 56, 0x26AC, 0x38), {"SIM_SPEEDUP", "SYS_HITL"}, "unit id"),
        ("px4", StatedHardware(0x3030_3044_3030_3030, 1, 0, 0), set(), "unit id"),  # a Raspberry Pi
        ("px4", None, set(), "AUTOPILOT_VERSION"),
        (None, PROGRAM, {"SIM_SPEEDUP"}, "neither ArduPilot nor PX4"),
    ],
)
def test_unknown_is_no_simulator(
    autopilot: str | None, stated: StatedHardware | None, parameters: set[str], why: str | None
) -> None:
    found = why_no_simulator(autopilot, stated, parameters)
    assert found is None if why is None else found is not None and why in found


def test_what_is_asked_for_is_what_proves() -> None:
    assert why_no_simulator("ardupilot", PROGRAM, proofs_needed("ardupilot")) is None
    assert proofs_needed("px4") == proofs_needed(None) == ()
