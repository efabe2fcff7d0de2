"""Common part of both firmwares: vehicle time, an agenda, channels with their streams, identity, arming."""

from __future__ import annotations

import hashlib
import heapq
import itertools
import math
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.service.simvehicle.config import VehicleConfig
from mavcal.service.simvehicle.errors import ConfigurationError
from mavcal.service.simvehicle.parameters import ParameterTable, SimParameter
from mavcal.service.simvehicle.rotation import Array, euler_from_quaternions
from mavcal.service.simvehicle.sensor_faults import SensorFaults
from mavcal.service.simvehicle.streams import PeriodicMessage
from mavcal.service.simvehicle.wire import Packer, Received, Signer
from mavcal.service.simvehicle.world import SimWorld

MAX_SETS_KEPT = 10_000
STREAM_ROOM = 192  # bytes that a port must take before the streams of an instant are sent: all of them, or none
ANSWER_ROOM = 128  # and before a parameter is
SLICE_S = 0.5  # the longest piece of vehicle time computed in one block


class MavlinkChannel:
    """One link of the vehicle: where frames go, and what was asked for on it."""

    def __init__(
        self,
        packer: Packer,
        transmit: Callable[[bytes], None],
        room: Callable[[], float] = lambda: math.inf,
        carried: Callable[[], float] = lambda: math.inf,
    ) -> None:
        self.packer = packer
        self.transmit = transmit
        self.room = room
        self.carried = carried  # bytes a wall second
        self.streams: dict[int, PeriodicMessage] = {}

    def send(self, message: Any) -> None:
        """Pack and send one message."""
        self.transmit(self.packer.pack(message))


class FlightController(ABC):
    """A flight controller in vehicle time. `advance` moves it; `receive` gives it a message."""

    def __init__(self, config: VehicleConfig) -> None:
        self.config = config
        self.world = SimWorld(config)
        self.faults = SensorFaults()
        self.signer = Signer(bytes.fromhex(config.signing_key))
        self.channels: list[MavlinkChannel] = []
        self.table = self.make_table()
        self.time = 0.0
        self.boots = 0
        self.armed = False
        self.alive = False  # False while rebooting
        self.silent_until = -math.inf
        self.sets: list[tuple[float, str, float]] = []
        """PARAM_SETs received: time by :attr:`elapsed`, name and value."""
        self.set_count = 0
        self.own_writes: list[tuple[float, str, float]] = []
        """Values that the vehicle stored by itself, in the form of :attr:`sets`."""
        self.on_set: Callable[[int, str], None] = lambda _count, _name: None
        self.on_reboot: Callable[[], None] = lambda: None
        self.echo_filter: Callable[[str, Callable[[], None]], None] = lambda _name, echo: echo()
        self._agenda: list[tuple[float, int, Callable[[], None]]] = []
        self._tickets = itertools.count()
        self._unix_base = config.unix_time_s or time.time()
        self._elapsed_before = 0.0

    # --- to be given by a personality

    device_ids: Mapping[str, tuple[int, ...]]
    """Ids of the chips: accel, gyro, mag."""
    flush_saves: Callable[[], None]
    """Store what waits to be saved."""
    foreign_set: Callable[[str, float], None]
    """Write a parameter as another ground station would."""
    start_onboard_calibration: Callable[[], object]
    """Begin a calibration by the vehicle itself."""
    stop_onboard_calibration: Callable[[], object]
    """Stop the calibration that the vehicle began by itself; harmless if there is none."""

    @abstractmethod
    def make_table(self) -> ParameterTable:
        """The parameters of a new vehicle."""

    @abstractmethod
    def boot(self) -> None:
        """Start the firmware at vehicle time zero."""

    @abstractmethod
    def handle(self, channel: MavlinkChannel, received: Received) -> None:
        """Answer one message that is addressed to this vehicle."""

    @abstractmethod
    def sense(self, until: float) -> None:
        """Advance all sampling tasks to a time."""

    @abstractmethod
    def emit(self, due: list[tuple[float, int, MavlinkChannel, int]], times: list[float]) -> None:
        """Send the periodic messages (time, order, channel, message id) that fall due; `times` are their instants."""

    @abstractmethod
    def heartbeat(self) -> Any:
        """The HEARTBEAT of this instant."""

    @abstractmethod
    def in_force(self) -> dict[str, Any]:
        """The calibration that the firmware's corrections really use, by parameter name."""

    @abstractmethod
    def arming_faults(self) -> list[str]:
        """Reasons against arming now; empty: none."""

    def banner(self) -> list[str]:
        """Texts sent before a parameter list."""
        return []

    def reload_calibration(self) -> None:  # noqa: B027 - ArduPilot reads its parameters at every sample
        """Take the calibration again from the parameters in force."""

    # --- parameters given from outside

    def load_parameters(self, parameters: list[SimParameter]) -> None:
        """Take the table of another vehicle, in its order, as if it had always been stored here."""
        self.table.replace_all(parameters)

    def preset_parameters(self, values: Mapping[str, float]) -> None:
        """Store values before the first boot. Raises ConfigurationError for a name that the vehicle has not."""
        for name, value in values.items():
            if name not in self.table:
                raise ConfigurationError(f"parameters: the vehicle has no {name}")
            self.table.store(name, value)
            self.table.save(name)

    # --- time

    def first_due(self, channel: MavlinkChannel, message_id: int) -> float:
        """Time at which a stream requested now may begin; a running stream continues without a gap."""
        return self.time + (0.0 if message_id in channel.streams else self.config.stream_start_s)

    def at(self, delay: float, action: Callable[[], None]) -> None:
        """Do something after `delay` seconds of vehicle time."""
        heapq.heappush(self._agenda, (self.time + delay, next(self._tickets), action))

    def every(self, period: float, action: Callable[[], None], first: float | None = None) -> None:
        """Do something again and again until the next reboot."""
        boots = self.boots

        def again() -> None:
            if self.boots == boots:
                action()
                self.at(period, again)

        self.at(period if first is None else first, again)

    def advance(self, until: float) -> None:
        """Advance vehicle time and do everything that falls due. A reboot sets the clock back: then it ends."""
        boots = self.boots
        while self.time < until and self.boots == boots:
            target = min(until, self.time + SLICE_S)
            if self._agenda and self._agenda[0][0] <= target:
                moment, _, action = heapq.heappop(self._agenda)
                self._pass(max(moment, self.time))
                action()
            else:
                self._pass(target)

    def _pass(self, until: float) -> None:
        if until <= self.time:
            return
        if self.alive:
            self.sense(until)
            due = [
                (moment, order, channel, message_id)
                for channel in self.channels
                for order, (message_id, stream) in enumerate(channel.streams.items())
                for moment in stream.due(until)
            ]
            due = [entry for entry in due if entry[2].room() >= STREAM_ROOM]
            if due and not self.mute:
                due.sort(key=lambda entry: entry[:2])
                self.emit(due, sorted({entry[0] for entry in due}))
        self.time = until

    @property
    def mute(self) -> bool:
        """Whether nothing is sent now (a fault asked for silence)."""
        return self.time < self.silent_until

    # --- talking

    def send(self, channel: MavlinkChannel, message: Any) -> None:
        """Send on one channel, unless the vehicle is rebooting or silenced."""
        if self.alive and not self.mute:
            channel.send(message)

    def broadcast(self, message: Any) -> None:
        """Send on every channel."""
        for channel in self.channels:
            self.send(channel, message)

    def say(self, text: str, severity: int = dialect.MAV_SEVERITY_INFO, channel: MavlinkChannel | None = None) -> None:
        """A STATUSTEXT, in chunks of 50 characters where it is longer."""
        raw = text.encode()
        identifier = 0 if len(raw) <= 50 else next(self._tickets) % 65535 + 1
        for sequence, start in enumerate(range(0, len(raw), 50)):
            message = dialect.MAVLink_statustext_message(severity, raw[start : start + 50], identifier, sequence)
            if channel is None:
                self.broadcast(message)
            else:
                self.send(channel, message)

    def receive(self, channel: MavlinkChannel, received: Received) -> None:
        """Take one message; what is addressed to somebody else is ignored."""
        if not self.alive or not self.signer.believes(received.frame):
            return
        message = received.message
        if getattr(message, "target_system", 0) not in (0, self.config.system_id):
            return
        if getattr(message, "target_component", 0) not in (0, 1):
            return
        self.handle(channel, received)

    def note_set(self, name: str, value: float) -> None:
        """Count a PARAM_SET, and start faults that wait for it."""
        self.sets.append((self.elapsed, name, value))
        del self.sets[:-MAX_SETS_KEPT]
        self.set_count += 1
        self.on_set(self.set_count, name)

    def note_own_write(self, name: str, value: float) -> None:
        """Remember that the vehicle stored a value by itself."""
        self.own_writes.append((self.elapsed, name, value))
        del self.own_writes[:-MAX_SETS_KEPT]

    # --- life

    def start(self) -> None:
        """Boot for the first time."""
        self.alive = True
        self.boot()

    def reboot(self, *, flush: bool = True, away_s: float | None = None) -> None:
        """Restart: links fall silent, streams are forgotten, unsaved values are lost unless flushed.

        Args:
            flush: whether pending values are saved first (a commanded reboot) or lost (a power failure).
            away_s: vehicle seconds of silence; None: the configured ones.
        """
        if flush:
            self.flush_saves()
        self.alive, self.armed = False, False
        self._agenda.clear()
        for channel in self.channels:
            channel.streams.clear()
        self.on_reboot()
        self.at(self.config.boot_s if away_s is None else away_s, self._boot_again)

    def _boot_again(self) -> None:
        elapsed = self.time
        self._elapsed_before += elapsed
        self.world.restart(elapsed)
        self.table.restore_saved()
        self.time, self.silent_until = 0.0, -math.inf
        self.boots += 1
        self._agenda.clear()
        self.alive = True
        self.boot()

    # --- identity

    @property
    def elapsed(self) -> float:
        """Vehicle seconds since the process began, reboots included."""
        return self._elapsed_before + self.time

    def unix_time_s(self) -> float:
        """UTC of this instant of vehicle time."""
        return self._unix_base + self.elapsed

    def uid2(self) -> bytes:
        """Eighteen bytes that differ from seed to seed, or zeros."""
        if not self.config.unique_id:
            return bytes(18)
        text = f"simvehicle {self.config.autopilot} {self.config.seed}"
        return hashlib.sha256(text.encode()).digest()[:18]

    def euler(self) -> Array:
        """True roll, pitch, yaw (rad) at this instant."""
        q, _ = self.world.motion.evaluate(np.array([self.time]))
        return np.asarray(euler_from_quaternions(q)[0])
