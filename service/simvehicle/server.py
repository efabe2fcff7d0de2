"""Main loop: each tick of the wall clock reads the sockets, advances vehicle time and sends frames.

The control channel has one JSON object a line over TCP on loopback, each answered by one.
"""

from __future__ import annotations

import json
import math
import os
import select
import socket
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from typing import Any

from mavcal.service.simvehicle.config import Calibration, SimAutopilot, VehicleConfig
from mavcal.service.simvehicle.earlier import earlier_calibration
from mavcal.service.simvehicle.errors import ControlError, SimulatedVehicleError
from mavcal.service.simvehicle.faults import Injector
from mavcal.service.simvehicle.impairment import FaultyLink
from mavcal.service.simvehicle.links import SimEndpoint, bound_socket
from mavcal.service.simvehicle.scripts import SCRIPTS
from mavcal.service.simvehicle.vehicle import FlightController, MavlinkChannel
from mavcal.service.simvehicle.verbs import Verbs
from mavcal.service.simvehicle.wire import Packer, Received

MAX_LINE = 1 << 20
Handler = Callable[[str, Mapping[str, Any]], dict[str, Any]]
TICK_S = 0.005
FAST, FAST_TICK_S = 5.0, 0.010  # from this speed on, longer ticks: whatever arrives still ends the wait
MAX_STEP_S = 0.05  # of wall time: a process that was suspended neither catches up nor floods its peer
MAX_SPEED = 1000.0
TWIN_SEED = 1000  # how far a twin's seed is from its vehicle's

Ready = set[socket.socket | int]


class ControlServer:
    """Accepts any number of clients; every request names what to `do` and is answered with its `id`."""

    def __init__(self, port: int, handler: Handler) -> None:
        self._listener = bound_socket(socket.SOCK_STREAM, ("127.0.0.1", port))
        self._listener.listen()
        host, self.port = self._listener.getsockname()
        self.address = f"{host}:{self.port}"
        self._handler = handler
        self._clients: dict[socket.socket, bytearray] = {}

    def sockets(self) -> list[socket.socket]:
        """Sockets on which to wait for frames."""
        return [self._listener, *self._clients]

    def poll(self) -> None:
        """Answer everything that has arrived."""
        try:
            client, _ = self._listener.accept()
            client.setblocking(False)  # noqa: FBT003
            self._clients[client] = bytearray()
        except (BlockingIOError, OSError):
            client = None
        for client in list(self._clients):
            self._serve(client)

    def _serve(self, client: socket.socket) -> None:
        buffer = self._clients[client]
        try:
            data = client.recv(65536)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        buffer += data
        if not data or len(buffer) > MAX_LINE:
            self._forget(client)
            return
        while (end := buffer.find(b"\n")) >= 0:
            line = bytes(buffer[:end])
            del buffer[: end + 1]
            self._answer(client, line)

    def _answer(self, client: socket.socket, line: bytes) -> None:
        identifier: Any = None
        try:
            request = json.loads(line)
            if not isinstance(request, dict) or not isinstance(request.get("do"), str):
                raise ValueError('a request is an object such as {"id": 1, "do": "state"}')
            identifier = request.pop("id", None)
            reply = {"id": identifier, "ok": True, **self._handler(request.pop("do"), request)}
        except (SimulatedVehicleError, ValueError, TypeError, KeyError) as error:
            reply = {"id": identifier, "ok": False, "error": f"{type(error).__name__}: {error}"}
        try:
            client.setblocking(True)  # noqa: FBT003
            client.settimeout(1.0)
            client.sendall(json.dumps(reply).encode() + b"\n")
            client.setblocking(False)  # noqa: FBT003
        except OSError:
            self._forget(client)

    def _forget(self, client: socket.socket) -> None:
        client.close()
        self._clients.pop(client, None)

    def close(self) -> None:
        """Release the port and every client."""
        for client in list(self._clients):
            self._forget(client)
        self._listener.close()


def make_vehicle(config: VehicleConfig) -> FlightController:
    """A vehicle of the configured personality, not yet booted."""
    vehicle = _personality(config)
    if config.calibration is not Calibration.NONE:
        vehicle.preset_parameters(earlier_calibration(config, vehicle.world.truth))
    return vehicle


def _personality(config: VehicleConfig) -> FlightController:
    # Imported here: each personality only pays for itself.
    if config.autopilot is SimAutopilot.ARDUPILOT:
        from mavcal.service.simvehicle.ardupilot import ArduPilotVehicle

        return ArduPilotVehicle(config)
    from mavcal.service.simvehicle.px4 import Px4Vehicle

    return Px4Vehicle(config)


class SimServer:
    """One vehicle with its links and its control channel."""

    def __init__(self, vehicle: FlightController, links: list[SimEndpoint], control_port: int, speed: float) -> None:
        self.vehicle = vehicle
        self.speed = 1.0
        self.set_speed(speed)
        self.lag_s = 0.0
        self._running = True
        self._stdin: int | None = None
        self._script: Iterator[float] | None = None
        self._script_due = -math.inf
        self._twins: list[tuple[FlightController, list[MavlinkChannel]]] = []
        self.injector = Injector(self)
        self.links = [self._joined(link) for link in links]
        vehicle.on_set = self.injector.saw_set
        vehicle.on_reboot = self._rebooted
        self.control = ControlServer(control_port, Verbs(self))

    def _joined(self, link: SimEndpoint) -> FaultyLink:
        faulty = FaultyLink(link, self.vehicle.config.seed)
        channel = MavlinkChannel(
            Packer(self.vehicle.config.system_id, signer=self.vehicle.signer), faulty.send, faulty.room, faulty.carried
        )
        self.vehicle.channels.append(channel)
        faulty.channel = channel
        return faulty

    def add_twin(self) -> None:
        """A second vehicle of the same system id speaks on every link."""
        config = self.vehicle.config
        twin = make_vehicle(replace(config, seed=config.seed + TWIN_SEED))
        twin.channels = [MavlinkChannel(Packer(config.system_id, signer=twin.signer), link.send) for link in self.links]
        twin.start()
        self._twins.append((twin, twin.channels))

    def remove_twins(self) -> None:
        """Remove every vehicle but the first."""
        self._twins.clear()

    def _rebooted(self) -> None:
        for link in self.links:
            link.vehicle_rebooted()

    # --- scripts and speed

    def set_speed(self, value: float) -> None:
        """Seconds of vehicle time per second of wall time."""
        if not 0 < value <= MAX_SPEED:
            raise ControlError(f"speed must be above 0 and at most {MAX_SPEED:.0f}, got {value}")
        self.speed = value

    def run_script(self, name: str) -> None:
        """Begin a script of SCRIPTS; it ends the one before."""
        self._script, self._script_due = SCRIPTS[name](self.vehicle), -math.inf
        self._step_script()

    def stop_script(self) -> None:
        """End the script; the operator moves the vehicle."""
        self._script = None

    def _step_script(self) -> None:
        """Run the next step of the script when due, also across reboots of the vehicle."""
        if self._script is None or self.vehicle.elapsed < self._script_due:
            return
        wait = next(self._script, None)
        self._script_due = self.vehicle.elapsed + wait if wait is not None else math.inf

    # --- the loop

    def run(self, *, follow_stdin: bool = False) -> None:
        """Run until `stop`, or until stdin ends where asked to follow it."""
        self._stdin = sys.stdin.fileno() if follow_stdin else None
        self.vehicle.start()
        last = time.monotonic()
        while self._running:
            tick = TICK_S if self.speed < FAST else FAST_TICK_S
            ready = self._wait(last + tick - time.monotonic())
            now = time.monotonic()
            self._tick(min(now - last, MAX_STEP_S), ready)
            self.lag_s = max(time.monotonic() - now - tick, 0.0)
            last = now
        self.close()

    def _wait(self, seconds: float) -> Ready:
        """Wait for the next tick, or shorter if something arrives; what can be read."""
        waited: list[socket.socket | int] = [*self.control.sockets()]
        for link in self.links:
            waited += link.sockets()
        if self._stdin is not None:
            waited.append(self._stdin)
        ready, _, _ = select.select(waited, [], [], max(seconds, 0.0))
        if self._stdin is not None and self._stdin in ready and not os.read(self._stdin, 4096):
            self.stop()
        return set(ready)

    def _tick(self, wall_s: float, ready: Ready | None = None) -> None:
        """Read what has arrived (None: on every socket), advance vehicle time, send what was held back."""
        if ready is None or not ready.isdisjoint(self.control.sockets()):
            self.control.poll()
        for link in self.links:
            if ready is None or link.holding or not ready.isdisjoint(link.sockets()):
                for received in link.received():
                    self._deliver(link, received)
        for vehicle in (self.vehicle, *(twin for twin, _ in self._twins)):
            vehicle.advance(vehicle.time + wall_s * self.speed)
        self.injector.tick()
        self._step_script()
        for link in self.links:
            link.flush()

    def _deliver(self, link: FaultyLink, received: Received) -> None:
        if link.channel is not None:
            self.vehicle.receive(link.channel, received)
        for twin, channels in self._twins:
            twin.receive(channels[self.links.index(link)], received)

    def stop(self) -> None:
        """End the loop after this tick."""
        self._running = False

    def close(self) -> None:
        """Release every socket."""
        self.control.close()
        for link in self.links:
            link.close()
