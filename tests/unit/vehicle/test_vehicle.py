"""A vehicle by itself: who it is, what is said about it, what ends with it, and why it is not written to."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.service.errors import (
    CommandTimeout,
    LinkDown,
    VehicleArmed,
    VehicleBusy,
    VehicleConflict,
    VehicleError,
    VehicleSilent,
)
from mavcal.service.link.types import LinkEvent, LinkEventKind
from mavcal.service.vehicle import subscribers
from mavcal.service.vehicle.commands import REQUEST_CAPABILITIES, REQUEST_MESSAGE
from mavcal.service.vehicle.events import VehicleEventKind
from tests.unit.vehicle.fake import FakeVehicle, heartbeat, landed, param_value, real, version


def told(fake: FakeVehicle, kind: VehicleEventKind) -> list[str]:
    return [event.text for event in fake.events if event.kind is kind]


def asked(fake: FakeVehicle, message_id: int) -> int:
    return sum(m.command == REQUEST_MESSAGE and m.param1 == message_id for m in fake.link.sent_of("COMMAND_LONG"))


async def test_who_it_is_is_asked_both_ways_until_it_answers(ardupilot: FakeVehicle) -> None:
    ardupilot.link.respond = lambda m: [version()] if getattr(m, "command", 0) == REQUEST_CAPABILITIES else []
    identity = await ardupilot.run(ardupilot.vehicle.identify())
    assert identity.uid2 == ardupilot.vehicle.identity.uid2
    ways = [m.command for m in ardupilot.link.sent_of("COMMAND_LONG") if m.param1 in (1, 148)]
    assert ways[0] == REQUEST_MESSAGE
    assert ways.count(REQUEST_CAPABILITIES) == 1


async def test_one_that_never_says_who_it_is_is_given_up(ardupilot: FakeVehicle) -> None:
    with pytest.raises(CommandTimeout, match="does not answer who it is"):
        await ardupilot.run(ardupilot.vehicle.identify())
    assert len([m for m in ardupilot.link.sent_of("COMMAND_LONG") if m.command == REQUEST_CAPABILITIES]) == 5


async def test_every_change_is_told_once(ardupilot: FakeVehicle) -> None:
    ardupilot.events.clear()
    ardupilot.hear(heartbeat(armed=True), heartbeat(armed=True))
    ardupilot.hear(landed(2), landed(2))
    ardupilot.hear(heartbeat(status=2), heartbeat(status=2))
    ardupilot.hear(dialect.MAVLink_statustext_message(6, b"hello", 0, 0))
    ardupilot.hear(heartbeat())
    assert told(ardupilot, VehicleEventKind.ARMED) == ["The vehicle is armed."]
    assert told(ardupilot, VehicleEventKind.DISARMED) == ["The vehicle is disarmed."]
    assert told(ardupilot, VehicleEventKind.LANDED) == ["The vehicle is in_air."]
    assert [text[:24] for text in told(ardupilot, VehicleEventKind.CALIBRATING)] == ["It calibrates by itself:"]
    assert told(ardupilot, VehicleEventKind.TEXT) == ["hello"]


async def test_silence_and_its_end_are_told(ardupilot: FakeVehicle) -> None:
    ardupilot.alive = False
    ardupilot.events.clear()
    for _ in range(8):
        ardupilot.advance(0.5)
    (silent,) = told(ardupilot, VehicleEventKind.SILENT)
    assert " 3 s" in silent
    ardupilot.hear(heartbeat())
    ardupilot.vehicle.tick()
    ardupilot.vehicle.tick()
    assert len(told(ardupilot, VehicleEventKind.HEARD_AGAIN)) == 1


async def test_a_restart_forgets_the_parameters_and_the_list(ardupilot: FakeVehicle) -> None:
    def clock(seconds: float) -> Any:
        return dialect.MAVLink_system_time_message(0, int(1000 * seconds))

    ardupilot.hear(param_value("X", real(1.0), index=0))
    ardupilot.vehicle.listed = True
    ardupilot.hear(clock(100.0))
    for k in range(3):
        ardupilot.hear(clock(2.0 + k))
    assert told(ardupilot, VehicleEventKind.REBOOTED) == ["The vehicle has restarted."]
    assert not ardupilot.vehicle.listed
    assert ardupilot.vehicle.parameters.count is None


async def test_the_time_is_asked_for_where_no_stream_tells_it(ardupilot: FakeVehicle) -> None:
    system_time = dialect.MAVLINK_MSG_ID_SYSTEM_TIME
    ardupilot.link.sent.clear()
    ardupilot.hear(heartbeat())
    ardupilot.hear(heartbeat())
    assert asked(ardupilot, system_time) == 2
    ardupilot.hear(dialect.MAVLink_system_time_message(0, 5000))
    ardupilot.hear(heartbeat())
    assert asked(ardupilot, system_time) == 2
    ardupilot.hear(heartbeat())
    assert asked(ardupilot, system_time) == 3


async def test_the_time_is_asked_for_with_the_first_heartbeat() -> None:
    found = FakeVehicle(ready=False)
    assert asked(found, dialect.MAVLINK_MSG_ID_SYSTEM_TIME) == 0
    found.hear(heartbeat())
    assert asked(found, dialect.MAVLINK_MSG_ID_SYSTEM_TIME) == 1


async def test_its_state_is_asked_for_when_it_has_grown_old(ardupilot: FakeVehicle) -> None:
    ardupilot.link.sent.clear()
    ardupilot.vehicle.tick()
    assert asked(ardupilot, dialect.MAVLINK_MSG_ID_VFR_HUD) == 0  # asked for with its first heartbeat
    ardupilot.clock.now += 1.9
    ardupilot.vehicle.tick()
    assert asked(ardupilot, dialect.MAVLINK_MSG_ID_VFR_HUD) == 0
    ardupilot.hear(heartbeat(), landed())
    ardupilot.clock.now += 0.1
    ardupilot.vehicle.tick()
    assert asked(ardupilot, dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE) == 0  # just heard
    assert asked(ardupilot, dialect.MAVLINK_MSG_ID_VFR_HUD) == 1
    ardupilot.clock.now += 2.0
    ardupilot.vehicle.tick()  # what was heard 2.1 s ago has grown old
    assert asked(ardupilot, dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE) == 1
    assert asked(ardupilot, dialect.MAVLINK_MSG_ID_VFR_HUD) == 2
    ardupilot.clock.now += 100.0
    ardupilot.vehicle.tick()  # who is silent is not asked
    assert asked(ardupilot, dialect.MAVLINK_MSG_ID_VFR_HUD) == 2


async def test_its_state_is_asked_for_with_the_heartbeat_that_a_late_loop_hears_after_its_turn(
    ardupilot: FakeVehicle,
) -> None:
    ardupilot.vehicle.tick()
    ardupilot.clock.now += 2.5
    ardupilot.link.heard_until = ardupilot.clock.now - 2.4
    ardupilot.link.sent.clear()
    ardupilot.vehicle.tick()  # nothing of these 2.5 s has been read yet
    assert asked(ardupilot, dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE) == 0
    ardupilot.hear(heartbeat())
    assert asked(ardupilot, dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE) == 1
    ardupilot.hear(heartbeat())
    assert asked(ardupilot, dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE) == 1


async def test_another_address_is_told_and_is_no_conflict(ardupilot: FakeVehicle) -> None:
    vehicle = ardupilot.vehicle
    for system in (2, 1):
        vehicle.link_event(LinkEvent(LinkEventKind.PEER_CHANGED, f"from elsewhere {system}", system, 1))
    assert told(ardupilot, VehicleEventKind.PEER_CHANGED) == ["from elsewhere 1"]
    assert vehicle.conflicts == ()


async def test_a_conflict_lasts_for_half_a_minute_after_its_last_sign_and_is_told_once(ardupilot: FakeVehicle) -> None:
    vehicle = ardupilot.vehicle
    of_another = LinkEvent(LinkEventKind.DUPLICATE_SYSTEM, "two of another", 2, 1)
    ours = LinkEvent(LinkEventKind.DUPLICATE_SYSTEM, "two of them", 1, 1)
    vehicle.link_event(of_another)
    assert vehicle.conflicts == ()
    vehicle.link_event(ours)
    ardupilot.clock.now += 20.0
    vehicle.link_event(ours)
    ardupilot.clock.now += 29.9
    assert vehicle.conflicts == ("two of them",)
    assert told(ardupilot, VehicleEventKind.CONFLICT) == ["two of them"]
    ardupilot.clock.now += 0.1
    assert vehicle.conflicts == ()
    vehicle.link_event(ours)
    assert len(told(ardupilot, VehicleEventKind.CONFLICT)) == 2


@pytest.mark.parametrize(
    ("messages", "error"),
    [
        ((heartbeat(armed=True),), VehicleArmed),
        ((landed(2),), VehicleBusy),
        ((heartbeat(status=2), landed()), VehicleBusy),
        ((heartbeat(armed=True), landed(2)), VehicleArmed),
    ],
)
async def test_each_refusal_has_its_error_and_says_whether_something_was_sent(
    ardupilot: FakeVehicle, messages: tuple[Any, ...], error: type[VehicleError]
) -> None:
    ardupilot.vehicle.require_writable()
    ardupilot.hear(*messages)
    for name, sent, begins in (
        ("", 0, "Nothing is written: "),
        ("X", 0, "X was not written: "),
        ("X", 2, "X was sent 2 times and not confirmed; it is not sent again: "),
    ):
        with pytest.raises(error) as refused:
            ardupilot.vehicle.require_writable(name=name, sent=sent)
        assert str(refused.value).startswith(begins)
        assert refused.value.sent == sent


async def test_a_doubt_about_who_it_is_forbids_writing(ardupilot: FakeVehicle) -> None:
    ardupilot.vehicle.link_event(LinkEvent(LinkEventKind.OWN_IDS_HEARD, "our ids from elsewhere", 253, 190))
    found = ardupilot.vehicle.writable()
    assert (found.ok, found.reasons) == (False, ("our ids from elsewhere",))
    with pytest.raises(VehicleConflict):
        ardupilot.vehicle.require_writable()
    ardupilot.clock.now += 3.1
    with pytest.raises(VehicleSilent):  # which it is first
        ardupilot.vehicle.require_writable()


async def test_frames_go_to_whoever_asked_for_them_until_it_forgets(ardupilot: FakeVehicle) -> None:
    heard: list[int] = []
    forget = ardupilot.vehicle.subscribe(
        frozenset({0}), lambda frames, _batch: heard.extend(f.message_id for f in frames)
    )
    ardupilot.hear(heartbeat(), landed())
    await asyncio.sleep(0)
    assert heard == [0]
    ardupilot.hear(heartbeat())
    forget()
    forget()
    await asyncio.sleep(0)
    assert heard == [0]


async def test_what_waits_for_a_vehicle_that_goes_away_ends_with_the_reason(ardupilot: FakeVehicle) -> None:
    heard: list[int] = []
    ardupilot.vehicle.subscribe(frozenset({0}), lambda frames, _batch: heard.append(len(frames)))
    reading = asyncio.create_task(ardupilot.vehicle.parameters.read("X"))
    await asyncio.sleep(0)
    ardupilot.vehicle.close(LinkDown("the link was closed"))
    with pytest.raises(LinkDown, match="the link was closed"):
        await reading
    ardupilot.hear(heartbeat())
    await asyncio.sleep(0)
    assert heard == []


async def test_one_that_another_unit_has_replaced_says_so_for_ever(ardupilot: FakeVehicle) -> None:
    ardupilot.vehicle.successor = "ffff"
    said = ardupilot.vehicle.mark_replaced()
    assert said.startswith("Another unit (ffff) answers to system id 1 now; ")
    assert said.endswith("was not heard for 30 s.")
    ardupilot.clock.now += 1000.0
    assert ardupilot.vehicle.conflicts == (said,)


async def test_a_recording_that_does_not_begin_is_refused_and_forgotten(
    ardupilot: FakeVehicle, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(subscribers, "_MARK_S", 0.01)
    ardupilot.link.mark = lambda _reached: None  # type: ignore[attr-defined]
    ardupilot.link.reason = "it does not answer"  # type: ignore[attr-defined]
    with pytest.raises(LinkDown, match="does not read: it does not answer"):
        await ardupilot.vehicle.record(frozenset({0}), lambda _frames, _batch: None)
    begun: list[Any] = []
    ardupilot.link.mark = begun.append  # type: ignore[attr-defined]
    heard: list[int] = []
    task = asyncio.create_task(ardupilot.vehicle.record(frozenset({0}), lambda f, _batch: heard.append(len(f))))
    await asyncio.sleep(0)
    begun[0](77)
    byte, forget = await task
    assert byte == 77
    begun[0](88)  # a second answer changes nothing
    ardupilot.hear(heartbeat())
    await asyncio.sleep(0)
    assert heard == [1]
    forget()
    ardupilot.hear(heartbeat())
    await asyncio.sleep(0)
    assert heard == [1]


async def test_a_demand_is_sent_as_a_first_transmission(ardupilot: FakeVehicle) -> None:
    """`confirmation` counts repetitions: a vehicle may take a command of a higher count for one that it knows."""
    ardupilot.link.sent.clear()
    ardupilot.vehicle.demand(REQUEST_MESSAGE, 27)
    (sent,) = ardupilot.link.sent_of("COMMAND_LONG")
    assert (sent.command, sent.confirmation, sent.param1, sent.param2) == (REQUEST_MESSAGE, 0, 27.0, 0.0)


async def test_a_demand_on_a_link_that_is_down_is_lost(ardupilot: FakeVehicle) -> None:
    def down(_message: Any, _target: object = None) -> None:
        raise LinkDown("gone")

    ardupilot.link.send = down  # type: ignore[method-assign]
    ardupilot.vehicle.demand(REQUEST_MESSAGE, 27)
    ardupilot.clock.now += 10.0
    ardupilot.hear(heartbeat())
    ardupilot.vehicle.tick()
    with pytest.raises(LinkDown):
        ardupilot.vehicle.send(heartbeat())


async def test_who_it_is_is_asked_every_five_seconds_of_a_vehicle_that_has_said_so(ardupilot: FakeVehicle) -> None:
    who = dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION
    ardupilot.advance(2.0)
    ardupilot.link.sent.clear()
    counts = []
    for _ in range(12):
        ardupilot.advance(1.0)
        counts.append(asked(ardupilot, who))
    assert counts[-1] == 2
    assert counts[3] == 0


async def test_who_it_is_is_asked_again_as_soon_as_five_seconds_have_passed(ardupilot: FakeVehicle) -> None:
    ardupilot.advance(2.0)
    ardupilot.link.sent.clear()
    counts = []
    for _ in range(4):
        ardupilot.advance(2.5)
        counts.append(asked(ardupilot, dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION))
    assert counts == [0, 1, 1, 2]
