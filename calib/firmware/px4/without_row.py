"""Sensors whose device id is in no calibration row, as PX4 itself says.

No stream carries a device id, and PX4 leaves the id of a sensor that was taken away in its row. What it says of its
own arming checks is the only sign that a row is stale.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from typing import Final

from mavcal.calib.recording import Event, ParameterEntry, Sensor

_SAID: Final = re.compile(r"\b(Accel|Gyro|Compass|Mag) #?(\d) uncalibrated")
"""``HealthAndArmingChecks/checks/``: accelerometerCheck, gyroCheck and magnetometerCheck; instances from 0."""
_SENSORS: Final = {"Accel": Sensor.ACCEL, "Gyro": Sensor.GYRO, "Compass": Sensor.MAG, "Mag": Sensor.MAG}
_ID: Final = re.compile(r"CAL_(ACC|GYRO|MAG)\d_ID")
_ROWS: Final = {"ACC": Sensor.ACCEL, "GYRO": Sensor.GYRO, "MAG": Sensor.MAG}


def without_row(events: Iterable[Event], entries: Iterable[ParameterEntry] = ()) -> frozenset[tuple[Sensor, int]]:
    """The sensors that PX4 calls uncalibrated in these texts, by streamed instance.

    `entries`: the parameters as they were heard. What was said before an id of that kind changed counts no more: PX4
    fills the row of a gyroscope by itself.

    >>> sorted(without_row([Event(0.0, "text", "Preflight Fail: Compass 1 uncalibrated")]))
    [(<Sensor.MAG: 'mag'>, 1)]
    """
    since = _last_change_of_ids(entries)
    said = [(event.t, match) for event in events for match in _SAID.finditer(event.text)]
    found = [(t, _SENSORS[match[1]], int(match[2])) for t, match in said]
    return frozenset((sensor, instance) for t, sensor, instance in found if t >= since.get(sensor, -math.inf))


def _last_change_of_ids(entries: Iterable[ParameterEntry]) -> dict[Sensor, float]:
    held: dict[str, float] = {}
    since: dict[Sensor, float] = {}
    for entry in entries:
        match = _ID.fullmatch(entry.name)
        if match is None:
            continue
        if held.setdefault(entry.name, entry.value) != entry.value:
            held[entry.name] = entry.value
            since[_ROWS[match[1]]] = entry.t
    return since
