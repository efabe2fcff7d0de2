"""DataFlash logs to recordings."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from calib.errors import UnreadableError
from calib.firmware.log_fields import WANTED
from calib.logs.dataflash.channels import compass_channels, inertial_channels
from calib.logs.dataflash.clock import Clock
from calib.logs.dataflash.log import DataFlash, Log
from calib.logs.dataflash.said import counted_events, identity_of, parameter_entries, spoken_events
from calib.logs.dataflash.scan import LONGEST
from calib.logs.dataflash.state import reference_channels, state_channels
from calib.recording import Event, ParameterTimeline, Recording

if TYPE_CHECKING:
    from calib.logs.dataflash.scan import Index

GPS_EPOCH: Final = datetime(1980, 1, 6, tzinfo=UTC)
LEAP_S: Final = 18
"""GPS time is ahead of UTC by so much since 2017; nothing here depends on a second."""


def read_dataflash(path_or_bytes: Path | str | bytes) -> Recording:
    """Read a binary DataFlash log of an ArduPilot as a recording, every channel at the firmware's stage.

    Returns
    -------
    Recording
        Times are seconds since the vehicle's boot. The parameters are those that the log holds, with their changes.
        `reference` is the truth of a simulated vehicle. An event ``utc`` says the date where the GPS knew it.

    Raises
    ------
    UnreadableError
        If it cannot be read as such a log.
    """
    log = DataFlash(path_or_bytes, WANTED)
    end = log.size - LONGEST
    whole = all(start >= end for start, _ in log.index.skipped)  # the last message is often cut: no parameter is lost
    return _recording(log, log.source, _damage(log.index, log.source), whole=whole)


def _recording(log: Log, source: str, damage: list[Event], *, whole: bool) -> Recording:
    clock = Clock(log)
    entries = parameter_entries(log, clock)
    parameters = ParameterTimeline(entries, end_observed=bool(entries) and whole)
    channels = [
        *inertial_channels(log, clock),
        *compass_channels(log, clock),
        *state_channels(log, clock, parameters.final()),
    ]
    if not channels:
        raise UnreadableError(
            f"{source} is a DataFlash log without a single sample of an inertial unit, a compass or a pose "
            f"(it holds {', '.join(sorted(log)) or 'no message'}): there is nothing to calibrate in it"
        )
    events = [*damage, *_date(log, clock), *spoken_events(log, clock), *counted_events(log, clock)]
    return Recording(
        channels=tuple(channels),
        parameters=parameters,
        events=tuple(sorted(events, key=lambda event: event.t)),
        identity=identity_of(log),
        source=source,
        reference=tuple(reference_channels(log, clock)),
    )


def _damage(index: Index, source: str) -> list[Event]:
    if not index.skipped:
        return []
    start, length = max(index.skipped, key=lambda stretch: stretch[1])
    places = f"in {len(index.skipped)} places, the longest {length} bytes at byte {start}"
    text = f"{index.skipped_bytes} bytes of {source} belong to no intact message and were stepped over, {places}"
    return [Event(0.0, "damage", text)]


def _date(log: Log, clock: Clock) -> list[Event]:
    """The first date that the GPS knew."""
    table = log.get("GPS")
    if table is None:
        return []
    week, time = ("GWk", "GMS") if "GWk" in table else ("Week", "TimeMS")
    if week not in table or time not in table:
        return []
    known = np.flatnonzero((table[week] > 1000) & (table["Status"] >= 3))
    if not len(known):
        return []
    row = int(known[0])
    seconds = int(table[week][row]) * 604800 + int(table[time][row]) / 1000.0 - LEAP_S
    date = GPS_EPOCH + timedelta(seconds=seconds)
    return [Event(float(clock.times(table)[row]), "utc", date.isoformat(timespec="seconds"))]
