"""A simulated vehicle without sockets: requests in, decoded answers out, vehicle time by hand."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.service.simvehicle.config import load_config
from mavcal.service.simvehicle.server import make_vehicle
from mavcal.service.simvehicle.vehicle import FlightController, MavlinkChannel
from mavcal.service.simvehicle.wire import Packer, Received, split_datagram

CLEAN = {"offset": [0, 0, 0], "matrix": np.eye(3).tolist(), "polynomial": np.zeros((3, 3)).tolist()}
QUIET = {"accel_noise": 0.0, "gyro_noise": 0.0, "mag_noise": 0.0}


class Bench:
    """One vehicle and the ground station's end of its links."""

    def __init__(self, vehicle: FlightController, links: int = 1) -> None:
        self.vehicle = vehicle
        self.heard: list[list[Received]] = [[] for _ in range(links)]
        self._station = Packer(250, 190)
        for inbox in self.heard:
            vehicle.channels.append(MavlinkChannel(Packer(vehicle.config.system_id), self._listener(inbox)))
        vehicle.start()

    @staticmethod
    def _listener(inbox: list[Received]) -> Callable[[bytes], None]:
        return lambda frame: inbox.extend(split_datagram(frame))

    def send(self, message: Any, link: int = 0) -> None:
        for received in split_datagram(self._station.pack(message)):
            self.vehicle.receive(self.vehicle.channels[link], received)

    def send_set(self, name: str, payload: bytes, kind: int) -> None:
        """PARAM_SET with four given bytes of value."""
        body = payload + bytes([1, 1]) + name.encode().ljust(16, b"\0") + bytes([kind])
        frame = self._station.pack_payload(dialect.MAVLink_param_set_message, body)
        for received in split_datagram(frame):
            self.vehicle.receive(self.vehicle.channels[0], received)

    def set(self, name: str, value: float, kind: int = 9) -> None:
        self.send(dialect.MAVLink_param_set_message(1, 1, name.encode(), value, kind))

    def read(self, name: str, index: int = -1) -> None:
        self.send(dialect.MAVLink_param_request_read_message(1, 1, name.encode(), index))

    def command(self, number: int, *parameters: float) -> None:
        p = [*parameters, *([0.0] * (7 - len(parameters)))]
        self.send(dialect.MAVLink_command_long_message(1, 1, number, 0, *p))

    def run(self, seconds: float) -> None:
        end = self.vehicle.time + seconds
        self.vehicle.advance(end)

    def take(self, name: str, link: int = 0) -> list[Any]:
        """The messages of one name since the last look; everything else is forgotten."""
        found = [r.message for r in self.heard[link] if r.name == name]
        self.heard[link].clear()
        return found

    def take_received(self, name: str, link: int = 0) -> list[Received]:
        found = [r for r in self.heard[link] if r.name == name]
        self.heard[link].clear()
        return found


@pytest.fixture
def bench() -> Callable[..., Bench]:
    """A started vehicle: bench("ardupilot", **configuration)."""

    def build(autopilot: str, links: int = 1, **config: Any) -> Bench:
        loaded = load_config({"autopilot": autopilot, "calibration": "none"} | config)
        vehicle = make_vehicle(loaded)
        vehicle.preset_parameters(loaded.parameters)
        return Bench(vehicle, links)

    return build
