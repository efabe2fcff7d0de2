"""Reads DataFlash logs as recordings.

Batches hold some thousand consecutive samples of one sensor at its own rate. ISBH states sensor, instance, time of the
first sample, rate and scale; each of the following ISBD holds 32 samples as int16 (``BatchSampler.cpp``). Where the
vehicle changed compass offsets itself, MAG states those in force, PARM only the commanded ones.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from mavcal.calib.errors import FirmwareError, UnreadableError
from mavcal.calib.firmware import names
from mavcal.calib.firmware.ardupilot.doubts import parameter_faults
from mavcal.calib.firmware.ardupilot.log_fields import TEXT_COLUMNS, WANTED, implied_parameters
from mavcal.calib.firmware.ardupilot.outputs import kind_of_vehicle
from mavcal.calib.firmware.names import ARDUPILOT_COMPASS_SLOTS
from mavcal.calib.firmware.slots import ardupilot_calibration_names
from mavcal.calib.logs.dataflash.channels import SensorChannels, instances
from mavcal.calib.logs.dataflash.clock import Clock
from mavcal.calib.logs.dataflash.events import counted_events, identity_of, parameter_entries, spoken_events
from mavcal.calib.logs.dataflash.log import DataFlash
from mavcal.calib.logs.dataflash.scan import LONGEST
from mavcal.calib.logs.dataflash.state import dynamics_channels, reference_channels, state_channels
from mavcal.calib.logs.dataflash.tables import Log, Table
from mavcal.calib.logs.dataflash.text import TextLog
from mavcal.calib.recording import (
    Array,
    Channel,
    Event,
    Identity,
    ParameterEntry,
    ParameterTimeline,
    Recording,
    Rounding,
    Sensor,
    Stage,
)

if TYPE_CHECKING:
    from mavcal.calib.logs.dataflash.scan import Index

GPS_EPOCH: Final = datetime(1980, 1, 6, tzinfo=UTC)
LEAP_S: Final = 18
"""Lead of GPS time over UTC since 2017, s; one second more or less does not matter here."""
COLUMNS: Final = ("OfsX", "OfsY", "OfsZ")
TRUNCATION_MGAUSS: Final = 1.0
CONFIRMATIONS: Final = 3
"""Consecutive messages that confirm an offset; in fewer, it is damage or still changing."""
MOST: Final = 500
SAMPLES: Final = 32
SENSORS: Final = {0: (Sensor.ACCEL, "m/s2"), 1: (Sensor.GYRO, "rad/s")}
UNITS: Final = 5
"""Numbers of the inertial units that a vehicle may have."""
OPTION: Final = "INS_LOG_BAT_OPT"
SENSOR_RATE, POST_FILTER = 1, 2
HEADER: Final = ("N", "type", "instance", "mul", "smp_cnt", "SampleUS", "smp_rate")
DATA: Final = ("N", "seqno", "x", "y", "z")


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


def read_dataflash_text(path: Path | str) -> Recording:
    """Read a DataFlash log in text form, as old firmwares and ground stations write it, as a recording.

    Raises
    ------
    UnreadableError
        If it cannot be read as such a log.
    """
    file = Path(path)
    try:
        content = file.read_bytes()
    except OSError as error:
        raise UnreadableError(f"{file.name} cannot be opened: {error.strerror or error}") from error
    log = TextLog(content, file.name, WANTED)
    damage = []
    if log.skipped:
        text = f"{log.skipped} of {log.lines} lines of {file.name} are no intact messages and were left out"
        damage.append(Event(0.0, "damage", text))
    return _recording(log, file.name, damage, whole=not damage)


def _recording(log: Log, source: str, damage: list[Event], *, whole: bool) -> Recording:
    log = {name: table for name, table in log.items() if _types_match(table)}
    clock = Clock(log)
    identity = identity_of(log)
    parameters, parameter_events = _parameters(log, clock, identity, whole=whole)
    kind = kind_of_vehicle(identity.vehicle_type, parameters.final())
    identity = dataclasses.replace(identity, vehicle_type=kind)
    sensors = SensorChannels(log, clock)
    final = parameters.final()
    channels = [
        *sensors.channels,
        *batch_channels(log, final),
        *state_channels(log, clock, final, identity.vehicle_type),
    ]
    if not channels and not any(event.kind == "dead" for event in sensors.events):
        raise UnreadableError(
            f"{source} is a DataFlash log without a single sample of an inertial unit, a compass or a pose "
            f"(it holds {', '.join(sorted(log)) or 'no message'}): there is nothing to calibrate in it"
        )
    reference = tuple(reference_channels(log, clock))
    events = [*damage, *_date(log, clock), *spoken_events(log, clock), *counted_events(log, clock), *clock.events]
    events += [*parameter_events, *sensors.events]
    if clock.doubted:
        text = f"{clock.doubted} messages say a time that those around them contradict, and were left out"
        events.append(Event(0.0, "damage", text))
    return Recording(
        channels=tuple(channels),
        parameters=parameters,
        events=tuple(sorted(events, key=lambda event: event.t)),
        identity=identity,
        source=source,
        reference=reference,
        dynamics=dynamics_channels(log, clock),
    )


def _parameters(log: Log, clock: Clock, identity: Identity, *, whole: bool) -> tuple[ParameterTimeline, list[Event]]:
    """Parameters of the log: its list, later settings, defaults of old firmwares, and changes by the vehicle."""
    entries = list(parameter_entries(log, clock))
    if whole:
        listed = {entry.name: entry.value for entry in entries}
        implied = implied_parameters(listed, identity.firmware)
        entries = [*(ParameterEntry(-np.inf, name, value) for name, value in implied.items()), *entries]
    timeline = ParameterTimeline(tuple(entries), end_observed=bool(entries) and whole)
    learned, events = learned_offsets(log, clock, timeline)
    if learned:
        merged = sorted([*entries, *learned], key=lambda entry: entry.t)
        timeline = ParameterTimeline(tuple(merged), end_observed=timeline.end_observed)
    start = entries[0].t if entries and np.isfinite(entries[0].t) else 0.0
    events += [Event(start, "undo", text) for text in parameter_faults(timeline.final())]
    return timeline, events


def _types_match(table: Table) -> bool:
    """Whether known columns have their type: numbers or texts."""
    texts = TEXT_COLUMNS.get(table.name, ())
    arrays = ("x", "y", "z") if table.name == "ISBD" else ()
    return len(table) > 0 and all(
        (letter in "nNZ") <= (column in texts) and (letter == "a") == (column in arrays)
        for column, letter in zip(table.names, table.format.letters, strict=True)
    )


def _damage(index: Index, source: str) -> list[Event]:
    if not index.skipped:
        return []
    start, length = max(index.skipped, key=lambda stretch: stretch[1])
    places = f"in {len(index.skipped)} places, the longest {length} bytes at byte {start}"
    text = f"{index.skipped_bytes} bytes of {source} belong to no intact message and were stepped over, {places}"
    return [Event(0.0, "damage", text)]


def _date(log: Log, clock: Clock) -> list[Event]:
    """The first date from the GPS."""
    table = log.get("GPS")
    if table is None:
        return []
    week, time = ("GWk", "GMS") if "GWk" in table else ("Week", "TimeMS")
    if any(name not in table for name in (week, time, "Status")):
        return []
    known = np.flatnonzero((table[week] > 1000) & (table["Status"] >= 3))
    if not len(known):
        return []
    row = int(known[0])
    seconds = int(table[week][row]) * 604800 + int(table[time][row]) / 1000.0 - LEAP_S
    date = GPS_EPOCH + timedelta(seconds=seconds)
    return [Event(clock.moments(table)[row], "utc", date.isoformat(timespec="seconds"))]


def learned_offsets(log: Log, clock: Clock, parameters: ParameterTimeline) -> tuple[list[ParameterEntry], list[Event]]:
    """Entries, to the whole mGauss, for offsets in force that the log's parameters lack; and the events."""
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
    """Entries at the times where the offset in the messages begins to differ from the parameters."""
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


def batch_channels(log: Log, parameters: Mapping[str, float]) -> list[Channel]:
    """One channel for each sensor that was sampled in batches; between the batches it has gaps."""
    heads, data = log.get("ISBH"), log.get("ISBD")
    if heads is None or data is None or not all(c in heads for c in HEADER) or not all(c in data for c in DATA):
        return []
    head = dict(zip(HEADER, heads.columns(*HEADER), strict=True))
    number, sequence, x, y, z = data.columns(*DATA)
    of = np.searchsorted(heads.offsets, data.offsets) - 1
    intact = (of >= 0) & (head["N"][of] == number) & (head["mul"][of] > 0) & (head["smp_rate"][of] > 0)
    option = int(parameters.get(OPTION, 0))
    stage = Stage.RAW if option & SENSOR_RATE else Stage.FILTERED if option & POST_FILTER else Stage.CORRECTED
    found = []
    for kind, (sensor, unit) in SENSORS.items():
        for instance in range(UNITS):
            rows = np.flatnonzero(intact & (head["type"][of] == kind) & (head["instance"][of] == instance))
            if not len(rows):
                continue
            chosen = {name: column[of[rows]].astype(np.float64) for name, column in head.items()}
            counts = np.stack([axis[rows] for axis in (x, y, z)], axis=2).astype(np.float64)
            channel = _channel(
                sensor,
                instance,
                unit,
                stage=stage,
                head=chosen,
                sequence=sequence[rows].astype(np.float64),
                counts=counts,
            )
            if len(channel):
                found.append(channel)
    return found


def _channel(
    sensor: Sensor,
    instance: int,
    unit: str,
    *,
    stage: Stage,
    head: Mapping[str, Array],
    sequence: Array,
    counts: Array,
) -> Channel:
    """`head` and `sequence` (M,) of the messages, their int16 in `counts` (M, 32, 3)."""
    place = sequence[:, None] * SAMPLES + np.arange(SAMPLES)
    t = (1e-6 * head["SampleUS"][:, None] + place / head["smp_rate"][:, None]).ravel()
    inside = (place < head["smp_cnt"][:, None]).ravel()
    zero = counts == 0
    values = ((counts + 0.5 * np.sign(counts)) / head["mul"][:, None, None]).reshape(-1, 3)
    order = np.flatnonzero(inside)[np.argsort(t[inside], kind="stable")]
    quantum = float(1.0 / np.min(head["mul"]))
    return Channel(
        sensor,
        instance,
        t[order],
        values[order],
        unit,
        stage,
        "ISBD",
        quantum,
        Rounding.TOWARD_ZERO,
        zero.reshape(-1, 3)[order],
    )
