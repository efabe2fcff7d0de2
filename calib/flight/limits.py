"""Limits for the checks of a flight, each with its source; :mod:`calib.health` shares some."""

from __future__ import annotations

import math
from typing import Final

from mavcal.calib.flight.item import FlightLimit

ARMING_FORCE: Final = 0.75
"""m/s2 by which two accelerometers may differ before ArduPilot refuses to arm (ARMING_ACCTHRESH)."""
ARMING_RATE: Final = math.radians(5.0)
"""rad/s by which two gyroscopes may differ before ArduPilot refuses to arm."""

GRAVITY: Final = FlightLimit(
    0.1, ARMING_FORCE, "m/s2", "0.6 deg of tilt if it lay across gravity; ARMING_ACCTHRESH of ArduPilot"
)
RATE: Final = FlightLimit(
    math.radians(0.1), ARMING_RATE, "rad/s", "what the calibration at boot reaches; arming check of ArduPilot"
)
WANDER: Final = FlightLimit(
    math.radians(0.1), math.radians(1.0), "rad/s", "as for the bias: ten times what a job aims at"
)
APART: Final = FlightLimit(
    0.2, ARMING_FORCE, "m/s2", "the sum of what two good sensors may be off; ARMING_ACCTHRESH of ArduPilot"
)
RATES_APART: Final = FlightLimit(
    math.radians(0.2), ARMING_RATE, "rad/s", "twice that of one; arming check of ArduPilot"
)
LEVEL: Final = FlightLimit(1.0, 5.0, "deg", "a multicopter drifts visibly from one degree on")
VIBRATION: Final = FlightLimit(
    30.0, 60.0, "m/s2", "levels of ArduPilot's VIBE message: fine below 30, trouble above 60"
)
LOW_PASSED: Final = FlightLimit(
    5.0, 30.0, "m/s2", "half a g rms that passed a filter of 20 Hz or slow sampling: at least so much shakes"
)
CLIPPED: Final = FlightLimit(
    0.0, 100.0, "times", "ArduPilot: a count that rises with the motors on is trouble, a hundred the cause"
)
SCALE: Final = FlightLimit(0.02, 0.10, "1", "twice the sensitivity tolerance of a MEMS sensor (1 %); a broken axis")
