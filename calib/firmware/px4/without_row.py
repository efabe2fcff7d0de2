"""Sensors of which PX4 itself says that their device id is in none of its calibration rows.

No stream carries a device id, and PX4 leaves the id of a sensor that was taken away in its row. What it says of its
own arming checks is the only sign that a row is stale.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Final

from mavcal.calib.recording import Event, Sensor

_SAID: Final = re.compile(r"\b(Accel|Gyro|Compass|Mag) #?(\d) uncalibrated")
"""``HealthAndArmingChecks/checks/``: accelerometerCheck, gyroCheck and magnetometerCheck; instances from 0."""
_SENSORS: Final = {"Accel": Sensor.ACCEL, "Gyro": Sensor.GYRO, "Compass": Sensor.MAG, "Mag": Sensor.MAG}


def without_row(events: Iterable[Event]) -> frozenset[tuple[Sensor, int]]:
    """The sensors that PX4 calls uncalibrated in these texts, by streamed instance.

    >>> sorted(without_row([Event(0.0, "text", "Preflight Fail: Compass 1 uncalibrated")]))
    [(<Sensor.MAG: 'mag'>, 1)]
    """
    said = [match for event in events for match in _SAID.finditer(event.text)]
    return frozenset((_SENSORS[match[1]], int(match[2])) for match in said)
