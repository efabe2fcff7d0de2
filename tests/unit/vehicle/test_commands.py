from __future__ import annotations

import asyncio
from collections.abc import Iterable
from typing import Any

import pytest

from mavcal.service.errors import CommandRefused, CommandTimeout, ForbiddenCommand, LinkDown, VehicleSilent
from mavcal.service.vehicle.commands import check_allowed, command
from tests.unit.vehicle.fake import FakeVehicle, ack


def answering(fake: FakeVehicle, *results: int) -> None:
    """Answer each COMMAND_LONG with the next list of results, the last for ever."""

    def respond(message: Any) -> Iterable[Any]:
        if message.get_type() != "COMMAND_LONG" or message.command == 512:
            return []
        return [ack(message.command, result) for result in results]

    fake.link.respond = respond


def sent(fake: FakeVehicle, number: int) -> list[Any]:
    return [m for m in fake.link.sent_of("COMMAND_LONG") if m.command == number]


async def test_an_accepted_command_is_sent_once(ardupilot: FakeVehicle) -> None:
    answering(ardupilot, 0)
    await ardupilot.run(command(ardupilot.vehicle, 241, (1,)))
    (message,) = sent(ardupilot, 241)
    assert (message.target_system, message.target_component, message.param1, message.param7) == (1, 1, 1, 0)


@pytest.mark.parametrize(
    ("result", "words"),
    [
        (1, "temporarily rejected"),
        (2, "denied"),
        (3, "this firmware does not know it"),
        (4, "failed"),
        (6, "cancelled"),
        (7, "only accepted as COMMAND_LONG"),
        (8, "only accepted as COMMAND_INT"),
        (9, "unsupported frame"),
        (10, "not in control of this vehicle"),
        (99, "99"),
    ],
)
async def test_a_refusal_is_told_in_words(ardupilot: FakeVehicle, result: int, words: str) -> None:
    answering(ardupilot, result)
    with pytest.raises(CommandRefused, match=words):
        await ardupilot.run(command(ardupilot.vehicle, 241, (1,)))


@pytest.mark.parametrize("result", [1, 2, 3, 4, 6, 7, 8, 9, 10, 99])
async def test_every_other_result_is_an_error_that_carries_it(ardupilot: FakeVehicle, result: int) -> None:
    answering(ardupilot, result)
    with pytest.raises(CommandRefused) as caught:
        await ardupilot.run(command(ardupilot.vehicle, 241, (1,)))
    assert (caught.value.command, caught.value.result) == (241, result)
    assert len(sent(ardupilot, 241)) == 1


async def test_an_unanswered_command_is_repeated_and_counted(ardupilot: FakeVehicle) -> None:
    with pytest.raises(CommandTimeout, match="3 times"):
        await ardupilot.run(command(ardupilot.vehicle, 401))
    assert [m.confirmation for m in sent(ardupilot, 401)] == [0, 1, 2]
    ardupilot.alive = False
    with pytest.raises(VehicleSilent):
        await ardupilot.run(command(ardupilot.vehicle, 401))


async def test_a_vehicle_asks_as_often_and_as_patiently_as_the_command_by_itself(ardupilot: FakeVehicle) -> None:
    took = []
    for ask in (command(ardupilot.vehicle, 401), ardupilot.vehicle.command(401)):
        ardupilot.link.sent.clear()
        began = ardupilot.clock.now
        with pytest.raises(CommandTimeout, match="asked 3 times"):
            await ardupilot.run(ask)
        took.append(ardupilot.clock.now - began)
        assert len(sent(ardupilot, 401)) == 3
    assert took == pytest.approx([4.5, 4.5], abs=0.2)  # 1.5 s each time


async def test_in_progress_is_waited_out_without_repeating(ardupilot: FakeVehicle) -> None:
    answering(ardupilot, 5)
    task = asyncio.ensure_future(command(ardupilot.vehicle, 241, (1,), timeout=2.0))
    for _ in range(5):
        for _ in range(5):
            await asyncio.sleep(0)
        ardupilot.advance(1.5)
        ardupilot.hear(ack(241, 5))
    assert not task.done()
    ardupilot.hear(ack(241, 0))
    await ardupilot.run(task_of(task))
    assert len(sent(ardupilot, 241)) == 1


async def task_of(task: asyncio.Future[None]) -> None:
    await task


async def test_the_answer_to_somebody_else_is_not_ours(ardupilot: FakeVehicle) -> None:
    def respond(message: Any) -> Iterable[Any]:
        if message.get_type() == "COMMAND_LONG" and message.command == 401:
            foreign = ack(401, 4)
            foreign.target_system = 255
            return [foreign, ack(400, 4), ack(401, 0)]
        return []

    ardupilot.link.respond = respond
    await ardupilot.run(command(ardupilot.vehicle, 401))


async def test_two_of_one_command_do_not_take_each_others_answers(ardupilot: FakeVehicle) -> None:
    def respond(message: Any) -> Iterable[Any]:
        is_ours = message.get_type() == "COMMAND_LONG" and message.command == 511
        return [ack(511, 0 if message.param1 == 27 else 2)] if is_ours else []

    ardupilot.link.respond = respond
    first, second = await ardupilot.run(both(ardupilot))
    assert first is None
    assert isinstance(second, CommandRefused)


async def both(fake: FakeVehicle) -> list[BaseException | None]:
    asked = (command(fake.vehicle, 511, (27, 1e4)), command(fake.vehicle, 511, (26, 1e4)))
    return await asyncio.gather(*asked, return_exceptions=True)


@pytest.mark.parametrize(
    ("number", "params"),
    [
        (241, (0, 0, 0, 0, 0, 1, 0)),  # compassmot: starts the motors
        (241, (0, 0, 1, 0, 0, 0, 0)),
        (241, (1, 0, 0, 0, 1, 0, 0)),
        (241, (3, 0, 0, 0, 0, 0, 0)),
        (245, (2, 0, 0, 0, 0, 0, 0)),  # erase all
        (245, (0, 0, 0, 0, 0, 0, 0)),
        (245, (1, 2, 0, 0, 0, 0, 0)),
        (246, (3, 0, 0, 0, 0, 0, 0)),
        (246, (1, 0, 0, 0, 0, 20190226, 0)),
        (246, (1, 1, 0, 0, 0, 0, 0)),
        (245, (1, 1, 0, 0, 0, 0, 0)),
        (400, (0, 1, 0, 0, 0, 0, 0)),
        (241, (0, 0, 0, 1, 0, 0, 0)),
        (241, (0, 0, 0, 0, 0, 0, 1)),
        (241, (0, 1, 0, 0, 2, 0, 0)),
        (241, (0, 2, 0, 0, 0, 0, 0)),
        (241, (0, 0, 0, 0, 3, 0, 0)),
        (241, (2, 0, 0, 0, 0, 0, 0)),
        (241, (0, 77, 0, 0, 0, 0, 0)),
        (241, (0, 0, 0, 0, 5, 0, 0)),
        (241, (0, 0, 0, 0, 77, 0, 0)),
        (400, (1, 0, 0, 0, 0, 0, 0)),
        (400, (0, 21196, 0, 0, 0, 0, 0)),
        (209, (1, 0, 50, 1, 0, 0, 0)),  # motor test
        (185, (1, 0, 0, 0, 0, 0, 0)),
        (22, (0, 0, 0, 0, 0, 0, 0)),
        (242, (0, 0, 0, 0, 0, 0, 0)),
        (42650, (0, 0, 0, 0, 290876, 0, 0)),
    ],
)
async def test_the_dangerous_ones_are_never_sent(
    ardupilot: FakeVehicle, number: int, params: tuple[float, ...]
) -> None:
    with pytest.raises(ForbiddenCommand, match=str(number)):
        await ardupilot.run(command(ardupilot.vehicle, number, params))
    assert sent(ardupilot, number) == []


@pytest.mark.parametrize(
    ("number", "params"),
    [
        (241, (1, 0, 0, 0, 0, 0, 0)),
        (241, (0, 76, 0, 0, 0, 0, 0)),
        (241, (0, 0, 0, 0, 76, 0, 0)),
        (241, (0, 0, 0, 0, 2, 0, 0)),
        (241, (0, 0, 0, 0, 0, 0, 0)),
        (241, (0, 1, 0, 0, 0, 0, 0)),
        (241, (0, 0, 0, 0, 1, 0, 0)),
        (241, (0, 0, 0, 0, 4, 0, 0)),
        *((harmless, (3, 3, 3, 3, 3, 3, 3)) for harmless in (401, 510, 511, 512, 519, 520, 2510, 2511)),
        *((harmless, (3, 3, 3, 3, 3, 3, 3)) for harmless in (42424, 42425, 42426)),
        (245, (1, 0, 0, 0, 0, 0, 0)),
        (246, (1, 0, 0, 0, 0, 0, 0)),
        (400, (0, 0, 0, 0, 0, 0, 0)),
        (511, (27, 20000, 0, 0, 0, 0, 0)),
    ],
)
def test_what_calibrating_needs_is_allowed(number: int, params: tuple[float, ...]) -> None:
    check_allowed(number, params)


async def test_closing_the_vehicle_ends_what_waits_for_it(ardupilot: FakeVehicle) -> None:
    task = asyncio.ensure_future(command(ardupilot.vehicle, 401))
    await asyncio.sleep(0)
    ardupilot.vehicle.close(LinkDown("closed"))
    with pytest.raises(LinkDown, match="closed"):
        await task
    with pytest.raises(LinkDown, match="closed"):
        await command(ardupilot.vehicle, 401)


async def test_a_command_that_began_and_never_ended_says_so(ardupilot: FakeVehicle) -> None:
    answering(ardupilot, 5)
    with pytest.raises(CommandTimeout, match="it began, but its end was not heard"):
        await ardupilot.run(command(ardupilot.vehicle, 241, (1,), timeout=2.0))
    assert len(sent(ardupilot, 241)) == 1


@pytest.mark.parametrize(
    ("system", "component", "ours"),
    [(0, 0, True), (253, 0, True), (0, 190, True), (253, 190, True), (1, 190, False), (253, 1, False)],
)
async def test_an_acknowledgement_is_ours_by_its_ids_or_for_everybody(
    ardupilot: FakeVehicle, system: int, component: int, *, ours: bool
) -> None:
    said = ack(401, 0)
    said.target_system, said.target_component = system, component
    ardupilot.link.respond = lambda m: [said] if m.get_type() == "COMMAND_LONG" and m.command == 401 else []
    if ours:
        await ardupilot.run(command(ardupilot.vehicle, 401))
    else:
        with pytest.raises(CommandTimeout):
            await ardupilot.run(command(ardupilot.vehicle, 401))
