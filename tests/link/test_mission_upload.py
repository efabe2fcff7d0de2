"""A log's mission given to the flying vehicle and flown: lost questions, refusals, and a vehicle that stands still."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.calib.logs.missions import LoggedMission, MissionItem, Place, read_mission, with_take_off
from mavcal.service.closing.conversation import Conversation
from mavcal.service.closing.errors import MissionLeft, MissionRefused
from mavcal.service.closing.follower import Follower
from mavcal.service.closing.link import VehicleLink
from mavcal.service.closing.logged import LogMission
from mavcal.service.closing.upload import Upload
from mavcal.service.link import parse_endpoint
from mavcal.service.simvehicle.flight.flightlog import FlightLog
from mavcal.service.simvehicle.flight.frame import frame_of
from mavcal.service.simvehicle.flight.ground import GroundLink
from mavcal.service.simvehicle.flight.parameters import FlightParameters
from mavcal.service.simvehicle.flight.vehicle import FlyingVehicle
from mavcal.service.simvehicle.links import TcpServer
from mavcal.service.simvehicle.wire import message_id_of

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


@contextmanager
def talking(
    log: Path, lost: Callable[[int, int], bool] = lambda *_: False, frame: Mapping[str, Any] | None = None
) -> Iterator[tuple[Conversation, LosingServer]]:
    """A conversation with a vehicle that flies in a thread, as fast as it may."""
    server, end = LosingServer(lost), threading.Event()
    vehicle = FlyingVehicle(frame_of(frame or {}), FlightParameters(), FlightLog(log), seed=5)
    ground = GroundLink(vehicle, server)

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
    monkeypatch.setattr("mavcal.service.closing.upload.TRIES", 2)
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
    mission = with_take_off(LoggedMission(HOME, items))
    follower = Follower(talk, LogMission(mission, rest_s=0.5, rest_after_s=0.5))
    follower.fly()
    return follower


@pytest.mark.parametrize("items", [ITEMS, ITEMS[:2]], ids=["lands itself", "is landed"])
def test_the_mission_is_flown_from_take_off_to_landing(tmp_path: Path, items: tuple[MissionItem, ...]) -> None:
    with talking(tmp_path / "x.bin") as (talk, _):
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
