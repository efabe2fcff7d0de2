"""Frames of one vehicle to recordings, chunk by chunk: live from a link, or from a file."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray
from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.calib.errors import FirmwareError
from mavcal.calib.firmware.names import ARDUPILOT_COMPASS_SLOTS, Role, ardupilot_compass_names
from mavcal.calib.firmware.stream import auxiliary
from mavcal.calib.firmware.stream.announcements import Announcements
from mavcal.calib.firmware.stream.clock import VehicleClock
from mavcal.calib.firmware.stream.messages import INERTIAL
from mavcal.calib.firmware.stream.payload import gather
from mavcal.calib.firmware.stream.samples import MessageSamples
from mavcal.calib.recording import Event, Identity, ParameterEntry, ParameterTimeline, Recording
from mavcal.calib.wire import heard_value, usual_encoding

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from mavcal.calib.firmware.plan import Value
    from mavcal.calib.wire import Frame

Array = NDArray[np.float64]

PARAM_VALUE: Final = dialect.MAVLINK_MSG_ID_PARAM_VALUE
GAP_S: Final = 1.0
"""An inertial stream that pauses so long gets a "gap" event."""

CLOCK_IDS: Final = frozenset(
    {
        *INERTIAL["ardupilot"],
        dialect.MAVLINK_MSG_ID_ATTITUDE,
        dialect.MAVLINK_MSG_ID_ATTITUDE_QUATERNION,
        dialect.MAVLINK_MSG_ID_GLOBAL_POSITION_INT,
        dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED,
        dialect.MAVLINK_MSG_ID_SYSTEM_TIME,
        dialect.MAVLINK_MSG_ID_SCALED_PRESSURE,
    }
)
"""Messages whose time stamp is the vehicle's time since boot."""


class Assembler:
    """Understands the messages of one ArduPilot or PX4 vehicle.

    Feed it the frames of a link or file in their order of arrival; frames of other senders are ignored. Every chunk
    carries what came: channels at the firmware's stage, parameter values, events, the identity known by then. Cutting
    the frames into other batches changes nothing in the joined result.

    Parameters
    ----------
    identity
        Whose frames they are: `autopilot` must be known, `system` and `component` select the sender (None: any).
    parameters
        Values known beforehand; they only tell which compass HIGHRES_IMU shows.

    Raises
    ------
    FirmwareError
        If the autopilot is neither ArduPilot nor PX4.
    """

    def __init__(self, identity: Identity, parameters: Mapping[str, Value] | None = None) -> None:
        if identity.autopilot is None or identity.autopilot not in INERTIAL:
            raise FirmwareError(
                f"mavcal understands the streams of ArduPilot and PX4, not of autopilot {identity.autopilot!r}"
            )
        self._autopilot = identity.autopilot
        self._announcements = Announcements(identity)
        self._clock = VehicleClock()
        self._inertial = {key: MessageSamples(message) for key, message in INERTIAL[self._autopilot].items()}
        self._auxiliary = auxiliary.Auxiliary()
        self._compass_use = {name: (parameters or {}).get(name) for name in _COMPASS_USE}
        self._sender = identity.system, identity.component
        self._wanted = frozenset(
            CLOCK_IDS | self._announcements.message_ids | self._auxiliary.message_ids | {PARAM_VALUE}
        )

    @property
    def identity(self) -> Identity:
        """What is known of the vehicle by now."""
        return self._announcements.identity

    @property
    def message_ids(self) -> frozenset[int]:
        """The messages that it reads; others may be left out before."""
        return self._wanted

    def feed(self, frames: Iterable[tuple[int | None, Frame]]) -> Recording:
        """The recording that these frames make; its times continue those of the chunks before."""
        groups = self._sorted_out(frames)
        rows = {key: gather([frame for _, frame in found], key) for key, found in groups.items() if key in _GATHERED}
        order = {key: np.array([i for i, _ in found]) for key, found in groups.items()}
        times = self._read_clock(rows, order)
        entries: list[ParameterEntry] = []
        if PARAM_VALUE in groups:
            entries = self._parameters(times.arrival(order[PARAM_VALUE]), groups[PARAM_VALUE])
        events, channels = times.reboots, []
        for key, table in rows.items():
            if key in self._inertial:
                events += self._gaps(key, times.stamped[key])
                channels += self._inertial[key].feed(times.stamped[key], table, self._compass(key))
            elif key in self._auxiliary.message_ids:
                stamps = times.stamped[key] if key in CLOCK_IDS else times.arrival(order[key])
                channels += self._auxiliary.feed(key, stamps, table)
        spoken = sorted(((i, frame) for key in self._announcements.message_ids for i, frame in groups.get(key, ())))
        arrived = times.arrival(np.array([i for i, _ in spoken], dtype=np.intp))
        for t, (_, frame) in zip(arrived.tolist(), spoken, strict=True):
            events += self._announcements.feed(max(0.0, t), frame)
        events.sort(key=lambda event: event.t)
        return Recording(tuple(channels), ParameterTimeline(tuple(entries)), tuple(events), identity=self.identity)

    def _sorted_out(self, frames: Iterable[tuple[int | None, Frame]]) -> dict[int, list[tuple[int, Frame]]]:
        system, component = self._sender
        groups: dict[int, list[tuple[int, Frame]]] = {}
        for i, (_, frame) in enumerate(frames):
            if (
                frame.message_id in self._wanted
                and (system is None or frame.system == system)
                and (component is None or frame.component == component)
            ):
                groups.setdefault(frame.message_id, []).append((i, frame))
        return groups

    def _read_clock(self, rows: Mapping[int, NDArray[Any]], order: Mapping[int, NDArray[np.intp]]) -> _Times:
        keys = [key for key in rows if key in CLOCK_IDS]
        if not keys:
            nothing = np.empty(0)
            return _Times({}, np.empty(0, dtype=np.intp), nothing, self._clock.now, [])
        before = self._clock.now
        raw = np.concatenate([self._stamps(rows[key]) for key in keys])
        where = np.concatenate([order[key] for key in keys])
        sorting = np.argsort(where)
        in_order, reboots = self._clock.read(raw[sorting])
        unsorted = np.empty_like(in_order)
        unsorted[sorting] = in_order
        ends = np.cumsum([len(rows[key]) for key in keys])
        events = [Event(float(in_order[i]), "reboot", "the vehicle's clock started again") for i in reboots]
        newest = np.maximum(np.maximum.accumulate(in_order), -np.inf if before is None else before)
        stamped = dict(zip(keys, np.split(unsorted, ends[:-1]), strict=True))
        return _Times(stamped, where[sorting], newest, before, events)

    def _stamps(self, rows: NDArray[Any]) -> Array:
        if "time_boot_ms" in (rows.dtype.names or ()):
            return self._clock.unwrap_ms(rows["time_boot_ms"])
        return np.asarray(rows["time_usec"].astype(np.float64) * 1e-6)

    def _gaps(self, key: int, t: Array) -> list[Event]:
        newest = self._inertial[key].newest
        reached = np.maximum.accumulate(np.concatenate(([newest if np.isfinite(newest) else t[0]], t)))
        pauses = np.diff(reached)
        name = self._inertial[key].message.name
        return [
            Event(float(reached[i + 1]), "gap", f"{name} paused for {pauses[i]:.1f} s")
            for i in np.flatnonzero(pauses > GAP_S)
        ]

    def _compass(self, key: int) -> int:
        """Instance of the compass in a message; HIGHRES_IMU shows the first one in use."""
        message = self._inertial[key].message
        if not message.by_id:
            return message.instance
        used = [rank for rank, name in enumerate(_COMPASS_USE) if self._compass_use[name] != 0]
        return used[0] if used else message.instance

    def _parameters(self, t: Array, found: Sequence[tuple[int, Frame]]) -> list[ParameterEntry]:
        entries = []
        encoding = usual_encoding(self._autopilot)
        for time, (_, frame) in zip(t.tolist(), found, strict=True):
            heard = heard_value(frame, encoding)
            if heard is None or heard.kind is None:
                continue
            entries.append(ParameterEntry(time, heard.name, heard.value))
            if heard.name in self._compass_use:
                self._compass_use[heard.name] = heard.value
        return entries


@dataclass(frozen=True, eq=False)
class _Times:
    """Vehicle times of one batch of frames."""

    stamped: Mapping[int, Array]
    positions: NDArray[np.intp]
    newest: Array
    before: float | None
    reboots: list[Event]

    def arrival(self, positions: NDArray[np.intp]) -> Array:
        """Newest time that was known when the frames at `positions` arrived; -inf before any."""
        known = np.concatenate(([-np.inf if self.before is None else self.before], self.newest))
        return np.asarray(known[np.searchsorted(self.positions, positions)])


_COMPASS_USE: Final = tuple(ardupilot_compass_names(rank, rank)[Role.USE] for rank in range(ARDUPILOT_COMPASS_SLOTS))
_GATHERED: Final = CLOCK_IDS | auxiliary.Auxiliary.message_ids
