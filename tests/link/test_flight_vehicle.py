"""The flying vehicle as a process: its port, its parameters, its streams, and an end that leaves a whole log."""

from __future__ import annotations

import itertools
import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.calib.logs.dataflash import read_dataflash
from mavcal.service.simvehicle.wire import Packer, Received, Splitter, split_datagram
from tests.patience import scaled

ROOT = Path(__file__).resolve().parents[2]
PATIENCE_S = 10.0


class Station:
    """A ground station at the vehicle's port."""

    def __init__(self, url: str) -> None:
        kind, host, port = url.split(":")
        self._packer, self._splitter = Packer(250, 190), Splitter()
        self._datagrams = kind == "udpout"
        self.sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM if self._datagrams else socket.SOCK_STREAM)
        self.sock.connect((host, int(port)))
        self.sock.settimeout(0.05)
        self._inbox: list[Received] = []

    def send(self, message: Any) -> None:
        self.sock.sendall(self._packer.pack(message))

    def command(self, number: int, *p: float) -> int:
        self.send(dialect.MAVLink_command_long_message(1, 1, number, 0, *p, *[0.0] * (7 - len(p))))
        return int(self.expect("COMMAND_ACK", command=number).result)

    def expect(self, name: str, **fields: Any) -> Any:
        deadline = time.monotonic() + scaled(PATIENCE_S)
        while time.monotonic() < deadline:
            while self._inbox:
                message = self._inbox.pop(0).message
                if message.get_type() == name and all(getattr(message, k) == v for k, v in fields.items()):
                    return message
            try:
                data = self.sock.recv(65536)
            except TimeoutError:
                continue
            self._inbox += split_datagram(data) if self._datagrams else self._splitter.feed(data)
        raise AssertionError(f"no {name} with {fields}")


@pytest.fixture(params=[(), ("--udp",)], ids=["tcp", "udp"])
def flying(tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[tuple[subprocess.Popen[str], Station]]:
    command = [sys.executable, "-m", "mavcal", "simulate", "flight", "--port", "0", "--log", str(tmp_path / "x.bin")]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    process = subprocess.Popen(
        [*command, "--speedup", "20", *request.param], stdout=subprocess.PIPE, text=True, cwd=ROOT, env=environment
    )
    assert process.stdout is not None
    station = Station(json.loads(process.stdout.readline())["url"])
    station.send(dialect.MAVLink_heartbeat_message(6, 8, 0, 0, 0, 3))
    yield process, station
    station.sock.close()
    process.kill()
    process.wait()
    process.stdout.close()


def test_it_answers_as_an_ardupilot_does(flying: tuple[subprocess.Popen[str], Station], tmp_path: Path) -> None:
    process, station = flying
    heartbeat = station.expect("HEARTBEAT")
    assert (heartbeat.autopilot, heartbeat.type) == (dialect.MAV_AUTOPILOT_ARDUPILOTMEGA, dialect.MAV_TYPE_QUADROTOR)
    station.sock.sendall(b"\xfd\x09 this is no frame of any kind" * 20)
    station.send(dialect.MAVLink_param_set_message(1, 1, b"SIM_WIND_SPD", 3.5, 9))
    assert station.expect("PARAM_VALUE", param_id="SIM_WIND_SPD").param_value == 3.5
    station.send(dialect.MAVLink_param_request_read_message(1, 1, b"FRAME_CLASS", -1))
    assert station.expect("PARAM_VALUE", param_id="FRAME_CLASS").param_value == 1.0
    station.send(dialect.MAVLink_param_request_list_message(1, 1))
    first = station.expect("PARAM_VALUE", param_index=0)
    assert station.expect("PARAM_VALUE", param_index=first.param_count - 1).param_count == first.param_count

    assert station.command(dialect.MAV_CMD_SET_MESSAGE_INTERVAL, dialect.MAVLINK_MSG_ID_ATTITUDE, 20_000) == 0
    times = [station.expect("ATTITUDE").time_boot_ms for _ in range(5)]
    assert {b - a for a, b in itertools.pairwise(times)} == {20}
    assert station.command(dialect.MAV_CMD_SET_MESSAGE_INTERVAL, dialect.MAVLINK_MSG_ID_VIBRATION, 1e6) == 2
    assert station.command(dialect.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, 5.0) == 4  # not armed
    assert station.command(dialect.MAV_CMD_PREFLIGHT_CALIBRATION, 1) == 3
    assert station.command(dialect.MAV_CMD_REQUEST_MESSAGE, dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE) == 0
    assert station.expect("EXTENDED_SYS_STATE").landed_state == dialect.MAV_LANDED_STATE_ON_GROUND

    process.send_signal(signal.SIGTERM)
    assert process.wait(scaled(PATIENCE_S)) == 0
    recording = read_dataflash(tmp_path / "x.bin")
    assert recording.parameters.final()["SIM_WIND_SPD"] == 3.5
    assert "damage" not in {event.kind for event in recording.events}


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--frame", "none.json"), "frame file none.json cannot be read"),
        (("--log", "no/such/folder/x.bin"), "log no/such/folder/x.bin cannot be written"),
    ],
)
def test_wrong_use_is_one_sentence(tmp_path: Path, arguments: tuple[str, ...], said: str) -> None:
    command = [sys.executable, "-m", "mavcal", "simulate", "flight", "--port", "0", "--log", "x.bin", *arguments]
    done = subprocess.run(
        command, capture_output=True, text=True, cwd=tmp_path, env={**os.environ, "PYTHONPATH": str(ROOT)}
    )
    assert done.returncode == 2
    assert said in done.stderr
    assert "Traceback" not in done.stderr
