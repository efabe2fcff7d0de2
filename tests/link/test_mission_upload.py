"""A log's mission given to the flying vehicle and flown: lost questions, refusals, and a vehicle that stands still."""

from __future__ import annotations

import math
import threading
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.calib.logs.missions.course import Place, with_take_off
from mavcal.calib.logs.missions.items import LoggedMission, MissionItem
from mavcal.calib.logs.missions.reading import read_mission
from mavcal.service.closing.conversation import Conversation
from mavcal.service.closing.errors import MissionLeft, MissionRefused
from mavcal.service.closing.follower import Follower, Upload
from mavcal.service.closing.link import VehicleLink
from mavcal.service.closing.mission import LogMission
from mavcal.service.link.endpoint import parse_endpoint
from mavcal.service.simvehicle.flight.flightlog import FlightLog
from mavcal.service.simvehicle.flight.frame import frame_of
from mavcal.service.simvehicle.flight.ground import GroundLink
from mavcal.service.simvehicle.flight.items import MissionState
from mavcal.service.simvehicle.flight.modes import Mode
from mavcal.service.simvehicle.flight.parameters import FlightParameters
from mavcal.service.simvehicle.flight.vehicle import FlyingVehicle
from mavcal.service.simvehicle.links import TcpServer
from mavcal.service.simvehicle.wire import Received, message_id_of

pytestmark = pytest.mark.timeout(120)
AT = Place(47.0, 8.0, 400.0)
REQUEST, ACK = dialect.MAVLINK_MSG_ID_MISSION_REQUEST, dialect.MAVLINK_MSG_ID_MISSION_ACK


def item(number: int, command: int, altitude: float = 0.0, *p: float, north: float = 0.0) -> MissionItem:
    first, second, third, fourth = (*p, *(0.0,) * (4 - len(p)))
    place = AT.at(north, 5.0) if north else (0.0, 0.0)
    return MissionItem(number, command, 3, (first, second, third, fourth), *place, altitude)


HOME = MissionItem(0, 16, 0, latitude=AT.latitude, longitude=AT.longitude, altitude=AT.altitude)
ITEMS = (item(1, 16, 4.0, north=10.0), item(2, 19, 5.0, 2.0, north=10.0), item(3, 21))


class LosingServer(TcpServer):
    """A port that loses what `lost` says of an id and how many of it were sent before."""

    def __init__(self, lost: Callable[[int, int], bool]) -> None:
        super().__init__("127.0.0.1:0")
        self._lost = lost
        self.sent: Counter[int] = Counter()

    def send(self, frame: bytes) -> None:
        number = message_id_of(frame)
        self.sent[number] += 1
        if not self._lost(number, self.sent[number] - 1):
            super().send(frame)


MISSION_MODE, HOLD_MODE = 4 << 16 | 4 << 24, 4 << 16 | 3 << 24


class AsPx4(GroundLink):
    """Has PX4's numbers and its way to begin: items count from 0 without home, and arming begins the mission."""

    def _handle(self, received: Received) -> None:
        m = received.message
        if received.name == "MISSION_COUNT":
            m.count += 1
        elif received.name == "MISSION_ITEM_INT":
            m.seq, m.param4 = m.seq + 1, 0.0 if math.isnan(m.param4) else m.param4
        elif received.name == "COMMAND_LONG" and m.command == dialect.MAV_CMD_DO_SET_MODE:
            assert (m.param2, m.param3) == (4, 4)
            m.param2 = Mode.GUIDED
        super()._handle(received)
        if received.name == "COMMAND_LONG" and m.command == dialect.MAV_CMD_COMPONENT_ARM_DISARM and m.param1:
            self._vehicle.start_mission()

    def _send(self, message: Any) -> None:
        name = message.get_type()
        if name == "MISSION_REQUEST" and message.seq == 0:  # home, which a ground station does not give it
            head = (1, 1, 0, dialect.MAV_FRAME_GLOBAL, 16, 0, 1, 0.0, 0.0, 0.0, 0.0)
            at = self._home()
            home = dialect.MAVLink_mission_item_int_message(*head, at.latitude, at.longitude, 1e-3 * at.altitude)
            self._mission.handle(Received(home, b"", message.target_system, message.target_component))
            return
        if name in ("MISSION_REQUEST", "MISSION_ITEM_REACHED"):
            message.seq -= 1
        elif name == "MISSION_CURRENT":
            message.seq = max(message.seq - 1, 0)
        super()._send(message)

    def _heartbeat(self) -> Any:
        beat = super()._heartbeat()
        vehicle = self._vehicle
        over = vehicle.auto.state is MissionState.COMPLETE
        beat.autopilot, beat.custom_mode = dialect.MAV_AUTOPILOT_PX4, HOLD_MODE if over else MISSION_MODE
        return beat


@contextmanager
def talking(
    log: Path,
    lost: Callable[[int, int], bool] = lambda *_: False,
    frame: Mapping[str, Any] | None = None,
    kind: type[GroundLink] = GroundLink,
) -> Iterator[tuple[Conversation, LosingServer]]:
    """A conversation with a vehicle that flies in a thread, as fast as it may."""
    server, end = LosingServer(lost), threading.Event()
    vehicle = FlyingVehicle(frame_of(frame or {}), FlightParameters(), FlightLog(log), seed=5)
    ground = kind(vehicle, server)

    def live() -> None:
        while not end.is_set():
            for _ in range(8 if ground.heard else 0):
                vehicle.loop()
                ground.send_due()
            ground.poll()

    thread = threading.Thread(target=live)
    thread.start()
    try:
        with VehicleLink(parse_endpoint(server.url)) as link:
            link.connect(30.0, lambda: None)
            conversation = Conversation(link, lambda: None, lambda *_: None)
            yield conversation, server
    finally:
        end.set()
        thread.join()
        vehicle.close()
        server.close()


def uploaded(conversation: Conversation, *items: MissionItem) -> None:
    conversation.begin()
    Upload(conversation, (HOME, item(-1, 22, 4.0), *items)).run()


def test_the_vehicle_has_what_it_was_given(tmp_path: Path) -> None:
    with talking(tmp_path / "x.bin") as (conversation, server):
        uploaded(conversation, *ITEMS)
        assert server.sent[REQUEST] == 5
    assert read_mission(tmp_path / "x.bin").items[1:] == tuple(
        MissionItem(n, i.command, 3, i.parameters, pytest.approx(i.latitude, abs=1e-7),  # type: ignore[arg-type]
                    pytest.approx(i.longitude, abs=1e-7), i.altitude)
        for n, i in enumerate(ITEMS, start=2)
    )  # fmt: skip


@pytest.mark.parametrize("which", [0, 2, 4])
def test_a_question_that_was_lost_is_asked_again(tmp_path: Path, which: int) -> None:
    with talking(tmp_path / "x.bin", lambda number, before: number == REQUEST and before == which) as (talk, server):
        uploaded(talk, *ITEMS)
        assert server.sent[REQUEST] >= 6
    assert len(read_mission(tmp_path / "x.bin").items) == 4


def test_an_answer_that_was_lost_is_given_by_another_upload(tmp_path: Path) -> None:
    with talking(tmp_path / "x.bin", lambda number, before: number == ACK and before == 0) as (talk, server):
        uploaded(talk, *ITEMS)
        assert server.sent[ACK] == 2


def test_a_vehicle_that_asks_for_nothing_is_given_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mavcal.service.closing.follower.TRIES", 2)
    with (
        talking(tmp_path / "x.bin", lambda number, _before: number in (REQUEST, ACK)) as (talk, _),
        pytest.raises(MissionRefused, match=r"in 2 uploads: it asked for 0 of 5 items.*--mission standard"),
    ):
        uploaded(talk, *ITEMS)


def test_a_refused_item_is_named(tmp_path: Path) -> None:
    turns = item(7, 18, 5.0, 1.0, north=5.0)  # ArduCopter flies circles; this vehicle does not
    with (
        talking(tmp_path / "x.bin") as (talk, _),
        pytest.raises(MissionRefused, match=r"at item 7 \(LOITER_TURNS\) of the log \(MAV_MISSION_UNSUPPORTED\)"),
    ):
        uploaded(talk, ITEMS[0], turns)


def flown(talk: Conversation, *items: MissionItem) -> Follower:
    mission = with_take_off(LoggedMission(HOME, items, talk.way.name))
    follower = Follower(talk, LogMission(mission, rest_s=0.5, rest_after_s=0.5))
    follower.fly()
    return follower


@pytest.mark.parametrize("items", [ITEMS, ITEMS[:2]], ids=["lands itself", "is landed"])
@pytest.mark.parametrize("kind", [GroundLink, AsPx4])
def test_the_mission_is_flown_from_take_off_to_landing(
    tmp_path: Path, items: tuple[MissionItem, ...], kind: type[GroundLink]
) -> None:
    with talking(tmp_path / "x.bin", kind=kind) as (talk, _):
        flown(talk, *items)
        assert not talk.state.armed
    logged = read_mission(tmp_path / "x.bin")
    assert logged.home.altitude == 584.0
    home = Place(logged.home.latitude, logged.home.longitude, 584.0)
    assert home.offset(logged.items[1].latitude, logged.items[1].longitude) == pytest.approx((10.0, 5.0), abs=0.05)


def test_a_vehicle_that_stands_still_is_named_with_its_item(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mavcal.service.closing.follower.LONGER", 0.0)
    monkeypatch.setattr("mavcal.service.closing.follower.MORE_S", 10.0)
    with (
        talking(tmp_path / "x.bin") as (talk, _),
        pytest.raises(
            MissionLeft, match=r"has flown item 2 \(DELAY\) for 10 s.*10 s are the most. It is at [34]\.\d m"
        ),
    ):
        flown(talk, item(1, 22, 4.0), item(2, 93, 0.0, 60.0), ITEMS[2])


def test_a_vehicle_that_cannot_lift_itself_is_named(tmp_path: Path) -> None:
    with (
        talking(tmp_path / "x.bin", frame={"hoverThrOut": 1.3}) as (talk, _),
        pytest.raises(MissionLeft, match=r"30 s after the mission's start.*Can it carry its weight"),
    ):
        flown(talk, *ITEMS)
