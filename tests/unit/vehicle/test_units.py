"""One board on several links is one vehicle; two boards on two links are two."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Sequence
from typing import Any, cast

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.calib.wire.codec import decode, encode, param_bytes, raw_message
from mavcal.calib.wire.frames import Frame, FrameParser
from mavcal.service.errors import LinkDown
from mavcal.service.link.link import Link
from mavcal.service.link.types import Batch, LinkEvent
from mavcal.service.vehicle.events import VehicleEventKind
from mavcal.service.vehicle.registry import VehicleRegistry
from mavcal.service.vehicle.vehicle import Vehicle
from tests.clock import ManualClock
from tests.unit.vehicle.fake import FakeLink, heartbeat, landed, param_value, real, version

STEP_S = 0.25
ATTITUDE = dialect.MAVLINK_MSG_ID_ATTITUDE


class Air(FakeLink):
    """A link on which boards speak."""

    def __init__(self, name: str, clock: ManualClock) -> None:
        super().__init__()
        self.id = name
        self.clock = clock
        self.down = False
        self._taken: list[Callable[[Batch], None]] = []
        self.boards: list[Board] = []

    def subscribe(self, callback: Any, _ids: object = None) -> Callable[[], None]:
        self._taken.append(callback)
        return lambda: self._taken.remove(callback)

    def subscribe_events(self, _callback: Callable[[LinkEvent], None]) -> Callable[[], None]:
        return lambda: None

    async def caught_up(self) -> None:
        if self.down:
            raise LinkDown("it is cut")
        await asyncio.sleep(0)

    def send(self, message: Any, _target: object = None) -> None:
        if self.down:
            raise LinkDown("it is cut")
        (frame,) = FrameParser().feed(encode(raw_message(message), 253, 190, 0))
        decoded = decode(frame)
        self.sent.append(decoded)
        for board in self.boards:
            board.told(self, frame, decoded)

    def say(self, message: Any) -> None:
        if not self.down:
            frames = FrameParser().feed(encode(raw_message(message), 1, 1, 0))
            for callback in list(self._taken):
                callback(Batch(tuple(frames), self.clock.now, 0, 0))

    def sets(self) -> int:
        return len(self.sent_of("PARAM_SET"))


class Board:
    """An autopilot on one or more links: heartbeats and attitudes go out on each, an echo on all of them."""

    def __init__(self, *airs: Air, uid2: bytes = b"\x01", booted: float = 0.0, values: dict[str, float] | None = None):
        self.airs, self.uid2, self.booted = airs, uid2, booted
        self.values = dict(values or {"X": 1.0})
        self.deaf = False
        for air in airs:
            air.boards.append(self)

    def told(self, air: Air, frame: Frame, message: Any) -> None:
        loop = asyncio.get_running_loop()
        kind = message.get_type()
        if kind == "COMMAND_LONG" and message.command == 512 and message.param1 == 148:
            loop.call_soon(air.say, version(uid2=self.uid2))
        elif kind == "PARAM_REQUEST_READ" and message.param_id in self.values:
            loop.call_soon(air.say, param_value(message.param_id, real(self.values[message.param_id])))
        elif kind == "PARAM_SET" and not self.deaf:
            self.values[message.param_id] = message.param_value
            for every in self.airs:
                loop.call_soon(every.say, param_value(message.param_id, param_bytes(frame)))

    def speak(self, now: float) -> None:
        for air in self.airs:
            air.say(heartbeat())
            air.say(landed())
            air.say(dialect.MAVLink_attitude_message(int((now - self.booted) * 1000), 0, 0, 0, 0, 0, 0))


class World:
    """Time, links and boards."""

    def __init__(self) -> None:
        self.clock = ManualClock(1000.0)
        self.registry = VehicleRegistry(clock=self.clock)
        self.boards: list[Board] = []
        self.events: list[tuple[VehicleEventKind, str]] = []
        self.registry.subscribe(lambda event: self.events.append((event.kind, event.text)))

    def air(self, name: str, endpoint: str = "") -> Air:
        air = Air(name, self.clock)
        if endpoint:
            from mavcal.service.link.endpoint import parse_endpoint

            air.endpoint = parse_endpoint(endpoint)
        self.registry.attach(cast(Link, air))
        return air

    def board(self, *airs: Air, **options: Any) -> Board:
        made = Board(*airs, **options)
        self.boards.append(made)
        return made

    async def live(self, seconds: float) -> None:
        for _ in range(int(seconds / STEP_S)):
            self.clock.now += STEP_S
            for board in self.boards:
                board.speak(self.clock.now)
            for vehicle in self.registry._units():
                vehicle.tick()
            for _ in range(8):
                await asyncio.sleep(0)

    async def done(self, work: Any, limit: float = 60.0) -> Any:
        task = asyncio.ensure_future(work)
        until = self.clock.now + limit
        while not task.done():
            assert self.clock.now < until, "it never ends"
            await self.live(STEP_S)
        return task.result()

    def only(self) -> Vehicle:
        (vehicle,) = self.registry.all()
        return vehicle


@pytest.fixture
async def world() -> AsyncIterator[World]:
    made = World()
    yield made
    made.registry.close()


def ways(vehicle: Vehicle) -> list[str]:
    return [link.id for link in vehicle.links]


async def test_a_board_on_three_links_is_one_vehicle_with_three_links(world: World) -> None:
    airs = [world.air(name) for name in ("udp", "tcp", "serial")]
    world.board(*airs)
    await world.live(3.0)
    assert ways(world.only()) == ["udp", "tcp", "serial"]
    assert world.only().id == "uid-01"
    for air in airs:
        assert world.registry.get(f"{air.id}-1-1") is world.only()
    assert world.only().writable().ok


async def test_it_is_never_shown_twice_while_that_is_decided(world: World) -> None:
    one, two = world.air("one"), world.air("two")
    world.board(one, two)
    for _ in range(16):
        await world.live(STEP_S)
        assert len(world.registry.all()) == 1


async def test_a_link_that_comes_later_joins_the_vehicle(world: World) -> None:
    one = world.air("one")
    board = world.board(one)
    await world.live(3.0)
    vehicle = world.only()
    two = world.air("two")
    two.boards.append(board)
    board.airs = (one, two)
    await world.live(STEP_S)
    late = world.registry.get("two-1-1")
    assert late is not vehicle
    assert "not decided yet" in late.writable().reasons[-1]
    await world.live(2.0)
    assert world.only() is vehicle is late.unit
    assert (VehicleEventKind.LINKS, "It is heard over one, two.") in world.events


@pytest.mark.parametrize("same", [{"uid2": b"\x02"}, {"uid2": b"\x01", "booted": -30.0}])
async def test_two_boards_with_one_system_id_stay_two(world: World, same: dict[str, Any]) -> None:
    """By their unique ids; by their clocks where these are one, as those of copied images are."""
    one, two = world.air("one"), world.air("two")
    world.board(one)
    world.board(two, **same)
    await world.live(12.0)
    assert [ways(vehicle) for vehicle in world.registry.all()] == [["one"], ["two"]]
    assert [vehicle.writable().ok for vehicle in world.registry.all()] == [True, True]


BOARD = {"INS_ACC_ID": 3.0, "STAT_BOOTCNT": 12.0, "COMPASS_OFS_X": 17.5}


@pytest.mark.parametrize(
    ("other", "units"),
    [
        ({}, 1),
        ({"values": BOARD | {"STAT_BOOTCNT": 13.0}}, 2),
        ({"booted": -2.0}, 2),
    ],
)
async def test_without_a_unique_id_clock_and_parameters_tell(world: World, other: dict[str, Any], units: int) -> None:
    one, two = world.air("one"), world.air("two")
    common: dict[str, Any] = {"uid2": b"", "values": BOARD}
    if other:
        world.board(one, **common)
        world.board(two, **{**common, **other})
    else:
        world.board(one, two, **common)
    await world.live(60.0)
    assert len(world.registry.all()) == units


async def test_samples_count_once_and_heartbeats_from_every_link(world: World) -> None:
    one, two = world.air("one"), world.air("two")
    world.board(one, two)
    await world.live(3.0)
    got: list[Frame] = []

    def take(frames: Sequence[Frame], _batch: Batch) -> None:
        got.extend(frames)

    world.only().subscribe(frozenset({ATTITUDE}), take)
    await world.live(2.0)
    assert len(got) == 8
    one.down = True
    await world.live(6.0)
    vehicle = world.only()
    assert vehicle.way == "two"
    assert not vehicle.silent
    assert vehicle.state.silences == 0
    got.clear()
    await world.live(2.0)
    assert len(got) == 8
    one.down = False
    await world.live(2.0)
    assert world.only().way == "two"  # it stays: nothing was wrong with it
    assert vehicle.state.rebooted == 0


async def test_a_write_goes_on_over_the_other_link(world: World) -> None:
    one, two = world.air("one"), world.air("two")
    world.board(one, two)
    await world.live(6.0)
    vehicle = world.only()
    assert (await world.done(vehicle.parameters.set("X", 2.0))).sent == 1
    assert (one.sets(), two.sets()) == (1, 0)
    one.down = True
    echo = await world.done(vehicle.parameters.set("X", 3.0))
    assert (one.sets(), two.sets(), echo.parameter.value) == (1, 1, 3.0)
    assert vehicle.parameters["X"].value == 3.0


async def test_a_write_into_a_link_that_swallows_it_is_tried_over_the_next(world: World) -> None:
    one, two = world.air("one"), world.air("two")
    board = world.board(one, two)
    await world.live(6.0)
    vehicle = world.only()
    board.airs = (two,)  # nothing comes any more over the first link, and what is sent there is lost
    one.boards.clear()
    echo = await world.done(vehicle.parameters.set("X", 3.0))
    assert echo.parameter.value == 3.0
    assert vehicle.way == "two"
    assert two.sets() == 1
    assert one.sets() <= 3


async def test_an_echo_counts_over_whichever_link_it_comes(world: World) -> None:
    one, two = world.air("one"), world.air("two")
    board = world.board(one, two)
    await world.live(6.0)
    vehicle = world.only()
    await world.done(vehicle.parameters.read("X"))
    setting = asyncio.ensure_future(vehicle.parameters.set("X", 4.0))
    board.deaf = True
    await world.live(STEP_S)
    two.say(param_value("X", real(4.0)))
    assert (await world.done(setting)).sent == 1
    assert vehicle.parameters["X"].value == 4.0
    two.say(param_value("X", real(9.0)))  # late, and nobody waits for it
    assert vehicle.parameters["X"].value == 4.0


async def test_a_restart_that_two_links_show_is_one_restart(world: World) -> None:
    one, two = world.air("one"), world.air("two")
    board = world.board(one, two)
    await world.live(6.0)
    board.booted = world.clock.now
    await world.live(6.0)
    assert world.only().state.rebooted == 1
    one.down = True
    await world.live(5.0)
    assert world.only().state.rebooted == 1
    board.booted = world.clock.now
    await world.live(5.0)
    assert world.only().state.rebooted == 2
    one.down = False  # it has missed a restart
    await world.live(8.0)
    board.booted = world.clock.now
    await world.live(5.0)
    assert world.only().state.rebooted == 3
    assert sorted(ways(world.only())) == ["one", "two"]


async def test_a_link_that_is_closed_leaves_the_vehicle_to_the_others(world: World) -> None:
    one, two = world.air("one"), world.air("two")
    world.board(one, two)
    await world.live(6.0)
    vehicle = world.only()
    waiting = asyncio.ensure_future(vehicle.waits.sleep(2.0))
    await asyncio.sleep(0)
    world.registry.detach(cast(Link, one))
    assert ways(world.only()) == ["two"]
    await world.done(waiting)
    assert not vehicle.silent
    world.registry.detach(cast(Link, two))
    assert world.registry.all() == ()
    with pytest.raises(LinkDown):
        await vehicle.waits.sleep(1.0)


async def test_a_unit_that_is_plugged_in_behind_one_link_is_a_vehicle_of_its_own(world: World) -> None:
    one, two = world.air("one"), world.air("two")
    first = world.board(one, two)
    await world.live(6.0)
    first.airs = (one,)
    two.boards.clear()
    world.board(two, uid2=b"\x02", booted=900.0)
    await world.live(12.0)
    assert {vehicle.id: ways(vehicle) for vehicle in world.registry.all()} == {"uid-01": ["one"], "uid-02": ["two"]}


async def test_an_image_that_is_copied_and_started_later_parts_from_the_unit(world: World) -> None:
    """One unique id, but two clocks: what looked like one vehicle was two."""
    one, two = world.air("one"), world.air("two")
    world.board(one)
    copy = world.board(two)
    await world.live(6.0)
    assert len(world.registry.all()) == 1
    copy.booted = world.clock.now
    for _ in range(100):
        await world.live(STEP_S)
        world.registry._tick()
    assert [ways(vehicle) for vehicle in world.registry.all()] == [["one"], ["two"]]


async def test_the_link_that_carries_more_is_used(world: World) -> None:
    radio, cable = world.air("radio", "serial:/dev/ttyUSB0:57600"), world.air("cable", "tcp:127.0.0.1:5760")
    world.board(radio, cable)
    await world.live(4.0)
    assert ways(world.only()) == ["cable", "radio"]


async def test_a_board_without_a_unique_id_that_comes_back_on_its_first_link_is_one_again(world: World) -> None:
    one, two = world.air("one"), world.air("two")
    board = world.board(one, uid2=b"", values=BOARD)
    await world.live(4.0)
    one.down = True
    await world.live(20.0)
    two.boards.append(board)
    board.airs = (one, two)
    await world.live(20.0)
    assert len(world.registry.all()) == 2  # nothing can be compared with a silent one
    one.down = False
    await world.live(60.0)
    assert sorted(ways(world.only())) == ["one", "two"]
