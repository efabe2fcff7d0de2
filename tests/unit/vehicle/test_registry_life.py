"""How a registry begins and ends: its clock, its questions, its listeners."""

from __future__ import annotations

import asyncio
import itertools
from typing import cast

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.service.errors import LinkDown
from mavcal.service.link.link import Link
from mavcal.service.vehicle.events import VehicleEvent, VehicleEventKind
from mavcal.service.vehicle.registry import IDLE_S, IDLE_TURNS, TICK_S, TOGETHER, VehicleRegistry
from tests.clock import ManualClock
from tests.unit.vehicle.fake import heartbeat, version
from tests.unit.vehicle.test_registry import Air, attached, registry

__all__ = ["registry"]


def asking(registry: VehicleRegistry) -> int:
    """Questions who a vehicle is that are under way."""
    return len(registry._identifying)


async def turns(count: int = 20) -> None:
    for _ in range(count):
        await asyncio.sleep(0)


async def test_the_clock_of_the_waits_runs_while_a_link_is_attached(registry: VehicleRegistry) -> None:
    one, other = attached(registry, "one"), attached(registry, "other")
    ticker = registry._ticker
    assert ticker is not None
    registry.detach(cast(Link, one))
    assert not ticker.cancelled()  # one link is still there
    registry.detach(cast(Link, other))
    assert ticker.cancelled()
    again = attached(registry, "one")
    ticker = registry._ticker
    assert ticker is not None
    assert again.taken
    registry.close()
    assert ticker.cancelled()
    assert (again.taken, again.told) == ([], [])


async def test_a_second_link_does_not_start_a_second_clock(registry: VehicleRegistry) -> None:
    attached(registry, "one")
    ticker = registry._ticker
    attached(registry, "other")
    assert registry._ticker is ticker


async def test_closing_ends_what_waits_for_a_vehicle(registry: VehicleRegistry) -> None:
    air = attached(registry)
    air.say(heartbeat())
    reading = asyncio.ensure_future(registry.get("air-1-1").parameters.read("A"))
    await asyncio.sleep(0)
    registry.close()
    assert registry.all() == ()
    with pytest.raises(LinkDown, match="air was closed"):
        await reading


async def test_a_vehicle_that_is_found_is_told_of_and_asked_who_it_is(registry: VehicleRegistry) -> None:
    heard: list[VehicleEvent] = []
    registry.subscribe(heard.append)
    air = attached(registry)
    air.say(heartbeat())
    assert asking(registry) == 1
    await turns()
    assert heard[0] == VehicleEvent(VehicleEventKind.FOUND, "air-1-1", "Heard air-1-1.")
    asked = [m.param1 for m in air.sent if m.get_type() == "COMMAND_LONG" and m.command == 512]
    assert dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION in asked
    air.say(version())
    await turns()
    (vehicle,) = registry.all()
    cast(ManualClock, vehicle.clock).now += 60.0  # no second unit answers
    vehicle.tick()
    await turns()
    assert asking(registry) == 0  # it has answered, and is asked no more
    (known,) = [event for event in heard if event.kind is VehicleEventKind.IDENTIFIED]
    assert known.vehicle_id == vehicle.id != "air-1-1"  # the event carries the name that it gave


async def test_a_link_that_is_detached_is_asked_nothing_more(registry: VehicleRegistry) -> None:
    air = attached(registry)
    air.say(heartbeat())
    (question,) = registry._identifying.values()
    registry.detach(cast(Link, air))
    await turns()
    assert question.cancelled()
    assert asking(registry) == 0


async def test_only_the_latest_question_who_a_vehicle_is_goes_on(registry: VehicleRegistry) -> None:
    air = attached(registry)
    air.say(heartbeat())
    (vehicle,) = registry.all()
    (first,) = registry._identifying.values()
    registry._announce(vehicle, VehicleEventKind.REBOOTED, "It restarted.")
    (second,) = registry._identifying.values()
    await turns()
    assert first.cancelled()
    assert not second.done()
    assert asking(registry) == 1  # the end of the first question does not forget the second one


async def test_a_unit_that_gave_way_is_asked_nothing_more(registry: VehicleRegistry) -> None:
    air = attached(registry)
    air.say(heartbeat())
    air.say(version(uid2=b"\x01"))
    (first,) = registry.all()
    registry._announce(first, VehicleEventKind.REBOOTED, "It restarted.")
    (question,) = registry._identifying.values()
    cast(ManualClock, first.clock).now += 31.0
    air.say(version(uid2=b"\x02"), at=first.clock())
    (second,) = registry.all()
    assert second is not first
    assert list(registry._identifying) == [second]
    await turns()
    assert question.cancelled()


async def test_a_vehicle_that_does_not_answer_is_asked_again_later_and_not_at_once(
    registry: VehicleRegistry, monkeypatch: pytest.MonkeyPatch
) -> None:
    waited: list[float] = []
    again = asyncio.Event()
    sleep = asyncio.sleep

    async def pause(seconds: float) -> None:
        if not seconds:
            return await sleep(0)
        waited.append(seconds)
        await again.wait()
        return None

    monkeypatch.setattr("mavcal.service.vehicle.registry.asyncio.sleep", pause)
    air = attached(registry)
    air.say(heartbeat())
    (vehicle,) = registry.all()
    clock = cast(ManualClock, vehicle.clock)
    for _ in range(20):
        await turns(5)
        clock.now += 2.0
        vehicle.tick()
    assert waited == [10.0]
    count = len(air.sent)
    again.set()
    await turns()
    assert len(air.sent) > count


async def test_a_listener_that_leaves_before_its_turn_is_not_called_and_the_others_are(
    registry: VehicleRegistry,
) -> None:
    errors: list[dict[str, object]] = []
    asyncio.get_running_loop().set_exception_handler(lambda _loop, context: errors.append(context))
    gone: list[VehicleEvent] = []
    there: list[VehicleEvent] = []
    forget = registry.subscribe(gone.append)
    registry.subscribe(there.append)
    attached(registry).say(heartbeat())
    forget()
    forget()
    await turns(2)
    assert gone == []
    assert there
    assert errors == []


async def test_a_detached_link_takes_only_its_own_vehicles(registry: VehicleRegistry) -> None:
    one: Air = attached(registry, "one")
    attached(registry, "other").say(heartbeat())
    one.say(heartbeat())
    registry.detach(cast(Link, one))
    assert [vehicle.id for vehicle in registry.all()] == ["other-1-1"]


async def test_a_fleet_has_its_turns_in_parts_and_none_is_left_out(registry: VehicleRegistry) -> None:
    air, clock = attached(registry), cast(ManualClock, registry._clock)
    silent: list[str] = []
    registry.subscribe(lambda event: silent.append(event.vehicle_id) if event.kind is VehicleEventKind.SILENT else None)
    count = 2 * TOGETHER + 20
    for system in range(1, count + 1):
        air.say(heartbeat(), system, at=clock())
    clock.advance(10.0)
    told = []
    for _ in range(3 * IDLE_TURNS):
        assert registry._ticker is not None
        registry._ticker.cancel()  # by hand alone, however long a turn of a busy machine takes
        clock.advance(TICK_S)
        registry._tick()
        registry._ticker.cancel()
        await turns(3)
        told.append(len(silent))
    assert told[-1] == len(set(silent)) == count
    assert all(after - before <= TOGETHER for before, after in itertools.pairwise([0, *told]))
    assert told[0] < count


async def test_a_late_loop_gives_an_idle_vehicle_its_turn_as_soon_as_it_can(registry: VehicleRegistry) -> None:
    """Else its landed state, asked for every few turns, grows too old to write by."""
    air, clock = attached(registry), cast(ManualClock, registry._clock)
    air.say(heartbeat(), at=clock())
    (vehicle,) = registry.all()
    had: list[float] = []
    vehicle.tick = lambda: had.append(clock())  # type: ignore[method-assign]
    for late in range(1, 4):
        clock.advance(2.0 * IDLE_S)
        registry._tick()
        assert len(had) == late
    clock.advance(0.2 * IDLE_S)
    registry._tick()
    registry._tick()
    assert len(had) <= 4


async def test_whoever_is_waited_for_has_every_turn(registry: VehicleRegistry) -> None:
    air, clock = attached(registry), cast(ManualClock, registry._clock)
    air.say(heartbeat(), at=clock())
    (vehicle,) = registry.all()
    for _ in range(2 * IDLE_TURNS):
        waiting = asyncio.ensure_future(vehicle.waits.sleep(0.01))
        await turns(2)
        clock.advance(1.0)
        registry._tick()
        await turns(2)
        assert waiting.done()
