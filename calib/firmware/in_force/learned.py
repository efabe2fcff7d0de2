"""Times at which an autopilot changed a compass offset by itself."""

from __future__ import annotations

import re
from typing import Final

from mavcal.calib.recording import Recording

_PX4_SAYS: Final = re.compile(r"^\[vehicle_magnetometer\] (\d+) \(\d+\) EST:\d+ offset: ")
"""PX4 stores what its estimator learned when it disarms (``VehicleMagnetometer.cpp``): the parameter changes later."""
_OFFSETS: Final = re.compile(r"^(?:CAL_MAG(?P<px4>\d)_[XYZ]OFF|COMPASS_OFS(?P<ardupilot>[23]?)_[XYZ])$")


def compass_offset_changes(recording: Recording) -> dict[int, tuple[float, ...]]:
    """By instance of a compass, the moments at which its offset in force changed, s, ascending."""
    found: dict[int, set[float]] = {}
    for event in recording.events:
        if said := _PX4_SAYS.match(event.text):
            found.setdefault(int(said[1]), set()).add(event.t)
    for entry in recording.parameters.changes(("CAL_MAG", "COMPASS_OFS")):
        if named := _OFFSETS.match(entry.name):
            instance = int(named["px4"]) if named["px4"] is not None else int(named["ardupilot"] or 1) - 1
            found.setdefault(instance, set()).add(entry.t)
    return {instance: tuple(sorted(times)) for instance, times in found.items()}
