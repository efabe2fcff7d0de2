from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from typing import Any, cast

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.calib.wire.codec import encode
from mavcal.calib.wire.frames import FrameParser
from mavcal.service.errors import LinkDown, VehicleConflict, VehicleUnknown
from mavcal.service.link.link import Link
from mavcal.service.link.types import Batch, LinkEvent, LinkEventKind
from mavcal.service.vehicle.events import VehicleEventKind
from mavcal.service.vehicle.registry import VehicleRegistry
from tests.clock import ManualClock
from tests.unit.vehicle.fake import FakeLink, ack, heartbeat, param_value, real, version


class Air(FakeLink):
    """A link on which a test speaks with any ids."""

    def __init__(self, name: str = "air") -> None:
        super().__init__()
        self.id = name
        self.taken: list[Callable[[Batch], None]] = []
        self.told: list[Callable[[LinkEvent], None]] = []

    def subscribe(self, callback: Any, _ids: object = None) -> Callable[[], None]:
        self.taken.append(callback)
        return lambda: self.taken.remove(callback)

    def subscribe_events(self, callback: Any) -> Callable[[], None]:
        self.told.append(callback)
        return lambda: self.told.remove(callback)

    def send(self, message: Any, _target: object = None) -> None:
        self.sent.append(message)

    def say(self, message: Any, system: int = 1, component: int = 1, at: float = 0.0) -> None:
        frames = FrameParser().feed(encode(message, system, component, 0))
        for callback in list(self.taken):
            callback(Batch(tuple(frames), at, 0, 0))


@pytest.fixture
async def registry() -> AsyncIterator[VehicleRegistry]:
    made = VehicleRegistry(clock=ManualClock(1000.0))
    yield made
    made.close()


def attached(registry: VehicleRegistry, name: str = "air") -> Air:
    air = Air(name)
    registry.attach(cast(Link, air))
    return air


async def test_only_autopilots_are_vehicles(registry: VehicleRegistry) -> None:
    air = attached(registry)
    air.say(dialect.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3), 255, 190)  # a ground station
    air.say(dialect.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3), 1, 191)  # a companion
    air.say(dialect.MAVLink_heartbeat_message(26, 3, 0, 0, 4, 3), 1, 154)  # a gimbal that names an autopilot
    air.say(dialect.MAVLink_heartbeat_message(6, 0, 0, 0, 4, 3), 254, 1)  # a ground station as component 1
    air.say(dialect.MAVLink_attitude_message(0, 0, 0, 0, 0, 0, 0), 7, 1)  # nobody has said what that is
    assert registry.all() == ()
    air.say(heartbeat(), 1, 1)
    air.say(heartbeat(12), 2, 1)
    assert [(v.system, v.component) for v in registry.all()] == [(1, 1), (2, 1)]


async def test_a_vehicle_is_named_by_its_place_until_its_unique_id_is_known(registry: VehicleRegistry) -> None:
    air = attached(registry)
    air.say(heartbeat())
    (vehicle,) = registry.all()
    assert vehicle.id == "air-1-1"
    air.say(version(uid2=b"\xab\xcd"))
    assert vehicle.id == "uid-abcd"
    assert registry.get("uid-abcd") is registry.get("air-1-1") is vehicle
    with pytest.raises(VehicleUnknown, match=r"uid-abcd\."):
        registry.get("uid-ffff")


async def test_two_unique_ids_behind_one_system_id_forbid_writing(registry: VehicleRegistry) -> None:
    events: list[VehicleEventKind] = []
    registry.subscribe(lambda event: events.append(event.kind))
    air = attached(registry)
    air.say(heartbeat())
    air.say(version(uid2=b"\x01"))
    air.say(version(uid2=b"\x01"))
    (vehicle,) = registry.all()
    assert vehicle.conflicts == ()
    air.say(version(uid2=b"\x02"), at=vehicle.clock())
    assert "01 and 02" in vehicle.conflicts[0]
    assert vehicle.identity.uid2 == "01"
    with pytest.raises(VehicleConflict):
        _only_conflict(vehicle)
    await asyncio.sleep(0)
    assert events.count(VehicleEventKind.CONFLICT) == 1


async def test_a_unit_that_is_gone_gives_way_to_another_of_the_same_system_id(registry: VehicleRegistry) -> None:
    events: list[tuple[VehicleEventKind, str]] = []
    registry.subscribe(lambda event: events.append((event.kind, event.text)))
    air = attached(registry)
    air.say(heartbeat())
    air.say(version(uid2=b"\x01"))
    (first,) = registry.all()
    air.say(param_value("ONLY_OF_THE_FIRST", real(1.0)))
    asking = asyncio.ensure_future(first.parameters.read("X"))
    await asyncio.sleep(0)
    clock = cast(ManualClock, first.clock)
    clock.now += 20.0
    air.say(heartbeat(), at=clock.now)
    air.say(version(uid2=b"\x02"), at=clock.now)  # it may still be there, and have missed the question
    assert registry.all() == (first,)
    assert "01 and 02" in first.conflicts[0]
    clock.now += 11.0
    air.say(version(uid2=b"\x02"), at=clock.now)
    (second,) = registry.all()
    assert (second.id, second.identity.uid2, second.conflicts) == ("uid-02", "02", ())
    assert len(second.parameters) == 0
    with pytest.raises(VehicleUnknown):
        registry.get("uid-01")
    with pytest.raises(VehicleConflict, match="02"):
        await asking
    air.sent.clear()
    with pytest.raises(VehicleConflict):
        await first.parameters.read("X")
    with pytest.raises(VehicleConflict):
        await first.command(511, (27, 20000))
    assert air.sent == []
    assert not first.writable().ok
    await asyncio.sleep(0)
    (said,) = [text for kind, text in events if kind is VehicleEventKind.REPLACED]
    assert said == "Another unit (02) answers to system id 1 now; 01 was not heard for 30 s."
    clock.now += 40.0
    air.say(version(uid2=b"\x01"), at=clock.now)  # the first one is plugged in again
    assert [v.id for v in registry.all()] == ["uid-01"]


async def test_two_units_that_are_both_there_stay_a_conflict(registry: VehicleRegistry) -> None:
    air = attached(registry)
    air.say(heartbeat())
    air.say(version(uid2=b"\x01"))
    (first,) = registry.all()
    clock = cast(ManualClock, first.clock)
    for _ in range(20):
        clock.now += 5.0
        air.say(version(uid2=b"\x01"), at=clock.now)
        air.say(version(uid2=b"\x02"), at=clock.now)
    assert registry.all() == (first,)
    assert "01 and 02" in first.conflicts[0]


def _only_conflict(vehicle: Any) -> None:
    """Everything else is fine with this vehicle."""
    now = vehicle.clock()
    for seconds in (4.0, 3.0, 2.0, 1.0, 0.0):
        frames = FrameParser().feed(
            encode(heartbeat(), 1, 1, 0) + encode(dialect.MAVLink_extended_sys_state_message(0, 1), 1, 1, 1)
        )
        vehicle.feed(frames, Batch(tuple(frames), now - seconds, 0, 0))
    vehicle.require_writable()


async def test_our_own_ids_heard_from_elsewhere_forbid_writing_to_anybody(registry: VehicleRegistry) -> None:
    air = attached(registry)
    air.say(heartbeat(), 1)
    air.say(heartbeat(), 2)
    for told in air.told:
        told(LinkEvent(LinkEventKind.OWN_IDS_HEARD, "our ids", 253, 190))
    assert [v.conflicts for v in registry.all()] == [("our ids",)] * 2


async def test_an_event_of_a_link_reaches_only_the_vehicles_on_it(registry: VehicleRegistry) -> None:
    airs = {name: attached(registry, name) for name in ("one", "two")}
    for system, air in enumerate(airs.values(), start=1):
        air.say(heartbeat(), system)
    for kind, text in (
        (LinkEventKind.OWN_IDS_HEARD, "our ids"),
        (LinkEventKind.DUPLICATE_SYSTEM, "two systems"),
    ):
        for told in airs["one"].told:
            told(LinkEvent(kind, text, 1, 1))
    doubts = {vehicle.link.id: vehicle.conflicts for vehicle in registry.all()}
    assert doubts == {"one": ("our ids", "two systems"), "two": ()}


async def test_a_closed_link_takes_its_vehicles_with_it(registry: VehicleRegistry) -> None:
    air = attached(registry)
    other = attached(registry, "other")
    air.say(heartbeat())
    other.say(heartbeat())
    vehicle = registry.get("air-1-1")
    asking = asyncio.ensure_future(vehicle.parameters.read("A"))
    await asyncio.sleep(0)
    registry.detach(cast(Link, air))
    with pytest.raises(LinkDown, match="air was closed"):
        await asking
    assert [v.id for v in registry.all()] == ["other-1-1"]
    assert air.taken == []
    assert air.told == []


async def test_an_unsubscribed_listener_hears_no_more(registry: VehicleRegistry) -> None:
    heard: list[Any] = []
    forget = registry.subscribe(heard.append)
    air = attached(registry)
    air.say(heartbeat())
    await asyncio.sleep(0)
    count = len(heard)
    assert count
    air.say(heartbeat(armed=True))
    forget()
    await asyncio.sleep(0)
    assert len(heard) == count


async def test_jobs_get_only_the_frames_that_they_asked_for(registry: VehicleRegistry) -> None:
    air = attached(registry)
    air.say(heartbeat())
    (vehicle,) = registry.all()
    heard: list[int] = []
    forget = vehicle.subscribe(frozenset({30}), lambda frames, _batch: heard.extend(f.message_id for f in frames))
    attitude = dialect.MAVLink_attitude_message(0, 0, 0, 0, 0, 0, 0)
    air.say(attitude)
    air.say(ack(1, 0))
    air.say(attitude, 2)
    await asyncio.sleep(0)
    assert heard == [30]
    forget()
    air.say(attitude)
    await asyncio.sleep(0)
    assert heard == [30]


async def test_a_vehicle_that_restarts_is_asked_who_it_is(registry: VehicleRegistry) -> None:
    air = attached(registry)
    air.say(heartbeat())
    await asyncio.sleep(0)
    air.say(version(uid2=b"\xab\xcd"))
    for _ in range(20):
        await asyncio.sleep(0)
    air.say(dialect.MAVLink_system_time_message(0, 100_000))
    air.sent.clear()
    for k in range(3):
        air.say(dialect.MAVLink_system_time_message(0, 2000 + 1000 * k))
    for _ in range(5):
        await asyncio.sleep(0)
    asked = [message.param1 for message in air.sent if message.get_type() == "COMMAND_LONG"]
    assert dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION in asked


async def test_a_vehicle_that_has_no_unique_id_keeps_the_name_of_its_place(registry: VehicleRegistry) -> None:
    air = attached(registry)
    air.say(heartbeat())
    air.say(version(uid2=b""))
    (vehicle,) = registry.all()
    assert vehicle.identity.known
    assert vehicle.id == "air-1-1"
