"""The limits of the health checks, each with where it is from."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np


@dataclass(frozen=True)
class HealthLimit:
    """Where a number becomes suspicious, and where the sensor is faulty; `source` says whose limits."""

    suspicious: float
    faulty: float
    unit: str
    source: str

    @property
    def worded(self) -> str:
        """Both numbers as a person reads them: shares in percent, rates in deg/s."""
        factor, unit = {"1": (100.0, "%"), "rad/s": (float(np.degrees(1.0)), "deg/s")}.get(self.unit, (1.0, self.unit))
        return f"{factor * self.suspicious:.3g} and {factor * self.faulty:.3g} {unit}"


FORCE: Final = HealthLimit(
    0.3, 0.75, "m/s2", "3 % of gravity, what a calibrated MEMS sensor keeps over temperature; ARMING_ACCTHRESH"
)
FORCE_DRIFT: Final = HealthLimit(0.25, 0.5, "m/s2", "as for the mean: what moves so far cannot be calibrated away")
RATE: Final = HealthLimit(
    float(np.radians(1.0)),
    float(np.radians(5.0)),
    "rad/s",
    "a gyroscope's drift over temperature; ArduPilot's arming check",
)
FORCES_APART: Final = HealthLimit(0.5, 0.75, "m/s2", "the sum of what two good units may be off; ARMING_ACCTHRESH")
RATES_APART: Final = HealthLimit(
    float(np.radians(1.5)), float(np.radians(5.0)), "rad/s", "the sum of what two good units may be off; arming check"
)
FIELD: Final = HealthLimit(0.12, 0.35, "1", "of the Earth's field: crust and a good calibration; ArduPilot's log check")
FIELD_STEADY: Final = HealthLimit(0.08, 0.2, "1", "of its mean, either way of 95 % of the samples: 5 deg of heading")
FIELD_DRIVEN: Final = HealthLimit(0.05, 0.3, "1", "of its mean; 30 % is where ArduPilot calls motor interference bad")
DIP: Final = HealthLimit(8.0, 25.0, "deg", "three times what crust and attitude do; ArduPilot's 'compass inconsistent'")
FIELDS_APART: Final = HealthLimit(
    15.0, 45.0, "deg", "the sum of what two good units may be off; arming check of ArduPilot"
)
CLIPS: Final = HealthLimit(
    0.0, 100.0, "times", "ArduPilot: a count that rises in flight is trouble, a hundred the cause"
)
VIBRATION: Final = HealthLimit(30.0, 60.0, "m/s2", "ArduPilot: fine below 30, trouble above 60")
STUCK: Final = HealthLimit(1.0, 5.0, "s", "no MEMS sensor repeats itself to the last digit so long")
