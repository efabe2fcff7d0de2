"""Undoing against the simulated vehicle, which corrects its sensors by a reading of its own of the same facts.

The vehicle stands still under a calibration in force that is wrong everywhere; what is undone from its streams must be
its sensors' truth. No sockets: the frames are handed over in the process.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.calib.firmware.in_force.undo import Undo, undo
from mavcal.calib.firmware.stream.assembler import Assembler
from mavcal.calib.firmware.stream.rates import requested_streams
from mavcal.calib.recording import Channel, Identity, Recording, Sensor, Stage, join
from mavcal.calib.wire.codec import encode
from mavcal.calib.wire.frames import Frame, FrameParser
from mavcal.service.simvehicle.config import load_config
from mavcal.service.simvehicle.server import make_vehicle
from mavcal.service.simvehicle.vehicle import FlightController
from mavcal.service.simvehicle.vehicle import MavlinkChannel as Link
from mavcal.service.simvehicle.verbs import truth_report
from mavcal.service.simvehicle.wire import Packer, split_datagram

SECONDS = 12.0
STEP = 0.05
AMPERES = 8.0

WRONG_ARDUPILOT: dict[str, float] = {
    "INS_GYR_CAL": 0,
    "COMPASS_MOTCT": 2,
    "COMPASS_SCALE": 1.1,
    "COMPASS_SCALE2": 1.7,  # outside the window
}
for _n, _digit in (("1", ""), ("2", "2"), ("3", "3")):
    WRONG_ARDUPILOT[f"INS_ACC{_n}_CALTEMP"] = 31.0
    WRONG_ARDUPILOT[f"INS_GYR{_n}_CALTEMP"] = -300.0
    for _k, _axis in enumerate("XYZ"):
        WRONG_ARDUPILOT |= {
            f"INS_ACC{_digit}OFFS_{_axis}": 0.3 - 0.2 * _k,
            f"INS_ACC{_digit}SCAL_{_axis}": 0.97 + 0.02 * _k,
            f"INS_GYR{_digit}OFFS_{_axis}": -0.02 + 0.015 * _k,
            f"COMPASS_OFS{_digit}_{_axis}": 80.0 - 50 * _k,
            f"COMPASS_DIA{_digit}_{_axis}": 1.1 - 0.08 * _k,
            f"COMPASS_ODI{_digit}_{_axis}": 0.03 * (_k - 1),
            f"COMPASS_MOT{_digit}_{_axis}": 4.0 * (1 - _k),
        }
for _axis in "XYZ":
    WRONG_ARDUPILOT |= {f"INS_TCAL1_{s}1_{_axis}": v for s, v in (("ACC", 6000.0), ("GYR", 300.0))}
    WRONG_ARDUPILOT |= {f"INS_TCAL1_{s}2_{_axis}": v for s, v in (("ACC", 80.0), ("GYR", -5.0))}
WRONG_ARDUPILOT |= {"INS_TCAL1_ENABLE": 1, "INS_TCAL1_TMIN": 10, "INS_TCAL1_TMAX": 60}

WRONG_PX4: dict[str, float] = {"SENS_BOARD_X_OFF": 3.0, "SENS_BOARD_Y_OFF": -2.0, "IMU_GYRO_CAL_EN": 0}
for _n in "012":
    for _k, _axis in enumerate("XYZ"):
        WRONG_PX4 |= {
            f"CAL_ACC{_n}_{_axis}OFF": 0.3 - 0.2 * _k,
            f"CAL_ACC{_n}_{_axis}SCALE": 1.003 if _n == "1" else 0.97 + 0.02 * _k,  # 1: never reaches memory
            f"CAL_GYRO{_n}_{_axis}OFF": -0.02 + 0.015 * _k,
        }


class Wire:
    """Hands frames to a simulated vehicle and keeps what it says."""

    def __init__(self, **config: Any) -> None:
        self.vehicle: FlightController = make_vehicle(load_config(config))
        self.said: list[bytes] = []
        self.vehicle.channels.append(Link(Packer(1), self.said.append))
        self.vehicle.start()
        self.run(6.0)

    def run(self, seconds: float) -> None:
        end = self.vehicle.time + seconds
        while self.vehicle.time < end:
            self.vehicle.advance(self.vehicle.time + STEP)

    def ask(self, message: Any) -> None:
        for received in split_datagram(encode(message, 253, 190, 0)):
            self.vehicle.receive(self.vehicle.channels[0], received)

    def capture(self, autopilot: str) -> list[tuple[int | None, Frame]]:
        self.ask(dialect.MAVLink_param_request_list_message(1, 1))
        self.run(4.0)
        for message_id, rate in requested_streams(autopilot, {Sensor.ACCEL, Sensor.MAG}).items():
            self.ask(dialect.MAVLink_command_long_message(1, 1, 511, 0, message_id, 1e6 / rate, 0, 0, 0, 0, 0))
        self.run(SECONDS)
        return [(None, frame) for data in self.said for frame in FrameParser().feed(data)]


def expected(entry: dict[str, Any], true: np.ndarray, degrees: np.ndarray) -> np.ndarray:
    """raw = matrix true + offset + polynomial(T - 35), all in the sensor's frame; shape (N, 3)."""
    d = degrees[:, None] - 35.0
    c = np.array(entry["polynomial"])
    return np.asarray(np.array(entry["matrix"]) @ true + entry["offset"] + d * (c[:, 0] + d * (c[:, 1] + d * c[:, 2])))


def assert_truth(
    channel: Channel, entry: dict[str, Any], true: np.ndarray, degrees: Channel | None, slack: float
) -> None:
    at = np.full(len(channel), 35.0)
    if degrees is not None:
        at = degrees.values[np.searchsorted(degrees.t, channel.t, side="right") - 1, 0]
    error = (channel.values - expected(entry, true, at)).mean(axis=0)
    sd = np.hypot(entry["noise"], channel.quantum / np.sqrt(12)) / np.sqrt(len(channel))
    assert np.abs(error).max() < 4.5 * sd + slack, (channel.key, error, sd)


def inertial(raw: Recording, truth: dict[str, Any], board: np.ndarray, gravity: float) -> int:
    count = 0
    for channel in raw.channels:
        if channel.stage != Stage.RAW or channel.sensor not in (Sensor.ACCEL, Sensor.GYRO):
            continue
        true = board.T @ [0, 0, -gravity] if channel.sensor == Sensor.ACCEL else np.zeros(3)
        entry = truth["accels" if channel.sensor == Sensor.ACCEL else "gyros"][channel.instance]
        slack = 2e-4 if channel.sensor == Sensor.ACCEL else 2e-5  # a temperature that is a step behind
        assert_truth(channel, entry, true, raw.find(Sensor.TEMPERATURE, channel.instance)[0], slack)
        count += 1
    return count


@pytest.mark.parametrize("board", [0, 2])
def test_ardupilot(board: int, turn: Callable[[int], np.ndarray]) -> None:
    wire = Wire(
        autopilot="ardupilot",
        parameters=WRONG_ARDUPILOT,
        board_orientation=board,
        temperature=41.0,
        mag_orientations=[board, 6],
    )
    wire.vehicle.world.current.go(wire.vehicle.time, AMPERES)
    raw = undo(Assembler(Identity(autopilot="ardupilot", system=1, component=1)).feed(wire.capture("ardupilot")))
    assert not [e.text for e in raw.events if e.kind == "undo"]
    truth = truth_report(wire.vehicle)
    assert inertial(raw, truth, turn(board), truth["gravity"]) == 8  # three units and HIGHRES_IMU, two sensors each
    for instance, streams in ((0, 2), (1, 1)):
        assert len(raw.find(Sensor.MAG, instance)) == streams
        for channel in raw.find(Sensor.MAG, instance):
            assert channel.stage == Stage.RAW
            entry = truth["mags"][instance]
            true = turn(entry["orientation"]).T @ truth["field_ned_ut"]
            entry = entry | {"offset": np.array(entry["offset"]) + AMPERES * np.array(entry["motor"])}
            assert_truth(channel, entry, true, None, 0.05)


def test_px4() -> None:
    wire = Wire(autopilot="px4", parameters=WRONG_PX4, temperature=41.0)
    frames = wire.capture("px4")
    identity = Identity(autopilot="px4", system=1, component=1)
    raw = undo(Assembler(identity).feed(frames))
    assert not [e.text for e in raw.events if e.kind == "undo"]
    truth = truth_report(wire.vehicle)
    assert inertial(raw, truth, np.eye(3), truth["gravity"]) == 6
    assembler, live = Assembler(identity), Undo(identity)
    pieces = join(live.feed(assembler.feed(frames[i : i + 50])) for i in range(0, len(frames), 50))
    for channel in raw.channels:
        (same,) = [c for c in pieces.channels if c.key == channel.key]
        assert np.array_equal(same.values, channel.values)


@pytest.fixture
def turn() -> Callable[[int], np.ndarray]:
    """The rotations that this test uses, by number, written out."""
    matrices = {
        0: np.eye(3),
        2: np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]),  # yaw 90
        6: np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]),  # yaw 270
    }
    return lambda number: matrices[number]
