"""Compass offsets that the vehicle changed by itself: MAG says which were in force, PARM only what was commanded."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from mavcal.calib.errors import FirmwareError
from mavcal.calib.firmware import names
from mavcal.calib.firmware.names import ARDUPILOT_COMPASS_SLOTS
from mavcal.calib.firmware.slots import ardupilot_calibration_names
from mavcal.calib.logs.dataflash.channels import instances
from mavcal.calib.recording import Event, ParameterEntry, ParameterTimeline, Sensor

if TYPE_CHECKING:
    from mavcal.calib.logs.dataflash.clock import Clock
    from mavcal.calib.logs.dataflash.tables import Log

COLUMNS: Final = ("OfsX", "OfsY", "OfsZ")
TRUNCATION_MGAUSS: Final = 1.0
CONFIRMATIONS: Final = 3
"""An offset that stands in fewer messages in a row is damage, or was on its way."""
MOST: Final = 500


def learned_offsets(log: Log, clock: Clock, parameters: ParameterTimeline) -> tuple[list[ParameterEntry], list[Event]]:
    """Entries for offsets that were in force and are no parameter of the log, to the whole mGauss; and the events."""
    entries: list[ParameterEntry] = []
    events: list[Event] = []
    for number, message in enumerate(("MAG", "MAG2", "MAG3")):
        table = log.get(message)
        if table is None or not parameters or not all(name in table for name in COLUMNS):
            continue
        for instance, rows in instances(table, number):
            if instance < ARDUPILOT_COMPASS_SLOTS:
                t = np.asarray(clock.moments(rows))
                found = _unexplained(t, rows.arrays(COLUMNS)[0], instance, parameters)
                if found:
                    entries += found
                    text = (
                        f"the offset of compass {instance + 1} was changed by the vehicle itself (learnt on the way); "
                        "from here on it is known to the whole mGauss only"
                    )
                    events.append(Event(found[0].t, "text", text))
    return entries, events


def _unexplained(
    t: np.ndarray[tuple[int], np.dtype[np.float64]],
    offsets: np.ndarray[tuple[int, int], np.dtype[np.float64]],
    instance: int,
    parameters: ParameterTimeline,
) -> list[ParameterEntry]:
    """Entries at the times where the offset that stands in the messages becomes another one than the parameters say."""
    changed = np.flatnonzero((np.diff(offsets, axis=0) != 0).any(axis=1)) + 1
    edges = np.concatenate([[0], changed, [len(offsets)]])
    runs = edges[:-1][np.diff(edges) >= CONFIRMATIONS][:MOST]
    found: list[ParameterEntry] = []
    held: dict[str, float] = {}
    for row in runs.tolist():
        state = parameters.at(float(t[row])) | held
        try:
            roles = ardupilot_calibration_names(state, Sensor.MAG, instance)
        except FirmwareError:
            return []
        stated = [float(state.get(roles[role], np.nan)) for role in names.OFFSET]
        logged = offsets[row].tolist()
        if all(abs(a - b) <= TRUNCATION_MGAUSS for a, b in zip(stated, logged, strict=True)) or not np.all(
            np.isfinite(stated)
        ):
            continue
        held = {roles[role]: value for role, value in zip(names.OFFSET, logged, strict=True)}
        found += [ParameterEntry(float(t[row]), name, value) for name, value in held.items()]
    return found
