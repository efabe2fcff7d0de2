"""Samples whose gyro offsets in force are certain, while PX4 rewrites these offsets.

PX4's ``gyro_calibration`` rewrites CAL_GYROn_*OFF of a vehicle that warms up at rest. It sends the new value up to 0.4
s after it acts. It sends nothing if the value was saved before: ``mavlink_parameters.cpp`` sends what is unsaved. So a
job reads the offsets every :data:`READ_EVERY_S`, and only samples between two readings that agree count. Samples of
every sensor are left out together: a gyro that pauses alone would look lost.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Mapping
from typing import Final

import numpy as np

from mavcal.calib.firmware.in_force.fingerprint import REWRITTEN_AT_REST
from mavcal.calib.firmware.in_force.needed import DRIFT_KINDS
from mavcal.calib.firmware.in_force.undo import GUARD_AFTER_S, GUARD_BEFORE_S
from mavcal.calib.firmware.plan import Value
from mavcal.calib.recording import Channel, ParameterEntry, Recording, join

READ_EVERY_S: Final = 2.0
"""Period of a job's reading of the offsets, s of the vehicle's clock."""
HOLD_S: Final = 5.0
"""How long samples wait for the reading after them, s: two readings, and the time that one takes."""
REGULAR: Final = 3
"""Repeated readings that show that the offsets are read regularly, not only sent on a change."""
_PX4_SAYS: Final = re.compile(r"^\[vehicle_magnetometer\] (\d+) \(\d+\) EST:\d+ offset: ")
"""PX4 stores what its estimator learned when it disarms (``VehicleMagnetometer.cpp``): the parameter changes later."""
_OFFSETS: Final = re.compile(r"^(?:CAL_MAG(?P<px4>\d)_[XYZ]OFF|COMPASS_OFS(?P<ardupilot>[23]?)_[XYZ])$")


class CertainOffsets:
    """Drops samples between the last reading of an old offset and the first reading of the new one.

    If the offsets are not read regularly (as in a foreign log), it leaves this to
    :class:`~calib.firmware.in_force.undo.Undo`, which trusts the reported values.

    Parameters
    ----------
    whole
        True: one chunk is the whole recording. False: chunks follow each other, and all of a chunk comes
        :data:`HOLD_S` later.
    """

    def __init__(self, *, whole: bool = False) -> None:
        self._hold = 0.0 if whole else HOLD_S
        self._seen: dict[str, tuple[float, Value]] = {}
        self._read: dict[str, int] = {}
        self._doubtful: list[tuple[float, float]] = []
        self._waiting: list[Recording] = []
        self._newest = -np.inf

    def feed(self, chunk: Recording) -> Recording:
        """Return the samples and parameters that are certain so far, oldest first."""
        for entry in chunk.parameters.entries:
            if entry.name in REWRITTEN_AT_REST:
                self._read_entry(entry)
        if not self._hold:
            return self._certain(chunk)
        if any(event.kind == "reboot" for event in chunk.events):  # its times begin again
            waiting, self._waiting, self._newest = [*self._waiting, chunk], [], -np.inf
            return self._certain(join(waiting))
        self._newest = max([self._newest, *(float(c.t[-1]) for c in chunk.channels if len(c))])
        whole, until = join([*self._waiting, chunk]), self._newest - self._hold
        self._waiting = [_part(whole.between(until, np.inf), [e for e in whole.parameters.entries if e.t >= until])]
        return self._certain(_part(whole.between(-np.inf, until), [e for e in whole.parameters.entries if e.t < until]))

    def _read_entry(self, entry: ParameterEntry) -> None:
        since, value = self._seen.get(entry.name, (entry.t, entry.value))
        self._seen[entry.name] = entry.t, entry.value
        if value == entry.value:
            self._read[entry.name] = self._read.get(entry.name, 0) + 1
        elif self._read.get(entry.name, 0) >= REGULAR:
            self._doubtful.append((since - GUARD_BEFORE_S, entry.t + GUARD_AFTER_S))

    def _certain(self, recording: Recording) -> Recording:
        kept = (self._certain_samples(channel) for channel in recording.channels)
        return recording.with_channels(channel for channel in kept if len(channel))

    def _certain_samples(self, channel: Channel) -> Channel:
        if not self._doubtful:
            return channel
        doubtful = np.zeros(len(channel), dtype=bool)
        for start, end in self._doubtful:
            doubtful |= (channel.t >= start) & (channel.t < end)
        return channel.take(~doubtful) if doubtful.any() else channel


def _part(recording: Recording, entries: list[ParameterEntry]) -> Recording:
    kept = dataclasses.replace(recording.parameters, entries=tuple(entries))
    return dataclasses.replace(recording, parameters=kept)


def rewrites_meanwhile(kind: str, autopilot: str | None) -> bool:
    """Whether a job of `kind` goes on while this autopilot rewrites its own gyro offsets."""
    return kind in DRIFT_KINDS and autopilot == "px4"


def read_again(kind: str, autopilot: str | None, parameters: Mapping[str, Value]) -> tuple[str, ...]:
    """Names of the offsets that a job of `kind` reads every :data:`READ_EVERY_S`; empty: none is rewritten."""
    if not rewrites_meanwhile(kind, autopilot) or int(parameters.get("IMU_GYRO_CAL_EN", 0)) == 0:
        return ()
    return tuple(sorted(name for name in parameters if name in REWRITTEN_AT_REST and _has_sensor(name, parameters)))


def _has_sensor(name: str, parameters: Mapping[str, Value]) -> bool:
    return bool(parameters.get(f"{name.rpartition('_')[0]}_ID", 0))


def compass_offset_changes(recording: Recording) -> dict[int, tuple[float, ...]]:
    """Times at which the offset in force of each compass changed, s, ascending, by instance."""
    found: dict[int, set[float]] = {}
    for event in recording.events:
        if match := _PX4_SAYS.match(event.text):
            found.setdefault(int(match[1]), set()).add(event.t)
    for entry in recording.parameters.changes(("CAL_MAG", "COMPASS_OFS")):
        if named := _OFFSETS.match(entry.name):
            instance = int(named["px4"]) if named["px4"] is not None else int(named["ardupilot"] or 1) - 1
            found.setdefault(instance, set()).add(entry.t)
    return {instance: tuple(sorted(times)) for instance, times in found.items()}
