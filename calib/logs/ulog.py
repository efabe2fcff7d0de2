"""Reads PX4's logs (.ulg) as recordings, with pyulog."""

from __future__ import annotations

import struct
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, BinaryIO, Final

import numpy as np
import pyulog.core
from pyulog.core import ULog
from pyulog.exceptions import ULogException, ULogIncompatibleFlagException

from mavcal.calib.errors import UnreadableError
from mavcal.calib.firmware.px4.flight import arming_events, dynamics_channels, flight_channels, truth_channels
from mavcal.calib.firmware.px4.topics import US, WANTED, Topic, inertial_channels
from mavcal.calib.logs.damaged import in_order, moving, without_zeros
from mavcal.calib.recording import Channel, Event, Identity, ParameterEntry, ParameterTimeline, Recording

MAGIC: Final = b"ULog\x01\x12\x35"
ENCRYPTED: Final = b"ULogEnc"
MOST_FIELDS: Final = 4096
MOST_DEPTH: Final = 6
"""Most fields of one topic, and deepest nesting of formats; beyond these a definition is damaged."""
LONGEST_S: Final = 30 * 86400.0
"""Longest time, s, from the first time stamp; later ones are damaged."""
RELEASE_SHIFTS: Final = (24, 16, 8)
"""Major, minor and patch in ``ver_sw_release``; the lowest byte is the kind of release."""

READS_A_BYTE: Final = 2, 10_000
TAKEN_A_BYTE: Final = 256, 1 << 32
"""Most reads, and bytes read, by the parser: for each byte of a file, and for any file. It reads twice for each
message. It skips unreadable data byte by byte, each time reading the length that it finds there."""

pyulog.core.print = lambda *_args, **_more: None  # it reports damage on stdout, which is the answer's


class _Bounded(ULog):  # type: ignore[misc]
    """pyulog's parser, protected against formats that contain themselves or expand without end."""

    class _MessageAddLogged(ULog._MessageAddLogged):  # type: ignore[misc]
        def _parse_nested_type(self, prefix_str: str, type_name: str, message_formats: Any) -> None:
            if prefix_str.count(".") > MOST_DEPTH or len(self.field_data) > MOST_FIELDS:
                raise ValueError(f"format {type_name} unfolds without end")
            count = sum(max(size, 1) for _, size, _ in message_formats[type_name].fields)
            if len(self.field_data) + count > MOST_FIELDS:
                raise ValueError(f"format {type_name} has more than {MOST_FIELDS} fields")
            super()._parse_nested_type(prefix_str, type_name, message_formats)


class _Metered:
    """A file that stops a reader caught in a loop.

    The length field of a damaged message can lead pyulog back to the same place for ever.
    """

    def __init__(self, opened: BinaryIO, size: int) -> None:
        self._opened = opened
        self._reads = READS_A_BYTE[0] * size + READS_A_BYTE[1]
        self._taken = TAKEN_A_BYTE[0] * size + TAKEN_A_BYTE[1]
        self.tell, self.close = opened.tell, opened.close

    def seek(self, offset: int, whence: int = 0) -> int:
        return self._opened.seek(offset, whence)

    def read(self, size: int = -1) -> bytes:
        self._reads -= 1
        data = self._opened.read(size)
        self._taken -= len(data)
        if self._reads < 0 or self._taken < 0:
            raise ULogException("the lengths of its messages lead in circles")
        return data


def read_ulog(path: Path | str) -> Recording:
    """Read a PX4 log as a recording; every topic at its own rate and stage (:mod:`calib.firmware.px4.topics`).

    Returns
    -------
    Recording
        Times are seconds since boot. The parameters are those of the header with their changes; `end_observed` is True
        unless the log lost data, and possibly a change with it. Damage, drops, clipping and what was left out are
        events.

    Raises
    ------
    UnreadableError
        If the file cannot be opened, is encrypted, is no ULog, or holds no topic that says anything of a sensor.
    """
    file = Path(path)
    log = _parsed(file, WANTED)
    topics = {(d.name, int(d.multi_id)): d.data for d in log.data_list if len(d.data.get("timestamp", ()))}
    start = log.start_timestamp * US
    timeline = _parameters(log, start)
    identity = _identity(log, topics, timeline.final())
    with np.errstate(invalid="ignore"):  # damaged bytes may be a signalling NaN
        inertial, events = inertial_channels(topics, timeline.final())
        kept = _ordered((*inertial, *flight_channels(topics, identity.vehicle_type)), start, events)
        truth = _ordered(truth_channels(topics), start, events)
        dynamics = _ordered(dynamics_channels(topics), start, events)
    if not kept:
        raise UnreadableError(f"{file.name} is a ULog without a sensor, attitude or position: nothing to read")
    return Recording(
        channels=kept,
        parameters=timeline,
        events=tuple(sorted((*events, *_text_events(log, start), *arming_events(topics)), key=lambda e: e.t)),
        identity=identity,
        source=file.name,
        reference=truth,
        dynamics=dynamics,
    )


def _ordered(channels: Iterable[Channel], start: float, events: list[Event]) -> tuple[Channel, ...]:
    """Channels in order of time; `events` gets how many samples were left out, and why."""
    kept = []
    for channel in channels:
        ordered, late = in_order(channel, start + LONGEST_S)
        if late:
            text = f"{late} of {len(channel)} samples of {channel.source} carry damaged times and were left out"
            events.append(Event(start, "damage", text))
        going = moving(ordered.t)
        if not going.all():
            stood = int((~going).sum())
            text = (
                f"{stood} of {len(channel)} samples of {channel.source} carry one time all over: the clock stood still"
            )
            events.append(Event(start, "damage", f"{text}; left out"))
            ordered = ordered.take(going)
        if len(ordered):
            kept.append(without_zeros(ordered, events))
    return tuple(kept)


def parse_ulog(file: Path, names: Iterable[str]) -> dict[str, Topic]:
    """The first instance of each of these topics that the log holds, in the order of time. Raises UnreadableError."""
    found: dict[str, Topic] = {}
    for one in _parsed(file, names).data_list:
        stamps = one.data.get("timestamp", ())
        if len(stamps) and not one.multi_id:
            order = np.argsort(stamps, kind="stable")
            found[one.name] = {name: values[order] for name, values in one.data.items()}
    return found


def _parsed(file: Path, names: Iterable[str]) -> ULog:
    try:
        with file.open("rb") as opened:
            head = opened.read(16)
            if head.startswith(ENCRYPTED):
                raise UnreadableError(f"{file.name} is an encrypted ULog: decrypt it with PX4's decrypt_ulog.py first")
            if len(head) < 16 or not head.startswith(MAGIC):
                raise UnreadableError(f"{file.name} is no ULog: its header is {head[:8]!r}")
            size = opened.seek(0, 2)
            opened.seek(0)
            return _Bounded(_Metered(opened, size), sorted(names))
    except UnreadableError:
        raise
    except OSError as error:
        raise UnreadableError(f"{file.name} cannot be read: {error.strerror or error}") from error
    except ULogIncompatibleFlagException as error:
        raise UnreadableError(f"{file.name} is a ULog of a later format than pyulog knows: {error}") from error
    except (ULogException, ValueError, IndexError, KeyError, OverflowError, TypeError, struct.error) as error:
        raise UnreadableError(f"{file.name} is a damaged ULog: {error}") from error


def _parameters(log: ULog, start: float) -> ParameterTimeline:
    """Header values, then the changes in their order."""
    first = [ParameterEntry(start, name, value) for name, value in log.initial_parameters.items() if _is_value(value)]
    later = [
        ParameterEntry(max(stamp * US, start), name, value)
        for stamp, name, value in log.changed_parameters
        if _is_value(value)
    ]
    whole = bool(first) and not log.file_corruption and not log.dropouts
    return ParameterTimeline((*first, *sorted(later, key=lambda entry: entry.t)), end_observed=whole)


def _is_value(value: Any) -> bool:
    return isinstance(value, (int, float))


def _text_events(log: ULog, start: float) -> list[Event]:
    """Texts, drops and damage."""
    events = [Event(m.timestamp * US, "text", _printable(m.message)) for m in log.logged_messages]
    events += [
        Event(d.timestamp * US, "drop", f"the logger dropped {d.duration} ms: the card was too slow")
        for d in log.dropouts
    ]
    if log.file_corruption:
        events.append(Event(start, "damage", "the ULog is damaged: what could not be parsed was stepped over"))
    return [event for event in events if 0.0 <= event.t <= start + LONGEST_S]


def _printable(text: str) -> str:
    return "".join(c if c.isprintable() else " " for c in text).strip()


def _identity(log: ULog, topics: Any, parameters: Mapping[str, float]) -> Identity:
    info = log.msg_info_dict
    release, uid = info.get("ver_sw_release"), info.get("sys_uuid")
    firmware = None
    if isinstance(release, int) and release > 0:
        major, minor, patch = ((release >> shift) & 0xFF for shift in RELEASE_SHIFTS)
        firmware = (major, minor, patch)
    status = topics.get(("vehicle_status", 0), {})
    system = int(np.median(status["system_id"])) if "system_id" in status else None
    kind = int(np.median(status["system_type"])) if "system_type" in status else 0  # a MAV_TYPE; 0 is generic
    return Identity(
        autopilot="px4",
        vehicle_type=kind or int(parameters.get("MAV_TYPE", 0)) or None,
        firmware=firmware,
        uid=uid.lower() if isinstance(uid, str) and uid else None,
        system=system,
    )
