"""Every fault of the simulated vehicle, on a server whose wire is a list and whose clock is the test's."""

from __future__ import annotations

import socket
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.service.simvehicle import ControlError, impairment
from mavcal.service.simvehicle.config import load_config
from mavcal.service.simvehicle.links import SimEndpoint
from mavcal.service.simvehicle.server import SimServer, make_vehicle
from mavcal.service.simvehicle.wire import Packer, Received, split_datagram
from tests.clock import ManualClock

TICK_S = 0.005
RAW_IMU, HIGHRES = 27, 105


class ListLink(SimEndpoint):
    """What the vehicle sends is kept, what the test puts is received."""

    url = "list"

    def __init__(self) -> None:
        self.sent: list[bytes] = []
        self.waiting: list[bytes] = []
        self.moves = 0

    def sockets(self) -> list[socket.socket]:
        return []

    def poll(self) -> Iterator[bytes]:
        waiting, self.waiting = self.waiting, []
        yield from waiting

    def messages(self, data: bytes) -> Iterator[Received]:
        return iter(split_datagram(data))

    def send(self, frame: bytes) -> None:
        self.sent.append(frame)

    def move(self) -> None:
        self.moves += 1

    def close(self) -> None:
        self.sent.clear()


class Rig:
    """A vehicle, its server, and a ground station's hands."""

    def __init__(self, autopilot: str, **config: Any) -> None:
        self.vehicle = make_vehicle(load_config({"autopilot": autopilot, "calibration": "none"} | config))
        self.link = ListLink()
        self.server = SimServer(self.vehicle, [self.link], 0, 1.0)
        self._packer = Packer(250, 190)
        self.vehicle.start()
        self.run(1.5)
        self.link.sent.clear()

    def fault(self, kind: str, trigger: Any = "now", **options: Any) -> None:
        self.server.injector.arm({"kind": kind, "trigger": trigger, **options})

    def send(self, message: Any) -> None:
        self.link.waiting.append(self._packer.pack(message))

    def set(self, name: str, value: float) -> None:
        self.send(dialect.MAVLink_param_set_message(1, 1, name.encode(), value, 9))

    def stream(self, message_id: int, interval_us: float = 20000) -> None:
        self.send(dialect.MAVLink_command_long_message(1, 1, 511, 0, message_id, interval_us, 0, 0, 0, 0, 0))

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds / TICK_S)):
            self.server._tick(TICK_S)

    def take(self, name: str | None = None) -> list[Any]:
        frames, self.link.sent[:] = list(self.link.sent), []
        messages = [r.message for f in frames for r in split_datagram(f)]
        return [m for m in messages if name is None or m.get_type() == name]


@pytest.fixture
def rig() -> Iterator[Callable[..., Rig]]:
    made: list[Rig] = []

    def build(autopilot: str = "ardupilot", **config: Any) -> Rig:
        made.append(Rig(autopilot, **config))
        return made[-1]

    yield build
    for one in made:
        one.server.close()


Build = Callable[..., Rig]


def streamed(r: Rig, seconds: float = 4.0) -> list[Any]:
    r.stream(RAW_IMU, 5000)
    r.run(0.05)
    r.take()
    r.run(seconds)
    return r.take("RAW_IMU")


def test_loss_takes_its_share_in_its_direction(rig: Build) -> None:
    r = rig()
    r.fault("loss", p=0.25, direction="out")
    assert len(streamed(r)) == pytest.approx(600, abs=60)
    r = rig()
    r.fault("loss", p=1.0, direction="in")
    assert streamed(r) == []


def test_duplication_repeats_frames(rig: Build) -> None:
    r = rig()
    r.fault("duplication", p=0.5, direction="out")
    stamps = [m.time_usec for m in streamed(r)]
    assert len(stamps) - len(set(stamps)) == pytest.approx(400, abs=60)


@pytest.fixture
def wall(monkeypatch: pytest.MonkeyPatch) -> ManualClock:
    """The wall's clock, by which frames are held back; it stands still until it is told to go on."""
    clock = ManualClock()
    monkeypatch.setattr(impairment.time, "monotonic", clock)
    return clock


def test_reordering_swaps_frames_and_loses_none(rig: Build, wall: ManualClock) -> None:
    r = rig()
    r.fault("reordering", p=0.2, direction="out")
    r.stream(RAW_IMU, 5000)
    r.run(0.05)
    wall.advance(0.06)
    r.run(TICK_S)
    r.take()
    for _ in range(20):
        r.run(0.05)
        wall.advance(0.05)
    stamps = [m.time_usec for m in r.take("RAW_IMU")]
    wall.advance(0.06)
    r.run(TICK_S)
    stamps += [m.time_usec for m in r.take("RAW_IMU")]
    assert len(stamps) == pytest.approx(200, abs=3)
    assert stamps != sorted(stamps)


def test_delay_holds_frames_back(rig: Build, wall: ManualClock) -> None:
    r = rig()
    r.fault("delay", delay_s=0.05, direction="out")
    r.stream(RAW_IMU, 5000)
    r.run(0.03)
    assert r.take() == []
    wall.advance(0.06)
    r.run(TICK_S)
    assert r.take("RAW_IMU")


@pytest.mark.parametrize("kind", ["bit_errors", "truncation"])
def test_damaged_frames_do_not_pass_their_checksum(rig: Build, kind: str) -> None:
    r = rig()
    r.fault(kind, p=0.5, direction="out")
    r.stream(RAW_IMU, 5000)
    r.run(0.05)
    r.take()
    r.run(2.0)
    sent = len(r.link.sent)
    assert sent == pytest.approx(400, abs=15)
    assert len(r.take("RAW_IMU")) == pytest.approx(200, abs=50)


def test_damaged_requests_are_ignored(rig: Build) -> None:
    r = rig()
    r.fault("bit_errors", p=1.0, direction="in")
    for _ in range(50):
        r.set("INS_ACCOFFS_X", 0.5)
    r.run(0.2)
    assert r.vehicle.table["INS_ACCOFFS_X"].value == 0.0


def test_faults_are_reproducible_by_seed(rig: Build) -> None:
    runs = []
    for _ in range(2):
        r = rig(seed=11)
        r.fault("loss", p=0.5, direction="out")
        runs.append([m.time_usec for m in streamed(r, 1.0)])
    assert runs[0] == runs[1]


def test_a_reboot_by_power_failure_loses_what_was_not_saved(rig: Build) -> None:
    r = rig(boot_s=0.2)
    r.fault("reboot", {"nth_set": 2})
    r.set("INS_ACCOFFS_X", 0.1)
    r.run(0.02)
    r.set("INS_ACCOFFS_Y", 0.2)
    r.run(0.1)
    assert not r.vehicle.alive
    r.run(0.5)
    assert r.vehicle.boots == 1
    assert [r.vehicle.table[f"INS_ACCOFFS_{a}"].value for a in "XY"] == [0.0, 0.0]


def test_silence_ends_by_itself(rig: Build) -> None:
    r = rig()
    r.stream(RAW_IMU)
    r.run(0.1)
    r.fault("silence", duration_s=1.0)
    r.take()
    r.run(0.9)
    assert r.take() == []
    r.run(0.3)
    assert r.take("RAW_IMU")


@pytest.mark.parametrize(("autopilot", "name"), [("ardupilot", "INS_ACCOFFS_Y"), ("px4", "CAL_ACC0_YOFF")])
def test_lost_and_late_echoes_concern_the_echo_only(rig: Build, autopilot: str, name: str) -> None:
    r = rig(autopilot)
    r.fault("lost_echo", name=name)
    r.set(name, 0.25)
    r.run(TICK_S * 2)
    assert r.take("PARAM_VALUE") == []
    assert r.vehicle.table[name].value == 0.25
    r.run(1.0)
    r.take()
    r.fault("late_echo", name=name, delay_s=1.0)
    r.set(name, 0.5)
    r.run(TICK_S)
    r.take()
    r.run(0.5)
    r.take()
    r.run(0.6)
    assert [m.param_value for m in r.take("PARAM_VALUE")] == [0.5]


@pytest.mark.parametrize(("autopilot", "name"), [("ardupilot", "INS_ACCOFFS_Z"), ("px4", "CAL_ACC0_ZOFF")])
def test_a_write_that_is_not_applied_reads_back_right_and_changes_no_stream(
    rig: Build, autopilot: str, name: str
) -> None:
    clean = {"offset": [0, 0, 0], "matrix": np.eye(3).tolist(), "polynomial": np.zeros((3, 3)).tolist()}
    r = rig(autopilot, accel_noise=0.0, truth={"accels": clean})
    r.fault("not_applied", {"nth_set": 1})
    r.set(name, 0.5)
    r.stream(26)
    r.run(0.5)
    messages = r.take()
    assert next(m.param_value for m in messages if m.get_type() == "PARAM_VALUE") == 0.5
    assert {m.zacc for m in messages if m.get_type() == "SCALED_IMU"} == {-1000}
    assert r.vehicle.in_force()[name] == 0.0
    assert r.vehicle.table[name].value == 0.5
    r.server.injector.clear()
    r.set(name, 0.5)
    r.run(0.2)
    assert r.vehicle.in_force()[name] == 0.5


@pytest.mark.parametrize(("autopilot", "name"), [("ardupilot", "INS_ACCOFFS_Y"), ("px4", "CAL_ACC0_YOFF")])
def test_another_ground_station_writes_after_ours(rig: Build, autopilot: str, name: str) -> None:
    r = rig(autopilot)
    r.fault("foreign_write", {"nth_set": 1}, name=name, value=0.75)
    r.set(name, 0.25)
    r.run(0.6)
    assert [m.param_value for m in r.take("PARAM_VALUE") if m.param_id == name][-1] == 0.75
    assert r.vehicle.table[name].value == 0.75


def test_arming_strikes_with_the_nth_write_and_is_seen_at_once(rig: Build) -> None:
    r = rig()
    r.fault("arm", {"nth_set": 2})
    r.set("INS_ACCOFFS_X", 0.1)
    r.run(0.05)
    assert not r.vehicle.armed
    r.set("INS_ACCOFFS_Y", 0.1)
    r.run(TICK_S)
    assert [m.base_mode for m in r.take("HEARTBEAT")] == [209]
    assert r.server.injector.report()[0]["struck"]


def test_an_onboard_calibration_begins_and_shows(rig: Build) -> None:
    r = rig()
    r.stream(dialect.MAVLINK_MSG_ID_MAG_CAL_PROGRESS, 100000)
    r.fault("onboard_calibration", {"after_s": 0.5})
    r.run(0.4)
    assert r.take("MAG_CAL_PROGRESS") == []
    r.run(0.6)
    assert r.take("MAG_CAL_PROGRESS")
    r = rig("px4")
    r.fault("onboard_calibration")
    r.run(1.5)
    messages = r.take()
    assert any("[cal]" in m.text for m in messages if m.get_type() == "STATUSTEXT")
    assert [m.system_status for m in messages if m.get_type() == "HEARTBEAT"][-1] == 2


def test_arming_and_onboard_calibration_may_end_by_themselves(rig: Build) -> None:
    r = rig("px4")
    r.fault("arm", duration_s=0.5)
    r.run(0.3)
    assert r.vehicle.armed
    r.run(0.3)
    assert not r.vehicle.armed
    r.fault("onboard_calibration", duration_s=0.5)
    r.run(0.3)
    assert r.vehicle.commands.calibrating
    r.run(0.3)
    assert not r.vehicle.commands.calibrating
    r.fault("onboard_calibration")
    r.server.injector.clear()
    assert not r.vehicle.commands.calibrating


def test_a_rival_may_write_later(rig: Build) -> None:
    r = rig()
    r.fault("foreign_write", {"nth_set": 1}, delay_s=0.5, value=0.75)
    r.set("INS_ACCOFFS_Y", 0.25)
    r.run(0.4)
    assert r.vehicle.table["INS_ACCOFFS_Y"].value == 0.25
    r.run(0.2)
    assert r.vehicle.table["INS_ACCOFFS_Y"].value == 0.75


def test_a_stuck_sensor_repeats_while_time_goes_on(rig: Build) -> None:
    r = rig()
    r.stream(RAW_IMU)
    r.run(0.3)
    r.take()
    r.fault("stuck", sensor="accel", instance=0)
    r.run(1.0)
    messages = r.take("RAW_IMU")[1:]
    assert len({(m.xacc, m.yacc, m.zacc) for m in messages}) == 1
    assert len({m.time_usec for m in messages}) == len(messages)


def test_a_sensor_that_is_not_a_number_shows_in_highres(rig: Build) -> None:
    r = rig()
    r.stream(HIGHRES)
    r.fault("nan", sensor="gyro", instance=0)
    r.run(0.3)
    last = r.take("HIGHRES_IMU")[-1]
    assert np.isnan([last.xgyro, last.ygyro, last.zgyro]).all()
    assert np.isfinite(last.xacc)


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_an_absent_accelerometer_reads_zero_beside_its_compass(rig: Build, autopilot: str) -> None:
    """PX4 sends SCALED_IMU2 whenever the unit or the compass has something new (FLIGHT_CONTROLLERS 2.2)."""
    r = rig(autopilot)
    r.stream(116)
    r.fault("absent", sensor="accel", instance=1)
    r.run(0.3)
    messages = r.take("SCALED_IMU2")
    assert messages[-1].zacc == 0


def test_a_twin_answers_with_another_identity(rig: Build) -> None:
    r = rig()
    r.fault("twin")
    r.run(0.5)
    r.take()
    r.send(dialect.MAVLink_command_long_message(1, 1, 512, 0, 148, 0, 0, 0, 0, 0, 0))
    r.run(0.1)
    identities = {tuple(m.uid2) for m in r.take("AUTOPILOT_VERSION")}
    assert len(identities) == 2
    r.server.injector.clear()
    r.send(dialect.MAVLink_command_long_message(1, 1, 512, 0, 148, 0, 0, 0, 0, 0, 0))
    r.run(0.1)
    assert len(r.take("AUTOPILOT_VERSION")) == 1


def test_a_peer_changes_its_address(rig: Build) -> None:
    r = rig()
    r.fault("move", {"time": r.vehicle.time + 0.1})
    r.run(0.05)
    assert r.link.moves == 0
    r.run(0.1)
    assert r.link.moves == 1


@pytest.mark.parametrize(
    ("request_", "reason"),
    [
        ({"kind": "loss", "p": 2}, "probability"),
        ({"kind": "loss", "direction": "up"}, "direction"),
        ({"kind": "not_applied"}, "name"),
        ({"kind": "not_applied", "name": "NO_SUCH"}, "NO_SUCH"),
        ({"kind": "foreign_write", "name": "NO_SUCH"}, "NO_SUCH"),
        ({"kind": "stuck", "sensor": "nose"}, "nose"),
        ({"kind": "reboot", "trigger": {"at": 3}}, "trigger"),
    ],
)
def test_a_fault_that_makes_no_sense_is_refused(rig: Build, request_: dict[str, Any], reason: str) -> None:
    r = rig()
    with pytest.raises(ControlError, match=reason):
        r.server.injector.arm(request_)
    r.run(0.1)
    assert r.server.injector.report() == []
