"""Makes recordings of the frames of one vehicle, chunk by chunk, from a link or a file.

The vehicle's clock from time stamps that wrap, arrive late, or restart after a reboot.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cache
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray
from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.calib.errors import FirmwareError, InvalidInputError
from mavcal.calib.firmware.names import ARDUPILOT_COMPASS_SLOTS, Role, ardupilot_compass_names
from mavcal.calib.firmware.stream import auxiliary
from mavcal.calib.firmware.stream.announcements import Announcements
from mavcal.calib.firmware.stream.messages import HIGHRES_IMU, INERTIAL, InertialMessage, MessageSensor
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
)
from mavcal.calib.wire.parameters import heard_value, usual_encoding

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from mavcal.calib.firmware.plan import Value
    from mavcal.calib.wire.frames import Frame


WRAP_S: Final = 2.0**32 / 1000.0
"""A millisecond counter of 32 bits starts again after 49.7 days."""
WRAP_WINDOW_S: Final = 60.0
BACKWARD_S: Final = 1.0
"""A stamp this much older than the newest one is late, or the clock has started again."""
CONFIRMATIONS: Final = 3
"""Old stamps in a row that mean a reboot; fewer are frames that were held up on their way."""
REBOOT_GAP_S: Final = 0.5
"""Seconds between the last time before a reboot and the first one after it; the true ones are not known."""
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
_NUMPY_CODES: Final = {
    "char": "S1",
    "int8_t": "i1",
    "uint8_t": "u1",
    "uint8_t_mavlink_version": "u1",
    "int16_t": "<i2",
    "uint16_t": "<u2",
    "int32_t": "<i4",
    "uint32_t": "<u4",
    "int64_t": "<i8",
    "uint64_t": "<u8",
    "float": "<f4",
    "double": "<f8",
}
Mask = NDArray[np.bool_]
DEFECT_GAUSS: Final = 10.0
"""No field is that strong; ArduPilot before PR #32286 sends HIGHRES_IMU's in mGauss times 1000."""
DEFECT_FACTOR: Final = 1e-6
REPEAT_PERIODS: Final = 1.25
"""An unchanged field counts as a new reading after so many read periods. Fewer would take repeats for samples where
reads and sends jitter. More would lose samples of a sensor that is quieter than its quantum."""


class VehicleClock:
    """Turns raw time stamps, in the order of arrival, into seconds that never run backward over a reboot.

    A late frame keeps its (older) time. The outcome does not depend on how the stamps are cut into batches.
    """

    def __init__(self) -> None:
        self._newest: float | None = None
        self._offset = 0.0
        self._suspects = 0

    @property
    def now(self) -> float | None:
        """Newest time; None before the first stamp."""
        return None if self._newest is None else self._newest + self._offset

    def unwrap_ms(self, milliseconds: NDArray[np.unsignedinteger]) -> Array:
        """Seconds of ``time_boot_ms`` stamps, whole turns of the counter put back."""
        seconds = milliseconds.astype(np.float64) / 1000.0
        if self._newest is None or self._newest < WRAP_S / 2:
            return seconds
        turned = seconds + WRAP_S * np.round((self._newest - seconds) / WRAP_S)
        return np.where(np.abs(turned - self._newest) <= WRAP_WINDOW_S, turned, seconds)

    def read(self, raw: Array) -> tuple[Array, tuple[int, ...]]:
        """Times of `raw` stamps (s since boot, in order of arrival), and the indices at which a new boot begins."""
        if not len(raw):
            return raw, ()
        newest = raw[0] if self._newest is None else self._newest
        reached = np.maximum.accumulate(np.concatenate(([newest], raw)))
        if self._suspects == 0 and (raw >= reached[:-1] - BACKWARD_S).all():
            self._newest = float(reached[-1])
            return raw + self._offset, ()
        return self._read_one_by_one(raw, float(newest))

    def _read_one_by_one(self, raw: Array, newest: float) -> tuple[Array, tuple[int, ...]]:
        times, reboots = np.empty(len(raw)), []
        for i, stamp in enumerate(raw.tolist()):
            if stamp >= newest - BACKWARD_S:
                self._suspects = 0
                newest = max(newest, stamp)
            else:
                self._suspects += 1
                if self._suspects >= CONFIRMATIONS:
                    self._offset += newest + REBOOT_GAP_S - stamp
                    newest, self._suspects = stamp, 0
                    reboots.append(i)
            times[i] = stamp + self._offset
        self._newest = newest
        return times, tuple(reboots)


@dataclass
class MessageSamples:
    """Takes the rows of one message as they come and gives channels; what it remembers makes batches seamless."""

    message: InertialMessage
    newest: float = -np.inf
    _field: NDArray[Any] | None = field(default=None, repr=False)
    _field_t: float = -np.inf

    def feed(self, t: Array, rows: NDArray[Any], compass: int) -> list[Channel]:
        """Channels of `rows` at times `t` (in order of arrival); `compass` is the instance of the field."""
        reached = np.maximum.accumulate(np.concatenate(([self.newest], t)))
        self.newest = float(reached[-1])
        new, in_order = t > reached[:-1], t >= reached[:-1]
        columns = {reading.sensor: _columns(rows, reading) for reading in self.message.readings}
        present = _present(columns)
        channels = []
        for reading in self.message.readings:
            updated = (rows["fields_updated"] & reading.bits) == reading.bits if reading.bits else True
            values = columns[reading.sensor]
            if reading.sensor == Sensor.MAG:
                keep = self._fresh(t, values, in_order & updated & present[Sensor.MAG])
                channels.append(self._channel(reading, compass, t, values, keep))
                continue
            keep = new & updated & present[reading.sensor]
            if not self.message.by_id:
                channels.append(self._channel(reading, self.message.instance, t, values, keep))
                continue
            for unit in np.unique(rows["id"][keep]).tolist():
                channels.append(self._channel(reading, unit, t, values, keep & (rows["id"] == unit)))
        return [channel for channel in channels if len(channel)]

    def _fresh(self, t: Array, fields: NDArray[Any], candidates: Mask) -> Mask:
        """Rows with a field that holds a new reading: it differs from the one before, or its time has come."""
        keep = np.zeros(len(t), dtype=bool)
        where = np.flatnonzero(candidates)
        if not len(where):
            return keep
        values, times = fields[where], t[where]
        before = np.concatenate((values[:1] if self._field is None else self._field[None], values[:-1]))
        changed = (values != before).any(axis=1)
        changed[0] |= self._field is None
        due = REPEAT_PERIODS * self.message.read_s
        last = self._field_t
        for i, (time, differs) in enumerate(zip(times.tolist(), changed.tolist(), strict=True)):
            if differs or time - last >= due:
                keep[where[i]] = True
                last = time
        self._field, self._field_t = values[-1].copy(), last
        return keep

    def _channel(self, reading: MessageSensor, instance: int, t: Array, values: NDArray[Any], keep: Mask) -> Channel:
        raw = values[keep].astype(np.float64)
        zero_bin = None
        if reading.rounding == Rounding.TOWARD_ZERO:
            zero_bin = raw == 0.0
            raw = raw + 0.5 * np.sign(raw)  # bins are (k, k + 1) for k > 0 and (-1, 1) for 0
        elif self.message.message_id == HIGHRES_IMU and reading.sensor == Sensor.MAG:
            with np.errstate(over="ignore"):
                defect = np.linalg.norm(raw, axis=1) > DEFECT_GAUSS
            raw = np.where(defect[:, None], DEFECT_FACTOR * raw, raw)
        return Channel(
            sensor=reading.sensor,
            instance=instance,
            t=t[keep],
            values=reading.factor * raw,
            unit=reading.unit,
            stage=reading.stage,
            source=self.message.name,
            quantum=reading.quantum,
            rounding=reading.rounding,
            zero_bin=zero_bin,
        )


def _present(columns: dict[Sensor, NDArray[Any]]) -> dict[Sensor, Mask]:
    """Rows with a sensor: an accelerometer never reads three zeros, a good gyroscope at rest may."""
    present: dict[Sensor, Mask] = {sensor: np.asarray(values.any(axis=1)) for sensor, values in columns.items()}
    present[Sensor.GYRO] |= present[Sensor.ACCEL]
    if Sensor.TEMPERATURE in present:
        # 0 says "none": PX4 sends 1 for a true 0 degC; ArduPilot then sends 0, and the next sample tells
        present[Sensor.TEMPERATURE] &= present[Sensor.ACCEL]
    return present


def _columns(rows: NDArray[Any], reading: MessageSensor) -> NDArray[Any]:
    columns = np.empty((len(rows), len(reading.fields)), rows.dtype[reading.fields[0]])
    for i, name in enumerate(reading.fields):
        columns[:, i] = rows[name]
    return columns


@cache
def wire_dtype(message_id: int) -> np.dtype[Any]:
    """The layout of a message's payload, extension fields included.

    Raises
    ------
    InvalidInputError
        If the dialect has no such message.
    """
    cls = dialect.mavlink_map.get(message_id)
    if cls is None:
        raise InvalidInputError(f"message id {message_id} is not in the dialect; filter by id first")
    types = dict(zip(cls.fieldnames, cls.fieldtypes, strict=True))
    fields: list[tuple[Any, ...]] = []
    for name, length in zip(cls.ordered_fieldnames, cls.array_lengths, strict=True):
        code = _NUMPY_CODES[types[name]]
        if code == "S1" and length:
            fields.append((name, f"S{length}"))
        elif length:
            fields.append((name, code, (length,)))
        else:
            fields.append((name, code))
    return np.dtype(fields)


def gather(frames: Sequence[Frame], message_id: int) -> NDArray[Any]:
    """One structured row a frame; all frames are of `message_id`. Zeros that MAVLink 2 left out are put back."""
    dtype = wire_dtype(message_id)
    size = dtype.itemsize
    return np.frombuffer(b"".join([f.payload[:size].ljust(size, b"\0") for f in frames]), dtype)


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
        """Identity of the vehicle as known by now."""
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
        format_ = usual_encoding(self._autopilot)
        for time, (_, frame) in zip(t.tolist(), found, strict=True):
            heard = heard_value(frame, format_)
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
