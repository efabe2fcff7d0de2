"""Limits of the health checks, each with its source; those shared with :mod:`calib.flight` are defined there."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from mavcal.calib.flight import limits as flight
from mavcal.calib.flight.item import FlightLimit, worded_bounds


@dataclass(frozen=True)
class HealthLimit:
    """Limits beyond which a number is suspicious, and the sensor faulty; `source` says whose limits.

    `faulty` is None where the number alone cannot call a sensor faulty.
    """

    suspicious: float
    faulty: float | None
    unit: str
    source: str

    @property
    def worded(self) -> str:
        """The limits in display units: fractions in percent, rates in deg/s."""
        return worded_bounds(self.suspicious, self.faulty, self.unit)

    @classmethod
    def of(cls, limit: FlightLimit) -> HealthLimit:
        """Health limit from the limit of a flight check."""
        return cls(limit.warn, limit.fail, limit.unit, limit.source)


FORCE: Final = HealthLimit(
    0.25, flight.ARMING_FORCE, "m/s2", "2.5 % of gravity, 1.5 deg of tilt if it lay across; ARMING_ACCTHRESH"
)
FORCE_DRIFT: Final = HealthLimit(0.25, 0.5, "m/s2", "as for the mean: what moves so far cannot be calibrated away")
RATE: Final = HealthLimit(
    float(np.radians(1.0)),
    flight.ARMING_RATE,
    "rad/s",
    "a gyroscope's drift over temperature; ArduPilot's arming check",
)
FORCES_APART: Final = HealthLimit(
    0.35, flight.ARMING_FORCE, "m/s2", "what two units may differ by if each is off by 0.25; ARMING_ACCTHRESH"
)
RATES_APART: Final = HealthLimit(
    float(np.radians(1.5)), flight.ARMING_RATE, "rad/s", "the sum of what two good units may be off; arming check"
)
FIELD: Final = HealthLimit(0.12, 0.35, "1", "of the Earth's field: crust and a good calibration; ArduPilot's log check")
FIELD_STEADY: Final = HealthLimit(0.08, 0.2, "1", "of its mean, either way of 95 % of the samples: 5 deg of heading")
FIELD_DRIVEN: Final = HealthLimit(0.05, 0.3, "1", "of its mean; 30 % is where ArduPilot calls motor interference bad")
DIP: Final = HealthLimit(8.0, 25.0, "deg", "three times what crust and attitude do; ArduPilot's 'compass inconsistent'")
FIELDS_APART: Final = HealthLimit(
    15.0, 45.0, "deg", "the sum of what two good units may be off; arming check of ArduPilot"
)
FIELD_ALONE: Final = HealthLimit(
    6.0, 45.0, "deg", "beside others that agree within a third of it; chosen: false alarms are not measured"
)
CLIPS: Final = HealthLimit.of(flight.CLIPPED)
VIBRATION: Final = HealthLimit.of(flight.VIBRATION)
PX4_VIBRATION: Final = HealthLimit(4.905, 9.81, "m/s2", "the colours of PX4's Flight Review: 0.5 and 1 g")
NEAR_NYQUIST: Final = HealthLimit(5.0, None, "m/s2", "half a g that may be a faster vibration folded back; our choice")
WARMTH: Final = HealthLimit(2.0, None, "degC", "what a thermometer on the chip is good to")
SILENT: Final = HealthLimit(0.5, 5.0, "s", "ArduPilot calls a compass unhealthy after half a second without a reading")
UNHEALTHY: Final = HealthLimit(0.01, 0.1, "1", "of the samples: more than a start or one hiccup; our choice")
STUCK: Final = HealthLimit(1.0, 5.0, "s", "no MEMS sensor repeats itself to the last digit so long")
