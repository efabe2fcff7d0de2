"""Reads telemetry logs (.tlog) as recordings."""

from __future__ import annotations

import dataclasses
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.calib.errors import UnreadableError
from mavcal.calib.firmware.names import CALIBRATION_PREFIXES, Role, ardupilot_imu_names
from mavcal.calib.firmware.stream.announcements import AUTOPILOTS
from mavcal.calib.firmware.stream.assembler import Assembler
from mavcal.calib.firmware.stream.messages import INERTIAL
from mavcal.calib.recording import Event, Identity, Oddity, OddSamples, Recording, Sensor
from mavcal.calib.wire.codec import decode
from mavcal.calib.wire.tlog import TlogReader

if TYPE_CHECKING:
    from mavcal.calib.wire.frames import Frame

HEARTBEAT: Final = dialect.MAVLINK_MSG_ID_HEARTBEAT
LEAST_MESSAGES: Final = 50
"""Least number of messages with only zeros that show a dead sensor."""
INERTIAL_IDS: Final = frozenset(INERTIAL["ardupilot"])

Vehicle = tuple[int, int]
"""System and component."""


def read_tlog(
    path_or_bytes: Path | str | bytes | memoryview, *, start: int = 0, end: int | None = None, system: int | None = None
) -> Recording:
    """Read the bytes ``start:end`` of a .tlog as the recording of one vehicle, at the firmware's stage.

    Parameters
    ----------
    path_or_bytes
        The file, or its content.
    start, end
        Byte range of a segment; damaged or cut records are stepped over. None: to the end of the file.
    system
        MAVLink system id of the vehicle; None: the one with the most inertial frames.

    Returns
    -------
    Recording
        Times are seconds since the vehicle's first boot in the file. ``parameters.end_observed`` is True if every
        calibration parameter in it was read again after the last inertial sample.

    Raises
    ------
    UnreadableError
        If the file holds no vehicle of ArduPilot or PX4, or not that `system`.
    """
    name, data = _content(path_or_bytes)
    reader = TlogReader(memoryview(data)[start:end])
    frames: list[tuple[int | None, Frame]] = [(time_us, frame) for time_us, frame in reader]
    identity = _vehicle([frame for _, frame in frames], system, name)
    recording = Assembler(identity).feed(frames)
    events = (*_first_state(frames, recording), *recording.events, *_zeros(frames, recording))
    if reader.skipped_bytes:
        damage = f"{reader.skipped_bytes} bytes of {name} belong to no intact record and were stepped over"
        events = (Event(0.0, "damage", damage), *events)
    entries = recording.parameters
    return dataclasses.replace(
        recording,
        events=events,
        source=name,
        parameters=dataclasses.replace(entries, end_observed=_end_observed(recording)),
    )


def _content(path_or_bytes: Path | str | bytes | memoryview) -> tuple[str, bytes | memoryview]:
    if isinstance(path_or_bytes, (bytes, memoryview)):
        return "the telemetry log", path_or_bytes
    path = Path(path_or_bytes)
    try:
        return path.name, path.read_bytes()
    except OSError as error:
        raise UnreadableError(f"{path.name} cannot be read: {error.strerror}") from error


def _vehicle(frames: list[Frame], system: int | None, name: str) -> Identity:
    """The recorded vehicle: it must have identified itself by a HEARTBEAT of its autopilot."""
    autopilots: dict[Vehicle, str] = {}
    inertial: Counter[Vehicle] = Counter()
    for frame in frames:
        sender = frame.system, frame.component
        if frame.message_id == HEARTBEAT:
            message = decode(frame)
            if message.autopilot != dialect.MAV_AUTOPILOT_INVALID:
                autopilots.setdefault(sender, AUTOPILOTS.get(message.autopilot, "other"))
        elif frame.message_id in INERTIAL_IDS:
            inertial[sender] += 1
    known = [sender for sender, autopilot in autopilots.items() if autopilot in INERTIAL]
    if system is not None:
        known = [sender for sender in known if sender[0] == system]
    if not known:
        heard = ", ".join(f"{s}/{c} ({a})" for (s, c), a in autopilots.items()) or "no autopilot"
        asked = (
            "an ArduPilot or PX4 vehicle" if system is None else f"an ArduPilot or PX4 vehicle with system id {system}"
        )
        raise UnreadableError(
            f"{name} holds {len(frames)} MAVLink frames and {asked} is not among them (heard: {heard}); "
            "give a .tlog that was recorded with the vehicle's HEARTBEAT"
        )
    chosen = max(known, key=lambda sender: inertial[sender])
    return Identity(autopilot=autopilots[chosen], system=chosen[0], component=chosen[1])


def _first_state(frames: list[tuple[int | None, Frame]], recording: Recording) -> list[Event]:
    """Event with the arming state when the vehicle was first heard; later changes are events already."""
    identity = recording.identity
    for _, frame in frames:
        if frame.message_id == HEARTBEAT and (frame.system, frame.component) == (identity.system, identity.component):
            message = decode(frame)
            if message.autopilot == dialect.MAV_AUTOPILOT_INVALID:
                continue
            kind = "armed" if message.base_mode & dialect.MAV_MODE_FLAG_SAFETY_ARMED else "disarmed"
            start = recording.span[0]
            return [Event(start, kind, f"the vehicle was {kind}")] if np.isfinite(start) else []
    return []


def _zeros(frames: list[tuple[int | None, Frame]], recording: Recording) -> list[Event]:
    """Inertial units that the parameters announce, and whose messages contain only zeros.

    Other units are absent: a message has zeros for them if the instance has only a compass.
    """
    identity, parameters = recording.identity, recording.parameters.final()
    if identity.autopilot != "ardupilot":
        return []
    heard = Counter(f.message_id for _, f in frames if (f.system, f.component) == (identity.system, identity.component))
    events = []
    for number, message in INERTIAL.get(identity.autopilot or "", {}).items():
        if message.by_id or heard[number] < LEAST_MESSAGES:
            continue
        for sensor in (Sensor.ACCEL, Sensor.GYRO):
            device_id = parameters.get(ardupilot_imu_names(sensor, message.instance)[Role.ID])
            if device_id and message.instance not in recording.instances(sensor):
                name = f"{sensor} {message.instance + 1}"
                text = f"{name}: all {heard[number]} samples of {message.name} are exactly 0, 0, 0"
                odd = OddSamples(Oddity.ZERO, sensor, message.instance, heard[number], heard[number])
                events.append(Event(0.0, "dead", text, odd))
    return events


def _end_observed(recording: Recording) -> bool:
    autopilot = recording.identity.autopilot
    inertial = [c for c in recording.channels if c.unit in ("m/s2", "rad/s", "uT") and len(c)]
    if (
        autopilot is None or autopilot not in CALIBRATION_PREFIXES or not inertial
    ):  # it may have said later that it is another one
        return False
    last_sample = max(float(c.t[-1]) for c in inertial)
    seen: dict[str, float] = {}
    for entry in recording.parameters.entries:
        if entry.name.startswith(CALIBRATION_PREFIXES[autopilot]):
            seen[entry.name] = entry.t
    return bool(seen) and bool(np.min(list(seen.values())) >= last_sample)
