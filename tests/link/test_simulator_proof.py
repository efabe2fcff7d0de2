"""A vehicle that is no simulator hears questions and nothing else; nor is a second one at the address ever told."""

from __future__ import annotations

import socket
import sys
import threading
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.calib.recording import Recording
from mavcal.service.closing.errors import NoSimulator, OtherVehicle
from mavcal.service.closing.link import VehicleLink
from mavcal.service.closing.loop import Closing, ClosingPlan
from mavcal.service.closing.proof import SimulatorProof
from mavcal.service.closing.simulator import SimulatorCommand
from mavcal.service.link.endpoint import parse_endpoint
from mavcal.service.simvehicle.flight.flightlog import FlightLog
from mavcal.service.simvehicle.flight.frame import frame_of
from mavcal.service.simvehicle.flight.ground import GroundLink
from mavcal.service.simvehicle.flight.parameters import FlightParameters
from mavcal.service.simvehicle.flight.vehicle import FlyingVehicle
from mavcal.service.simvehicle.links import TcpServer
from mavcal.service.simvehicle.wire import Packer, Received, Splitter

pytestmark = pytest.mark.timeout(120)
ROOT = Path(__file__).resolve().parents[2]
QUESTIONS = {"HEARTBEAT", "PARAM_REQUEST_READ", 512, 520}
"""MAV_CMD_REQUEST_MESSAGE and MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES: neither changes anything."""
RELAY = """
import socket, subprocess, sys, threading
port, *command = sys.argv[1:]
probe = socket.create_server(("127.0.0.1", 0))
inner = probe.getsockname()[1]
probe.close()
subprocess.Popen([*command, f"127.0.0.1:{inner}"])
def to_the_vehicle():
    while True:
        try:
            return socket.create_connection(("127.0.0.1", inner))
        except OSError:
            pass
vehicle = to_the_vehicle()
station, _ = socket.create_server(("127.0.0.1", int(port))).accept()
def pass_on(here, there, file):
    while data := here.recv(65536):
        file.write(data)
        file.flush()
        there.sendall(data)
threading.Thread(target=pass_on, args=(vehicle, station, open("said.bin", "wb")), daemon=True).start()
pass_on(station, vehicle, open("told.bin", "wb"))
"""
"""Stands between the loop and what its command started, and keeps what the vehicle is told."""


def kinds(received: Received) -> str | int:
    return int(received.message.command) if received.name.startswith("COMMAND") else received.name


@pytest.mark.parametrize(("autopilot", "why"), [("ardupilot", "SIM_SPEEDUP"), ("px4", "unit id")])
def test_the_loop_tells_a_flight_controller_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, autopilot: str, why: str
) -> None:
    """The bench's vehicles are flight controllers: they have neither SIM_* nor the id of PX4's simulator."""
    monkeypatch.setattr("mavcal.service.closing.proof.ANSWER_S", 3.0)
    script = tmp_path / "relay.py"
    script.write_text(RELAY)
    command = (
        f"env PYTHONPATH={ROOT} {sys.executable} {script} {{port}} "
        f"{sys.executable} -m mavcal simulate vehicle --autopilot {autopilot} --tcp"
    )
    plan = ClosingPlan(Recording(()), "0" * 64, SimulatorCommand(command), tmp_path / "work", ROOT)
    with pytest.raises(NoSimulator, match=rf"does not show that it is a simulator: .*{why}.*Nothing was set, armed"):
        Closing(plan, _never).run()
    told = Counter(map(kinds, Splitter().feed((tmp_path / "work" / "round-0" / "told.bin").read_bytes())))
    assert set(told) <= QUESTIONS
    assert told[512] >= 1


def _never(*_: object, **__: object) -> Any:
    raise AssertionError("diagnosed what was not flown")


class OnABoard(GroundLink):
    """Simulates on a flight controller, whose outputs may be connected."""

    def _version(self) -> Any:
        stated = super()._version()
        stated.board_version, stated.vendor_id, stated.product_id = 140 << 16, 0x2DAE, 0x1016
        return stated


@contextmanager
def answering(log: Path, kind: type[GroundLink]) -> Iterator[str]:
    """The URL of a flying vehicle in a thread."""
    server, end = TcpServer("127.0.0.1:0"), threading.Event()
    vehicle = FlyingVehicle(frame_of({}), FlightParameters(), FlightLog(log), seed=5)
    ground = kind(vehicle, server)

    def live() -> None:
        while not end.is_set():
            vehicle.loop()
            ground.send_due()
            ground.poll()

    thread = threading.Thread(target=live)
    thread.start()
    try:
        yield server.url
    finally:
        end.set()
        thread.join()
        vehicle.close()
        server.close()


@pytest.mark.parametrize("kind", [GroundLink, OnABoard])
def test_a_simulation_on_a_flight_controller_is_not_flown(tmp_path: Path, kind: type[GroundLink]) -> None:
    with answering(tmp_path / "log.bin", kind) as url, VehicleLink(parse_endpoint(url)) as link:
        link.connect(10.0, lambda: None)
        proof = SimulatorProof(link, lambda: None)
        if kind is GroundLink:
            proof.require()
            return
        with pytest.raises(NoSimulator, match=r"board 140, USB 2dae:1016"):
            proof.require()


class Speaker:
    """A vehicle of a few heartbeats, from a UDP port of its own."""

    def __init__(self, port: int, system: int) -> None:
        self._packer, self._to = Packer(system), ("127.0.0.1", port)
        self.sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.sock.bind(("127.0.0.1", 0))
        self.sock.settimeout(0.0)

    def beat(self, autopilot: int = dialect.MAV_AUTOPILOT_PX4) -> None:
        self.sock.sendto(self._packer.pack(dialect.MAVLink_heartbeat_message(2, autopilot, 81, 0, 4, 3)), self._to)

    def heard(self) -> set[str]:
        """Names of what it was sent by now."""
        names: set[str] = set()
        while True:
            try:
                names |= {one.name for one in Splitter().feed(self.sock.recv(65536))}
            except BlockingIOError:
                return names


@contextmanager
def meeting(system: int) -> Iterator[tuple[VehicleLink, Speaker, Speaker]]:
    """A link that has met the first of two speakers, of which the second has this system."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    first, second = Speaker(port, 1), Speaker(port, system)
    with VehicleLink(parse_endpoint(f"udpin:127.0.0.1:{port}")) as link, first.sock, second.sock:
        link.connect(5.0, first.beat)
        yield link, first, second


def _listen(link: VehicleLink) -> None:
    for _ in range(20):
        link.poll()


@pytest.mark.parametrize("system", [1, 2])
def test_a_second_vehicle_ends_the_conversation(system: int) -> None:
    with meeting(system) as (link, first, second):
        second.beat()
        with pytest.raises(OtherVehicle, match=rf"two vehicles speak at .*system 1 and system {system}"):
            _listen(link)
        link.send(dialect.MAVLink_param_set_message(*link.target, b"NAME", 1.0, 9))
        link.poll()
        assert "PARAM_SET" in first.heard()
        assert second.heard() <= {"HEARTBEAT"}  # ours, before anybody was met


def test_a_ground_station_at_the_address_is_no_vehicle() -> None:
    with meeting(255) as (link, first, second):
        second.beat(dialect.MAV_AUTOPILOT_INVALID)
        for _ in range(5):
            link.poll()
        link.send(dialect.MAVLink_param_set_message(*link.target, b"NAME", 1.0, 9))
        assert "PARAM_SET" not in second.heard()
        link.poll()
        assert "PARAM_SET" in first.heard()


def test_whoever_is_there_before_the_simulator_is_not_flown(tmp_path: Path) -> None:
    marker = tmp_path / "started"
    command = SimulatorCommand(f"{sys.executable} -c \"open('{marker}', 'w'); import time; time.sleep(60)\"")
    with answering(tmp_path / "log.bin", GroundLink) as url:
        plan = ClosingPlan(Recording(()), "0" * 64, command, tmp_path / "work", ROOT, connect=url)
        with pytest.raises(OtherVehicle, match="although the simulator is not started yet"):
            Closing(plan, _never).run()
    assert not marker.exists()
