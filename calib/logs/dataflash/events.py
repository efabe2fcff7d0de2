"""Parameters, identity and events of a DataFlash log: arming, modes, errors, texts."""

from __future__ import annotations

import dataclasses
import re
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.calib.firmware.ardupilot.log_fields import ARMED_EVENT, DISARMED_EVENT
from mavcal.calib.recording import Event, Identity, Oddity, OddSamples, ParameterEntry, Sensor

if TYPE_CHECKING:
    from mavcal.calib.logs.dataflash.clock import Clock
    from mavcal.calib.logs.dataflash.tables import Log

_FIRMWARE: Final = re.compile(
    r"(?:APM:)?(?:Ardu|Antenna)?(Copter|Plane|Rover|Sub|Tracker|Blimp)\s+V(\d+)\.(\d+)(?:\.(\d+))?", re.IGNORECASE
)
_TYPES: Final = {
    "copter": dialect.MAV_TYPE_QUADROTOR,
    "plane": dialect.MAV_TYPE_FIXED_WING,
    "rover": dialect.MAV_TYPE_GROUND_ROVER,
    "sub": dialect.MAV_TYPE_SUBMARINE,
    "tracker": dialect.MAV_TYPE_ANTENNA_TRACKER,
    "blimp": dialect.MAV_TYPE_AIRSHIP,
}
_SIMULATED: Final = re.compile(r"[0-9A-Za-z]{32}")
"""A simulated vehicle prints the id of its host unchanged, and sends its first bytes."""
_CHIP: Final = re.compile(r"\b([0-9A-F]{8}) ([0-9A-F]{8}) ([0-9A-F]{8})$")
_PARAMETER: Final = re.compile(r"[A-Z][A-Z0-9_]{0,15}")
UID2_BYTES: Final = 18


def parameter_entries(log: Log, clock: Clock) -> tuple[ParameterEntry, ...]:
    """Every parameter in the order of the log: the list at the start, then later changes."""
    table = log.get("PARM")
    if table is None or "Name" not in table or "Value" not in table:
        return ()
    names, values = table.columns("Name", "Value")
    return tuple(
        ParameterEntry(t, name, value)
        for t, name, value in zip(clock.moments(table), names.tolist(), values.tolist(), strict=True)
        if _PARAMETER.fullmatch(name)
    )


def identity_of(log: Log) -> Identity:
    """Firmware, vehicle type and chip id, as far as the log has them."""
    identity = Identity(autopilot="ardupilot")
    for text in _texts(log):
        found = _FIRMWARE.search(text)
        if found and identity.firmware is None:
            kind, major, minor, patch = found.groups(default="0")
            identity = dataclasses.replace(
                identity, vehicle_type=_TYPES[kind.lower()], firmware=(int(major), int(minor), int(patch))
            )
        chip = _CHIP.search(text)
        if chip and identity.uid is None:
            identity = dataclasses.replace(identity, uid=_uid(chip.groups()))
        elif _SIMULATED.fullmatch(text) and identity.uid is None:
            identity = dataclasses.replace(identity, uid=text[:UID2_BYTES].encode("ascii").hex())
    version = log.get("VER")
    if version is not None and len(version) and all(name in version for name in ("Maj", "Min", "Pat")):
        numbers = [int(column[0]) for column in version.columns("Maj", "Min", "Pat")]
        identity = dataclasses.replace(identity, firmware=(numbers[0], numbers[1], numbers[2]))
    return identity


def spoken_events(log: Log, clock: Clock) -> list[Event]:
    """Texts, modes, errors, arming and disarming."""
    events = [Event(t, "text", text) for t, text in zip(_times(log, clock, "MSG"), _texts(log), strict=True)]
    for t, (mode,) in _rows(log, clock, "MODE", "Mode"):
        events.append(Event(t, "text", f"mode {mode}"))
    for t, (subsystem, code) in _rows(log, clock, "ERR", "Subsys", "ECode"):
        events.append(Event(t, "text", f"error of subsystem {subsystem}: code {code}"))
    armed = [(t, bool(state)) for t, (state,) in _rows(log, clock, "ARM", "ArmState")] or [
        (t, code == ARMED_EVENT)
        for t, (code,) in _rows(log, clock, "EV", "Id")
        if code in (ARMED_EVENT, DISARMED_EVENT)
    ]
    before = None
    for t, state in armed:
        if state != before:
            kind = "armed" if state else "disarmed"
            events.append(Event(t, kind, f"the vehicle was {kind}"))
        before = state
    return events


def counted_events(log: Log, clock: Clock) -> list[Event]:
    """Clipping of the accelerometers, and messages dropped by the logger, each as one event with the total."""
    events = []
    vibration = log.get("VIBE")
    if vibration is not None:
        t = clock.times(vibration)
        unit = vibration["IMU"] if "IMU" in vibration else np.zeros(len(t), dtype=np.intp)
        for number in np.unique(unit).tolist() if "Clip" in vibration else ():
            events += _clipping(t[unit == number], vibration["Clip"][unit == number], number)
        for number in range(3):
            if f"Clip{number}" in vibration:
                events += _clipping(t, vibration[f"Clip{number}"], number)
    dropped = log.get("DSF")
    if dropped is not None and "Dp" in dropped:
        total, first, _ = _increase(clock.times(dropped), dropped["Dp"])
        if total:
            events.append(Event(first, "drop", f"the vehicle could not write {total} messages of this log"))
    return events


def _clipping(t: Any, counter: Any, instance: int) -> list[Event]:
    """Event with the clipped samples of an accelerometer; nothing if the count is 0."""
    total, first, last = _increase(t, counter)
    odd = OddSamples(Oddity.CLIPPED, Sensor.ACCEL, instance, total, until=last)
    return [Event(first, "clipping", f"accelerometer {instance + 1} clipped {total} times", odd)] if total else []


def _increase(t: Any, counter: Any) -> tuple[int, float, float]:
    """Increase of a counter, and the times of its first and last rise."""
    steps = np.diff(counter.astype(np.int64), prepend=counter[:1].astype(np.int64))
    rose = np.flatnonzero(steps > 0)
    if not len(rose):
        return 0, 0.0, 0.0
    return int(steps[rose].sum()), float(t[rose[0]]), float(t[rose[-1]])


def _texts(log: Log) -> list[str]:
    table = log.get("MSG")
    return [] if table is None or "Message" not in table else [str(text) for text in table["Message"]]


def _times(log: Log, clock: Clock, name: str) -> list[float]:
    table = log.get(name)
    return [] if table is None or "Message" not in table else clock.moments(table)


def _rows(log: Log, clock: Clock, name: str, *columns: str) -> list[tuple[float, tuple[Any, ...]]]:
    table = log.get(name)
    if table is None or any(column not in table for column in columns):
        return []
    found = [column.tolist() for column in table.columns(*columns)]
    return list(zip(clock.moments(table), zip(*found, strict=True), strict=True))


def _uid(words: tuple[str, ...]) -> str:
    """Chip id in the form of AUTOPILOT_VERSION.uid2: the log prints words, the message contains their bytes."""
    return b"".join(bytes.fromhex(word)[::-1] for word in words).rstrip(b"\0").hex()
