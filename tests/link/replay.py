"""Replay the requests of a recorded link against a simulated vehicle, in vehicle time, without sockets.

A recording (.tlog) is 8 bytes of big-endian microseconds and one complete MAVLink frame, again and again.
"""

from __future__ import annotations

from collections.abc import Container, Iterator
from dataclasses import dataclass
from pathlib import Path

from mavcal.service.simvehicle.errors import ConfigurationError
from mavcal.service.simvehicle.vehicle import FlightController, MavlinkChannel
from mavcal.service.simvehicle.wire import (
    MAGIC_V1,
    MAGIC_V2,
    SIGNATURE_LENGTH,
    Packer,
    Received,
    decode_frame,
    message_id_of,
    split_datagram,
)

TIMESTAMP_LENGTH = 8


@dataclass(frozen=True)
class ReplayedFrame:
    """One frame of a recording: seconds since its first frame, message id, sending system, bytes."""

    t: float
    message_id: int
    system: int
    data: bytes


@dataclass(frozen=True)
class Heard:
    """One message on the wire: seconds since the recording's first frame."""

    t: float
    received: Received


def read_frames(path: Path) -> Iterator[ReplayedFrame]:
    """Every frame of a recording. Raises ConfigurationError where something else than a frame stands."""
    data = path.read_bytes()
    position, start = 0, None
    while position + TIMESTAMP_LENGTH < len(data):
        micros = int.from_bytes(data[position : position + TIMESTAMP_LENGTH], "big")
        start = micros if start is None else start
        position += TIMESTAMP_LENGTH
        magic = data[position]
        if magic not in (MAGIC_V1, MAGIC_V2):
            raise ConfigurationError(f"{path.name}, byte {position}: no MAVLink frame begins here")
        length = data[position + 1] + (12 if magic == MAGIC_V2 else 8)
        length += SIGNATURE_LENGTH if magic == MAGIC_V2 and data[position + 2] & 1 else 0
        frame = data[position : position + length]
        system = frame[5] if magic == MAGIC_V2 else frame[3]
        yield ReplayedFrame((micros - start) * 1e-6, message_id_of(frame), system, frame)
        position += length


def heard(frames: list[ReplayedFrame], system: int, message_ids: Container[int]) -> list[Heard]:
    """The decoded messages of one system, of these ids only; frames that are not in the dialect are left out."""
    chosen = [f for f in frames if f.system == system and f.message_id in message_ids]
    return [Heard(f.t, received) for f in chosen if (received := decode_frame(f.data)) is not None]


def replay(
    vehicle: FlightController,
    frames: list[ReplayedFrame],
    station: int,
    boot_offset: float,
    step: float = 0.005,
    message_ids: Container[int] | None = None,
) -> list[Heard]:
    """Give a vehicle the requests of one system at their recorded times; what it says, in the recording's time.

    Args:
        vehicle: not yet started; one channel is added to it.
        frames: the recording.
        station: system id of the ground station in it.
        boot_offset: vehicle time at the recording's first frame, s.
        step: what a time of the answer may be late by, s.
        message_ids: what to decode of the answers; None: everything.
    """
    said: list[tuple[float, bytes]] = []
    clock = _Clock(vehicle, boot_offset)
    vehicle.channels.append(MavlinkChannel(Packer(vehicle.config.system_id), lambda f: said.append((clock.now, f))))
    vehicle.start()
    clock.run_to(0.0, step)
    said.clear()
    for frame in frames:
        if frame.system != station:
            continue
        clock.run_to(frame.t, step)
        for received in split_datagram(frame.data):
            vehicle.receive(vehicle.channels[0], received)
    clock.run_to(frames[-1].t + step, step)
    wanted = [(t, data) for t, data in said if message_ids is None or message_id_of(data) in message_ids]
    return [Heard(t, answer) for t, data in wanted if (answer := decode_frame(data)) is not None]


class _Clock:
    """Recording time that goes on through reboots of the vehicle."""

    def __init__(self, vehicle: FlightController, boot_offset: float) -> None:
        self._vehicle = vehicle
        self.now = -boot_offset

    def run_to(self, t: float, step: float) -> None:
        """Advance the vehicle to a recording time, in steps."""
        while self.now < t - 1e-9:
            piece = min(step, t - self.now)
            self.now += piece
            self._vehicle.advance(self._vehicle.time + piece)
