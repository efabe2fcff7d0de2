"""PX4's parameter protocol: integers copied bit by bit, an immediate echo, unsaved values repeated, and its faults."""

from __future__ import annotations

import math
import random
import struct
from collections.abc import Callable

from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.service.simvehicle.parameters import ParameterTable, ParameterType, SimParameter, Value, int32_bytes
from mavcal.service.simvehicle.px4_parameters import PRIORITIES, UNINITIALISED, is_volatile
from mavcal.service.simvehicle.vehicle import ANSWER_ROOM, FlightController, MavlinkChannel
from mavcal.service.simvehicle.wire import Received

NO_INDEX = 65535
HASH_NAME = "_HASH_CHECK"
LIST_DELAY_S, LIST_TICK_S, LIST_PER_TICK = 0.012, 0.02, 20
FLT_EPSILON = 1.1920929e-07  # a float that moves by less counts as unchanged: stored, but nobody is told
SAVE_DELAY_S, SAVE_INTERVAL_S = 0.3, 2.0
REPEAT_SOON_S, REPEAT_LATE_S, REPEAT_SOON_CHANCE = (0.006, 0.025), (0.025, 0.4), 0.6


class Px4Parameters:
    """Answers the parameter protocol; keeps what is not yet saved."""

    def __init__(self, vehicle: FlightController, updated: Callable[[], None]) -> None:
        self._vehicle, self._updated = vehicle, updated
        self._random = random.Random(vehicle.config.seed)  # noqa: S311 - reproducible, no secret
        self._unsaved: set[str] = set()
        self._lists: dict[int, tuple[MavlinkChannel, int]] = {}
        self._last_save = -math.inf
        self._save_due = self._repeat_due = False
        self.frozen = False
        self.last_change = -math.inf

    @property
    def _table(self) -> ParameterTable:
        return self._vehicle.table

    def boot(self) -> None:
        """Reset to the stored values."""
        self._unsaved.clear()
        self._lists.clear()
        self._last_save = -math.inf
        self._save_due = self._repeat_due = self.frozen = False
        self.last_change = 0.0

    def handle(self, channel: MavlinkChannel, received: Received) -> None:
        """One message of the parameter protocol; answered even by a frozen vehicle."""
        message = received.message
        if received.name == "PARAM_REQUEST_LIST":
            self._start_list(channel)
        elif received.name == "PARAM_REQUEST_READ":
            self._read(channel, str(message.param_id), int(message.param_index))
        elif received.name == "PARAM_SET":
            self._set(channel, str(message.param_id), received.payload[:4], int(message.param_type))

    # --- messages

    def _send(self, channel: MavlinkChannel, parameter: SimParameter) -> None:
        self._send_raw(channel, parameter.name, int32_bytes(parameter), int(parameter.kind))

    def _send_raw(self, channel: MavlinkChannel, name: str, value: bytes, kind: int) -> None:
        vehicle = self._vehicle
        if not vehicle.alive or vehicle.mute:
            return
        index = self._table.index_of(name)
        count = len(self._table.listing())
        tail = struct.pack("<HH16sB", count, NO_INDEX if index is None else index, name.encode(), kind)
        channel.transmit(channel.packer.pack_payload(dialect.MAVLink_param_value_message, value + tail))

    def _send_hash(self, channel: MavlinkChannel) -> None:
        crc = self._table.hash(is_volatile)
        self._send_raw(channel, HASH_NAME, struct.pack("<I", crc), ParameterType.UINT32)

    # --- list and read

    def _start_list(self, channel: MavlinkChannel) -> None:
        key = id(channel)
        running = key in self._lists
        # −1: the hash goes first; a list asked for during a list begins again without it.
        self._lists[key] = (channel, 0 if running else -1)
        if not running:
            self._vehicle.at(LIST_DELAY_S, lambda: self._continue_list(key))

    def _continue_list(self, key: int) -> None:
        if key not in self._lists:
            return
        channel, done = self._lists[key]
        if done < 0:
            self._send_hash(channel)
            done = 0
        listing = self._table.listing()
        end = min(done + LIST_PER_TICK, len(listing))
        while done < end and channel.room() >= ANSWER_ROOM:
            self._send(channel, listing[done])
            done += 1
        if done >= len(listing):
            del self._lists[key]
            return
        self._lists[key] = (channel, done)
        self._vehicle.at(LIST_TICK_S, lambda: self._continue_list(key))

    def _read(self, channel: MavlinkChannel, name: str, index: int) -> None:
        listing = self._table.listing()
        if index >= 0:
            if index < len(listing):
                self._send(channel, listing[index])
        elif name == HASH_NAME:
            self._send_hash(channel)
        elif name in self._table:
            self._send(channel, self._table[name])

    # --- set

    def _set(self, channel: MavlinkChannel, name: str, raw: bytes, kind: int) -> None:
        shown = struct.unpack("<i" if kind == ParameterType.INT32 else "<f", raw)[0]
        self._vehicle.note_set(name, float(shown))
        if name not in self._table or kind != self._table[name].kind or not self._vehicle.alive:
            return
        value: Value = struct.unpack("<f" if self._table[name].is_float else "<i", raw)[0]
        changed = self._store(name, value)
        self._vehicle.echo_filter(name, lambda: self._send(channel, self._table[name]))
        if changed:
            self.notify()

    def _store(self, name: str, value: Value) -> bool:
        """Store a value; True if the firmware counts that as a change (NaN never does)."""
        before = self._table[name].value
        parameter = self._table.store(name, value)
        self._unsaved.add(name)
        if parameter.is_float:
            return abs(float(parameter.value) - float(before)) > FLT_EPSILON
        return parameter.value != before

    def write(self, values: dict[str, Value]) -> None:
        """Change parameters on the firmware's behalf; the next repetition broadcasts them."""
        for name, value in values.items():
            self._store(name, value)
        self.notify()

    def notify(self) -> None:
        """Publish parameter_update: sensors reload, unsaved values are repeated, a save becomes due."""
        self.last_change = self._vehicle.time
        self._updated()
        self._repair_priorities()
        if self.frozen:
            return
        if not self._repeat_due:
            self._repeat_due = True
            soon = self._random.random() < REPEAT_SOON_CHANCE
            self._vehicle.at(self._random.uniform(*(REPEAT_SOON_S if soon else REPEAT_LATE_S)), self._repeat)
        if not self._save_due:
            self._save_due = True
            wait = max(SAVE_DELAY_S, self._last_save + SAVE_INTERVAL_S - self._vehicle.time)
            self._vehicle.at(wait, self._autosave)

    def _repair_priorities(self) -> None:
        """Set invalid priorities to "uninitialised"."""
        for parameter in self._table:
            name = parameter.name
            if name.startswith("CAL_") and name.endswith("_PRIO") and parameter.value not in PRIORITIES:
                self._store(name, UNINITIALISED)

    def _repeat(self) -> None:
        self._repeat_due = False
        if self.frozen:
            return
        for parameter in self._table.listing():
            if parameter.name in self._unsaved:
                for channel in self._vehicle.channels:
                    self._send(channel, parameter)

    def _autosave(self) -> None:
        self._save_due = False
        if self._vehicle.armed and not self._vehicle.config.sitl:
            # Flash-based boards wait until disarmed.
            self._save_due = True
            self._vehicle.at(SAVE_INTERVAL_S, self._autosave)
            return
        self.save()

    def save(self) -> None:
        """Write everything unsaved to storage. One non-finite value breaks the save, and freezes the vehicle."""
        self._last_save = self._vehicle.time
        if any(not math.isfinite(p.value) for p in self._table):
            self.frozen = True
            return
        for name in self._unsaved:
            self._table.save(name, None if self._exported(name) else self._table[name].default)
        self._unsaved.clear()

    def _exported(self, name: str) -> bool:
        """A float is left out of the file while it lies within FLT_EPSILON of its default (parameters.cpp)."""
        parameter = self._table[name]
        return not parameter.is_float or abs(float(parameter.value) - float(parameter.default)) > FLT_EPSILON

    def load(self) -> None:
        """Take every value back from storage, in silence."""
        self._table.restore_saved()
        self._unsaved.clear()
        self._updated()
