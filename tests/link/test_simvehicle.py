"""The simulated vehicle as a process: links, control channel, life and death."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.service.simvehicle import ControlError, SimulatedVehicle, StartError, free_udp_port
from mavcal.service.simvehicle.server import MAX_STEP_S
from mavcal.service.simvehicle.wire import Packer, Received, Splitter, split_datagram
from tests.patience import scaled

ROOT = Path(__file__).resolve().parents[2]
PATIENCE_S = 5.0


class Station:
    """A minimal ground station on a URL of a simulated vehicle."""

    def __init__(self, url: str) -> None:
        kind, host, port = url.split(":")
        self._packer = Packer(250, 190)
        self._splitter = Splitter() if kind == "tcp" else None
        self._peer: tuple[str, int] | None = None
        self._inbox: list[Received] = []
        if kind == "tcp":
            self.sock = socket.create_connection((host, int(port)), timeout=PATIENCE_S)
        else:
            self.sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            self.sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 22)
            try:
                self.sock.bind((host, int(port)) if kind == "udpin" else ("127.0.0.1", 0))
            except OSError:
                self.sock.close()
                raise
            self._peer = (host, int(port)) if kind == "udpout" else None
        self.sock.settimeout(0.05)

    def send(self, message: Any) -> None:
        frame = self._packer.pack(message)
        if self._splitter is not None:
            self.sock.sendall(frame)
        else:
            assert self._peer is not None
            self.sock.sendto(frame, self._peer)

    def command(self, number: int, *p: float) -> None:
        self.send(dialect.MAVLink_command_long_message(1, 1, number, 0, *p, *[0.0] * (7 - len(p))))

    def poll(self) -> list[Received]:
        """What has arrived within a short wait."""
        try:
            if self._splitter is not None:
                data = self.sock.recv(65536)
                if not data:
                    raise ConnectionResetError
                return list(self._splitter.feed(data))
            data, peer = self.sock.recvfrom(65536)
        except TimeoutError:
            return []
        self._peer = self._peer or peer
        return split_datagram(data)

    def expect(self, name: str, patience: float = PATIENCE_S, **fields: Any) -> Any:
        """The next message of this name with these field values."""
        deadline = time.monotonic() + scaled(patience)
        while time.monotonic() < deadline:
            self._inbox += self.poll()
            while self._inbox:
                message = self._inbox.pop(0).message
                if message.get_type() == name and all(getattr(message, k) == v for k, v in fields.items()):
                    return message
        raise AssertionError(f"no {name} {fields} within {patience} s")

    def collect(self, seconds: float) -> list[Any]:
        deadline, found = time.monotonic() + seconds, []
        while time.monotonic() < deadline:
            found += [r.message for r in self.poll()]
        return found

    def close(self) -> None:
        self.sock.close()

    def __enter__(self) -> Station:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


@pytest.fixture
def ardupilot() -> Iterator[SimulatedVehicle]:
    with SimulatedVehicle(speed=5) as vehicle:
        yield vehicle


@pytest.mark.parametrize(
    ("autopilot", "link"), [("ardupilot", "udpout"), ("ardupilot", "tcp"), ("ardupilot", "udpin"), ("px4", "udpout")]
)
def test_every_link_carries_requests_and_answers(autopilot: str, link: str) -> None:
    name = b"INS_ACC_ID" if autopilot == "ardupilot" else b"CAL_ACC0_ID"
    with SimulatedVehicle(autopilot, link=link, speed=5) as vehicle, Station(vehicle.url) as station:
        if link == "udpout":
            station.expect("HEARTBEAT")
        else:
            station.send(dialect.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
        assert station.expect("HEARTBEAT").autopilot == (3 if autopilot == "ardupilot" else 12)
        station.send(dialect.MAVLink_param_request_read_message(1, 1, name, -1))
        station.expect("PARAM_VALUE", param_id=name.decode())
        station.command(512, 148)
        version = station.expect("AUTOPILOT_VERSION")
        assert bool(version.capabilities & 16) == (autopilot == "px4")


def test_it_starts_quickly_and_prints_one_line() -> None:
    took: list[float] = []
    while not took or (took[-1] >= scaled(1.5) and len(took) < 3):  # a machine that stands still spoils one start
        begin = time.monotonic()
        with SimulatedVehicle("px4", seed=9) as vehicle:
            assert vehicle.seed == 9
            assert vehicle.url.startswith("udpin:127.0.0.1:")
            took.append(time.monotonic() - begin)
    assert took[-1] < scaled(1.5), took


def test_the_clock_runs_at_the_asked_speed(ardupilot: SimulatedVehicle) -> None:
    ardupilot.call("speed", value=20)
    fastest = 0.0
    for _ in range(10):
        began, before = time.monotonic(), ardupilot.state()["time"]
        time.sleep(0.5)
        passed = ardupilot.state()["time"] - before
        wall = time.monotonic() - began
        assert passed <= 20 * (wall + MAX_STEP_S), "never ahead of the asked speed, but for one step"
        fastest = max(fastest, passed / wall)
        if fastest > 10:
            return
    raise AssertionError(f"behind the asked speed in every half second: {fastest}")  # a busy machine has better ones


def test_every_verb_of_motion_and_surroundings_acts(ardupilot: SimulatedVehicle) -> None:
    ardupilot.call("hold", pose="left", tilt_deg=0, tremor_deg=0, transition_s=0)
    assert ardupilot.state()["euler_deg"][0] == pytest.approx(-90, abs=1e-6)
    ardupilot.call("turn", axis=[0, 0, 1], rate_dps=30)
    ardupilot.wait(1.0)
    assert ardupilot.state()["rate"][2] == pytest.approx(0.5236, abs=1e-3)
    ardupilot.call("tumble")
    assert ardupilot.state()["motion"] == "tumble"
    ardupilot.call("still")
    ardupilot.call("temperature", value=47.0)
    ardupilot.call("throttle", value=0.4)
    ardupilot.call("current", amps=12.5)
    state = ardupilot.state()
    assert state["rate"] == [0, 0, 0]
    assert state["temperatures"][0] == pytest.approx(47.0)
    assert (state["throttle"], state["current"]) == (0.4, 12.5)
    ardupilot.call("warm_up", start=20, end=60, tau_s=10)
    ardupilot.wait(10.0)
    assert 44 < ardupilot.state()["temperatures"][0] < 50


def test_what_the_control_channel_does_not_know_is_refused_with_what_it_knows(ardupilot: SimulatedVehicle) -> None:
    with pytest.raises(ControlError, match="known: hold"):
        ardupilot.call("fly")
    with pytest.raises(ControlError, match="finite number"):
        ardupilot.call("temperature", value="hot")
    with pytest.raises(ControlError, match="known: loss"):
        ardupilot.call("fault", kind="gremlins")
    with pytest.raises(ControlError, match="trigger"):
        ardupilot.call("fault", kind="reboot", trigger="tomorrow")
    assert ardupilot.state()["alive"]


def test_truth_and_parameters_are_told(ardupilot: SimulatedVehicle) -> None:
    truth = ardupilot.truth()
    assert len(truth["accels"]) == 3
    assert len(truth["mags"]) == 2
    assert truth["accels"][0]["id"] == 2753028
    in_force, stored = ardupilot.parameters()
    assert in_force["INS_ACCSCAL_X"] == stored["INS_ACCSCAL_X"] != 1.0  # an older calibration
    assert len(stored) > 280


def test_arming_changes_the_heartbeat_and_writes_nothing(ardupilot: SimulatedVehicle) -> None:
    with Station(ardupilot.url) as station:
        assert station.expect("HEARTBEAT").base_mode & 128 == 0
        before = ardupilot.parameters()[1]
        ardupilot.call("arm")
        beat = station.expect("HEARTBEAT", base_mode=209)
        assert beat.system_status == 3
        assert {k: v for k, v in ardupilot.parameters()[1].items() if not k.startswith("STAT_")} == {
            k: v for k, v in before.items() if not k.startswith("STAT_")
        }


def test_a_write_on_one_link_is_echoed_on_the_other() -> None:
    with (
        SimulatedVehicle(link=["udpout", "udpout"], speed=5) as vehicle,
        Station(vehicle.urls[0]) as first,
        Station(vehicle.urls[1]) as second,
    ):
        first.expect("HEARTBEAT")
        second.expect("HEARTBEAT")
        first.send(dialect.MAVLink_param_set_message(1, 1, b"COMPASS_OFS_Y", 12.0, 9))
        assert second.expect("PARAM_VALUE", param_id="COMPASS_OFS_Y").param_value == 12.0
        assert vehicle.state()["param_set_list"][0][1:] == ["COMPASS_OFS_Y", 12.0]


def test_tcp_serves_one_client_at_a_time_and_drops_it_at_a_reboot() -> None:
    with SimulatedVehicle(link="tcp", speed=5) as vehicle:
        first, second = Station(vehicle.url), Station(vehicle.url)
        with first, second:
            first.expect("HEARTBEAT")
            assert second.collect(0.4) == []
            first.close()
            second.expect("HEARTBEAT")
            second.command(246, 1)
            assert second.expect("COMMAND_ACK").result == 0
            with pytest.raises(ConnectionResetError):
                second.collect(scaled(PATIENCE_S))
        with Station(vehicle.url) as third:
            third.expect("HEARTBEAT")
            assert vehicle.state()["boots"] == 1


def test_px4_answers_the_first_address_for_ever() -> None:
    with (
        SimulatedVehicle("px4", link="udpin", speed=5) as vehicle,
        Station(vehicle.url) as first,
        Station(vehicle.url) as second,
    ):
        first.send(dialect.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
        first.expect("HEARTBEAT")
        second.send(dialect.MAVLink_param_set_message(1, 1, b"CAL_ACC0_XOFF", 0.3, 9))
        assert first.expect("PARAM_VALUE").param_value == pytest.approx(0.3)
        assert second.collect(0.3) == []


def test_a_script_moves_the_vehicle_without_an_operator() -> None:
    with SimulatedVehicle(script="faces", speed=50) as vehicle:
        seen = set()
        deadline = time.monotonic() + scaled(PATIENCE_S)
        while len(seen) < 6 and time.monotonic() < deadline:
            seen.add(vehicle.state()["motion"])
            time.sleep(0.02)
        assert len(seen) >= 6


def test_it_ends_with_its_parent() -> None:
    vehicle = SimulatedVehicle()
    try:
        assert vehicle.process.stdin is not None
        vehicle.process.stdin.close()
        assert vehicle.process.wait(scaled(3.0)) == 0
    finally:
        vehicle.stop()


def test_stopping_twice_is_harmless_and_calls_afterwards_are_refused() -> None:
    vehicle = SimulatedVehicle()
    vehicle.stop()
    vehicle.stop()
    with pytest.raises(ControlError, match="stopped"):
        vehicle.state()


def test_wrong_use_says_why_and_does_not_start() -> None:
    with pytest.raises(StartError, match="unknown configuration colour"):
        SimulatedVehicle(config={"colour": "red"})
    with pytest.raises(StartError, match="must be serial, or begin with"):
        SimulatedVehicle(link="serial:/dev/null")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        with pytest.raises(StartError, match="cannot listen"):
            SimulatedVehicle(link=f"udpin:127.0.0.1:{taken.getsockname()[1]}")


def test_a_free_port_is_one_that_no_system_hands_out_and_nobody_has(monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        port = free_udp_port()
        assert 20_000 <= port < 32_768
        taken.bind(("127.0.0.1", port))
        offered = iter([port, port, 20_001 if port != 20_001 else 20_002])
        monkeypatch.setattr("secrets.choice", lambda _: next(offered))
        assert free_udp_port() != port


def test_the_command_line_prints_where_it_can_be_reached() -> None:
    port = free_udp_port()
    command = [sys.executable, "-m", "mavcal.service.simvehicle", "--udpout", f"127.0.0.1:{port}", "--seed", "5"]
    process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, env=os.environ.copy())
    try:
        assert process.stdout is not None
        ready = json.loads(process.stdout.readline())
        assert ready["ready"] is True
        assert ready["url"] == f"udpin:127.0.0.1:{port}"
        assert ready["seed"] == 5
        process.terminate()
        assert process.wait(scaled(3.0)) == 0
    finally:
        process.kill()
        process.wait()
        assert process.stdout is not None
        process.stdout.close()
