"""ArduPilot's parameter protocol: values cast as in C, late echoes, and no answer to a request that it rejects."""

from __future__ import annotations

import math
from collections import deque
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.service.simvehicle.parameters import ParameterType, SimParameter, Value
from mavcal.service.simvehicle.vehicle import ANSWER_ROOM, FlightController, MavlinkChannel
from mavcal.service.simvehicle.wire import Received

NO_INDEX = 65535
ECHO_S = 0.004  # the IO thread's turn between a PARAM_SET and its echo
SAVE_S = 0.5  # and from there to the storage
READ_TICK_S = 0.1  # answers to PARAM_REQUEST_READ leave ten times a second
READ_QUEUE, READ_REPLIES = 20, 5
LIST_TICK_S, LIST_PER_TICK = 0.01, 20
VALUE_BYTES = 37  # a PARAM_VALUE in its frame
LIST_SHARE = 0.3  # of what the port carries: GCS_Param.cpp, queued_param_send
INTEGER_NUDGE = 0.01  # AP_Param::set_float adds this before it truncates
_INTEGER_LIMITS = {
    ParameterType.INT8: (-128, 127),
    ParameterType.INT16: (-32768, 32767),
    ParameterType.INT32: (-2147483648, 2147483647),
}


class ArduPilotParameters:
    """Answers PARAM_REQUEST_LIST, PARAM_REQUEST_READ and PARAM_SET."""

    def __init__(self, vehicle: FlightController) -> None:
        self._vehicle = vehicle
        self._reads: deque[tuple[MavlinkChannel, str, int]] = deque()
        self._lists: dict[int, tuple[MavlinkChannel, int]] = {}
        self._unsaved: set[str] = set()

    def boot(self) -> None:
        """Forget requests that a reboot has ended."""
        self._reads.clear()
        self._lists.clear()
        self._unsaved.clear()

    def handle(self, channel: MavlinkChannel, received: Received) -> None:
        """One message of the parameter protocol."""
        message = received.message
        if received.name == "PARAM_REQUEST_LIST":
            self._start_list(channel)
        elif received.name == "PARAM_REQUEST_READ":
            self._queue_read(channel, str(message.param_id), int(message.param_index))
        elif received.name == "PARAM_SET":
            self.set(str(message.param_id), float(message.param_value))

    def value_message(self, parameter: SimParameter, index: int = NO_INDEX) -> Any:
        """PARAM_VALUE with the value of any type cast to float32."""
        count = len(self._vehicle.table.listing())
        return dialect.MAVLink_param_value_message(
            parameter.name.encode(), float(parameter.value), int(parameter.kind), count, index
        )

    # --- list and read

    def _start_list(self, channel: MavlinkChannel) -> None:
        vehicle = self._vehicle
        for text in vehicle.banner():
            vehicle.say(text, channel=channel)
        running = id(channel) in self._lists
        self._lists[id(channel)] = (channel, 0)
        if not running:
            vehicle.at(self._next_tick(), lambda: self._continue_list(id(channel)))

    def _continue_list(self, key: int) -> None:
        if key not in self._lists:
            return
        channel, done = self._lists[key]
        listing = self._vehicle.table.listing()
        end = min(done + LIST_PER_TICK, len(listing))
        tick_s = max(LIST_TICK_S, VALUE_BYTES / (LIST_SHARE * channel.carried()))
        if tick_s > LIST_TICK_S:
            end = min(done + 1, len(listing))
        while done < end and channel.room() >= ANSWER_ROOM:
            self._vehicle.send(channel, self.value_message(listing[done], done))
            done += 1
        if done >= len(listing):
            del self._lists[key]
            return
        self._lists[key] = (channel, done)
        self._vehicle.at(tick_s, lambda: self._continue_list(key))

    def _queue_read(self, channel: MavlinkChannel, name: str, index: int) -> None:
        if len(self._reads) >= READ_QUEUE:
            return
        self._reads.append((channel, name, index))
        if len(self._reads) == 1:
            self._vehicle.at(self._next_tick(), self._answer_reads)

    def _next_tick(self) -> float:
        return READ_TICK_S - self._vehicle.time % READ_TICK_S

    def _answer_reads(self) -> None:
        table = self._vehicle.table
        for _ in range(min(READ_REPLIES, len(self._reads))):
            if self._reads[0][0].room() < ANSWER_ROOM:
                break
            channel, name, index = self._reads.popleft()
            listing = table.listing()
            if index >= 0:
                if index < len(listing):
                    self._vehicle.send(channel, self.value_message(listing[index], index))
            elif name in table:
                self._vehicle.send(channel, self.value_message(table[name]))
        if self._reads:
            self._vehicle.at(READ_TICK_S, self._answer_reads)

    # --- set

    def set(self, name: str, value: float) -> None:
        """Carry out a PARAM_SET: the value acts at once, the echo follows after the IO thread's next turn."""
        table = self._vehicle.table
        self._vehicle.note_set(name, value)
        if name not in table or not math.isfinite(value) or not self._vehicle.alive:
            return
        table.store(name, _converted(table[name], value))
        self.changed(name)

    def changed(self, name: str) -> None:
        """Save a value and broadcast it, after a PARAM_SET or a write by the firmware itself."""
        names = self._vehicle.table.vector_members(name) or [name]
        self._vehicle.echo_filter(name, lambda: self._vehicle.at(ECHO_S, lambda: self.announce(names)))
        self._unsaved.add(name)
        self._vehicle.at(ECHO_S + SAVE_S, lambda: self._save(name))

    def _save(self, name: str) -> None:
        self._unsaved.discard(name)
        self._vehicle.table.save(name)

    def flush(self) -> None:
        """Save at once all values waiting for the IO thread, as a commanded reboot does."""
        for name in list(self._unsaved):
            self._save(name)

    def announce(self, names: list[str]) -> None:
        """PARAM_VALUE of each name on every link."""
        for name in names:
            self._vehicle.broadcast(self.value_message(self._vehicle.table[name]))


def _converted(parameter: SimParameter, value: float) -> Value:
    if parameter.is_float:
        return value
    low, high = _INTEGER_LIMITS.get(parameter.kind, (0, 4294967295))
    nudged = value + (INTEGER_NUDGE if value > 0 else -INTEGER_NUDGE)
    return int(min(max(nudged, low), high))
