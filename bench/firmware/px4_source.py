"""Sensors for PX4's simulator_mavlink, in a process of its own: chosen errors, attitude and temperature.

``python -m bench.firmware.px4_source TCP_PORT CONTROL_PORT TRUTH.json``. PX4 connects to the TCP port and takes one
HIL_SENSOR a step and sensor (MAVLink common.xml; the bits of fields_updated as ``SimulatorMavlink.cpp`` reads them).
Each UDP datagram on the control port is one request in JSON and is answered with the state.
"""

from __future__ import annotations

import json
import math
import select
import socket
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from pymavlink.dialects.v20 import common as mavlink
from scipy.spatial.transform import Rotation

from mavcal.service.lifetime import follow

Array = NDArray[np.float64]

RATE_HZ: Final = 250.0
MAG_EVERY, BARO_EVERY, GPS_EVERY = 5, 5, 50
GRAVITY: Final = 9.80665
FIELD_GAUSS: Final = np.array([0.2123, 0.0113, 0.4268])
HOME: Final = (47.397742, 8.545594, 488.0)
ACCEL_BITS, GYRO_BITS, MAG_BITS, BARO_BITS = 0x7, 0x38, 0x1C0, 0x1A00
LATE_S: Final = 0.5
"""Later than this it does not try to catch up."""
ANSWER_S: Final = 0.1
"""How long a step waits for PX4's actuators in lockstep."""
FIFO_STEPS: Final = {"accel": GRAVITY / 2048.0, "gyro": math.radians(2000.0 / 32768.0)}
"""PX4 keeps the first unit's readings as whole numbers of these steps, cut towards zero (``SimulatorMavlink.cpp``)."""
EPOCH_US: Final = 1_790_000_000_000_000


@dataclass
class Movement:
    """A turn about a body axis that is under way."""

    axis: Array
    rate: float
    left: float
    """rad still to turn."""
    target: Rotation | None
    """The attitude at its end; None: wherever it ends."""


class Board:
    """Attitude and temperature of the board, and what its sensors read."""

    def __init__(self, truth: dict[str, Any], seed: int) -> None:
        self._truth = truth
        self._rng = np.random.default_rng(seed)
        self.attitude = Rotation.identity()
        self.rate = np.zeros(3)
        self.celsius = float(truth["celsius"])
        self._ramp: tuple[float, float] | None = None
        self._movement: Movement | None = None
        self._tumble_dps = 0.0
        self._last: dict[tuple[str, int], Array] = {}

    def request(self, asked: dict[str, Any]) -> dict[str, Any]:
        """Do one request; the state."""
        if asked["do"] == "hold":
            self._tumble_dps = 0.0
            target = Rotation.from_euler("ZYX", asked["pose"][::-1], degrees=True)
            turn = (self.attitude.inv() * target).as_rotvec()
            angle = float(np.linalg.norm(turn))
            self._movement = Movement(turn / max(angle, 1e-12), math.radians(asked["dps"]), angle, target)
        elif asked["do"] == "tumble":
            self._tumble_dps, self._movement = asked["dps"], None
        elif asked["do"] == "still":
            self._tumble_dps, self._movement = 0.0, None
        elif asked["do"] == "temperature":
            self.celsius, self._ramp = float(asked["celsius"]), None
        elif asked["do"] == "warm_up":
            self.celsius, self._ramp = float(asked["start"]), (float(asked["end"]), float(asked["tau_s"]))
        elif asked["do"] == "set":
            self._truth[asked["sensor"]][asked["instance"]].update(asked["change"])
        q = self.attitude.as_quat(scalar_first=True).tolist()
        return {"moving": self._movement is not None, "celsius": self.celsius, "q": q}

    def step(self, dt: float) -> None:
        """Move and warm for one step."""
        if self._movement is None and self._tumble_dps:
            axis = self._rng.normal(size=3)
            turn = math.radians(self._tumble_dps)
            self._movement = Movement(axis / np.linalg.norm(axis), turn, 1.6 * turn, None)
        self.rate = np.zeros(3)
        if self._movement is not None:
            turned = min(self._movement.rate * dt, self._movement.left)
            self.attitude = self.attitude * Rotation.from_rotvec(self._movement.axis * turned)
            self.rate = self._movement.axis * turned / dt
            self._movement.left -= turned
            if self._movement.left <= 0.0:
                self.attitude = self._movement.target or self.attitude
                self._movement = None
        if self._ramp is not None:
            end, tau = self._ramp
            self.celsius += (end - self.celsius) * dt / tau

    def read(self, sensor: str, instance: int) -> Array | None:
        """One reading; None: there is no such sensor, or it is dead."""
        if instance >= len(self._truth[sensor]):
            return None
        own = self._truth[sensor][instance]
        if own.get("dead"):
            return None
        if own.get("frozen") and (sensor, instance) in self._last:
            return self._last[sensor, instance]
        true = {
            "accel": self.attitude.inv().apply([0.0, 0.0, -GRAVITY]),
            "gyro": self.rate,
            "mag": self.attitude.inv().apply(FIELD_GAUSS),
        }[sensor]
        warm = self.celsius - self._truth["middle_celsius"]
        drift = sum((np.array(c) * warm ** (k + 1) for k, c in enumerate(own.get("drift", []))), np.zeros(3))
        noise = self._rng.normal(0.0, own["noise"], 3)
        reading = np.asarray(np.array(own["matrix"]) @ true + np.array(own["offset"]) + drift + noise)
        self._last[sensor, instance] = reading
        return reading


class Source:
    """The TCP server that feeds PX4, in lockstep as soon as PX4 answers."""

    def __init__(self, board: Board, tcp_port: int, control_port: int) -> None:
        self._board = board
        self._server = socket.create_server(("127.0.0.1", tcp_port))
        self._control = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._control.bind(("127.0.0.1", control_port))
        self._control.settimeout(0.0)
        self._mavlink = mavlink.MAVLink(None, srcSystem=1, srcComponent=200)
        self._px4: socket.socket | None = None
        self._rng = np.random.default_rng(tcp_port)
        self._step = 0
        self._locked = False

    def run(self) -> None:
        """Serve until the process is ended."""
        due = time.monotonic()
        while True:
            self._answer()
            if self._px4 is None:
                ready, _, _ = select.select([self._server, self._control], [], [], 0.2)
                if self._server in ready:
                    self._px4, _ = self._server.accept()
                    self._px4.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                    self._step, self._locked, due = 0, False, time.monotonic()
                continue
            self._board.step(1.0 / RATE_HZ)
            self._step += 1
            try:
                self._px4.sendall(self._frames())
                self._locked = self._drained(ANSWER_S if self._locked else 0.0) or (
                    self._locked and self._step % 5 != 0
                )
            except OSError:
                self._px4.close()
                self._px4 = None
                continue
            due = max(due + 1.0 / RATE_HZ, time.monotonic() - LATE_S)
            while (left := due - time.monotonic()) > 0:
                if select.select([self._control], [], [], left)[0]:
                    self._answer()

    def _drained(self, wait_s: float) -> bool:
        """Whether PX4 has sent something; what it says does not matter."""
        assert self._px4 is not None
        if not select.select([self._px4], [], [], wait_s)[0]:
            return False
        if not self._px4.recv(65536):
            raise OSError("closed")
        return True

    def _answer(self) -> None:
        while True:
            try:
                datagram, sender = self._control.recvfrom(65535)
            except BlockingIOError:
                return
            self._control.sendto(json.dumps(self._board.request(json.loads(datagram))).encode(), sender)

    def _frames(self) -> bytes:
        now_us = round(self._step / RATE_HZ * 1e6)
        frames = []
        for instance in range(3):
            readings = {name: self._board.read(name, instance) for name in ("accel", "gyro")}
            if instance == 0:
                readings = {name: _in_steps(value, FIFO_STEPS[name]) for name, value in readings.items()}
            readings["mag"] = self._board.read("mag", instance) if self._step % MAG_EVERY == 0 else None
            bits = sum(
                bit
                for name, bit in (("accel", ACCEL_BITS), ("gyro", GYRO_BITS), ("mag", MAG_BITS))
                if readings[name] is not None
            )
            baro = instance == 0 and self._step % BARO_EVERY == 1
            bits |= BARO_BITS if baro else 0
            if not bits and instance:
                continue
            values = [
                v
                for name in ("accel", "gyro", "mag")
                for v in (np.zeros(3) if readings[name] is None else readings[name])
            ]
            pressure = 1013.25 * (1.0 - 2.25577e-5 * HOME[2]) ** 5.25588 + self._rng.normal(0.0, 0.02)
            message = mavlink.MAVLink_hil_sensor_message(
                now_us, *values, pressure if baro else 0.0, 0.0, HOME[2], self._board.celsius, bits, instance
            )
            frames.append(message.pack(self._mavlink))
        if self._step % GPS_EVERY == 0:
            place = round(HOME[0] * 1e7), round(HOME[1] * 1e7), round(HOME[2] * 1e3)
            fix = mavlink.MAVLink_hil_gps_message(EPOCH_US + now_us, 3, *place, 80, 120, 0, 0, 0, 0, 65535, 12)
            frames.append(fix.pack(self._mavlink))
        return b"".join(frames)


def _in_steps(reading: Array | None, step: float) -> Array | None:
    """The nearest whole step, a little beyond it: cutting off the fraction then takes nothing away."""
    if reading is None:
        return None
    whole = np.rint(reading / step)
    return np.asarray((whole + 0.25 * np.sign(whole)) * step)


if __name__ == "__main__":
    follow()
    truth = json.loads(Path(sys.argv[3]).read_text(encoding="utf-8"))
    Source(Board(truth, int(truth["seed"])), int(sys.argv[1]), int(sys.argv[2])).run()
