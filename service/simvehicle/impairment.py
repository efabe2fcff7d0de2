"""A link that loses, doubles, delays, swaps, cuts and corrupts frames, with chances for each direction."""

from __future__ import annotations

import heapq
import itertools
import math
import random
import socket
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass

from mavcal.service.simvehicle.links import SimEndpoint
from mavcal.service.simvehicle.vehicle import MavlinkChannel
from mavcal.service.simvehicle.wire import Received

PORT_BUFFER = 512.0  # bytes that wait in the vehicle's port: streams and parameter lists are held back at its brim
MOST_BEYOND = 4096  # bytes over that; then even a heartbeat is lost
REORDER_DELAY_S = 0.05  # how long a swapped frame is held back, wall time


@dataclass(frozen=True)
class Impairment:
    """Chances per frame, 0..1, delays in wall seconds, and capacity in bytes per wall second (0: unlimited)."""

    loss: float = 0.0
    duplication: float = 0.0
    reordering: float = 0.0
    bit_errors: float = 0.0
    truncation: float = 0.0
    delay_s: float = 0.0
    jitter_s: float = 0.0
    bytes_per_s: float = 0.0
    buffer_bytes: float = PORT_BUFFER

    @property
    def clean(self) -> bool:
        """Whether no impairment is set."""
        return self == CLEAN


CLEAN = Impairment()


class FaultyLink:
    """A link seen through its impairments.

    `channel` is the vehicle's end; `cut`: nothing passes; `spoilt` counts the frames hit, by kind.
    """

    def __init__(self, link: SimEndpoint, seed: int) -> None:
        self._link = link
        self._random = random.Random(seed)  # noqa: S311 - reproducible faults, no secrets
        self._held_out: list[tuple[float, int, bytes]] = []
        self._held_in: list[tuple[float, int, bytes]] = []
        self._tickets = itertools.count()
        self.spoilt: Counter[str] = Counter()
        self.incoming, self.outgoing = CLEAN, CLEAN
        self.cut = False
        self.channel: MavlinkChannel | None = None
        self.url = link.url
        self._free_out = self._free_in = 0.0  # when the wire has carried what it was given, monotonic

    def set_impairments(self, incoming: Impairment, outgoing: Impairment) -> None:
        """Set the impairments of what passes from now on."""
        self.incoming, self.outgoing = incoming, outgoing

    def sockets(self) -> list[socket.socket | int]:
        """Sockets on which to wait for frames."""
        return self._link.sockets()

    def send(self, frame: bytes) -> None:
        """Send one frame with its impairments: cut, late or twice."""
        if self.cut:
            return
        if self.outgoing.clean and not self._held_out:
            self._link.send(frame)
            return
        carried = self.outgoing.bytes_per_s
        if carried and self.room() < -MOST_BEYOND:
            self.spoilt["throttle"] += 1
            return
        wait = 0.0
        if carried:
            now = time.monotonic()
            self._free_out = max(self._free_out, now) + len(frame) / carried
            wait = self._free_out - now
        for late, piece in self._spoilt(self.outgoing, frame):
            delay = late + wait
            if delay <= 0:
                self._link.send(piece)
            else:
                heapq.heappush(self._held_out, (time.monotonic() + delay, next(self._tickets), piece))

    def room(self) -> float:
        """Bytes that the port takes now."""
        carried = self.outgoing.bytes_per_s
        waiting = max(self._free_out - time.monotonic(), 0.0) * carried
        return self.outgoing.buffer_bytes - waiting if carried else math.inf

    def carried(self) -> float:
        """Bytes that the port carries in a second of the wall clock."""
        return self.outgoing.bytes_per_s or math.inf

    @property
    def holding(self) -> bool:
        """Whether a received frame is held back."""
        return bool(self._held_in)

    def received(self) -> Iterator[Received]:
        """The intact messages that have arrived and were not lost."""
        for data in self._link.poll():
            if self.cut:
                continue
            if self.incoming.clean:
                yield from self._link.messages(data)
                continue
            wait = 0.0
            if carried := self.incoming.bytes_per_s:
                now = time.monotonic()
                self._free_in = max(self._free_in, now) + len(data) / carried
                wait = self._free_in - now
            for late, piece in self._spoilt(self.incoming, data):
                delay = late + wait
                heapq.heappush(self._held_in, (time.monotonic() + delay, next(self._tickets), piece))
        now = time.monotonic()
        while self._held_in and self._held_in[0][0] <= now:
            yield from self._link.messages(heapq.heappop(self._held_in)[2])

    def flush(self) -> None:
        """Send frames whose delay is over."""
        if not self._held_out:
            return
        now = time.monotonic()
        while self._held_out and self._held_out[0][0] <= now:
            self._link.send(heapq.heappop(self._held_out)[2])

    def _spoilt(self, chances: Impairment, data: bytes) -> Iterator[tuple[float, bytes]]:
        if self._hit("loss", chances.loss):
            return
        for _ in range(2 if self._hit("duplication", chances.duplication) else 1):
            piece = bytearray(data)
            if self._hit("bit_errors", chances.bit_errors):
                position = self._random.randrange(len(piece) * 8)
                piece[position // 8] ^= 1 << position % 8
            if self._hit("truncation", chances.truncation):
                del piece[self._random.randrange(len(piece)) :]
            delay = chances.delay_s + chances.jitter_s * self._random.random()
            self.spoilt["delay"] += delay > 0
            if self._hit("reordering", chances.reordering):
                delay += REORDER_DELAY_S
            if piece:
                yield delay, bytes(piece)

    def _hit(self, kind: str, chance: float) -> bool:
        hit = self._random.random() < chance
        self.spoilt[kind] += hit
        return hit

    def vehicle_rebooted(self) -> None:
        """See SimEndpoint."""
        self._link.vehicle_rebooted()

    def move(self) -> None:
        """See SimEndpoint."""
        self._link.move()

    def disconnect(self) -> None:
        """See SimEndpoint."""
        self._link.disconnect()

    def close(self) -> None:
        """Release the sockets."""
        self._link.close()
