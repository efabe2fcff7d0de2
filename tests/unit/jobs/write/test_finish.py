"""The end of a verified write: commands once, session settings back in reverse order, a last look at every value."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pytest

from mavcal.calib.firmware.plan import ParameterKind
from mavcal.service.errors import CommandRefused, WriteFailed, WriteStopped
from mavcal.service.jobs.core.crashpoints import At
from mavcal.service.jobs.core.journal import JournalStep, Sent
from mavcal.service.jobs.write.steps import finish, prepare, send_all
from mavcal.service.vehicle.job_vehicle import ParameterReading
from tests.unit.jobs.conftest import NEW, Bench, Killed, MakeBench, float32

EXPECTED = {name: float32(value) for name, value in NEW.items()}
AFTER = (JournalStep.COMMAND, JournalStep.COMMANDED, JournalStep.RESTORE, JournalStep.RESTORED)


async def verified(bench: Bench) -> None:
    """Bring the write to where the stream has confirmed every parameter, and forget what was sent for that."""
    await bench.handle.record(JournalStep.ACCEPTED)
    await prepare(bench.attempt())
    await send_all(bench.attempt())
    await bench.handle.record(JournalStep.VERIFIED)
    bench.vehicle.sets.clear()


def rows(bench: Bench) -> list[tuple[str, dict[str, Any]]]:
    return [(row.step, row.data) for row in bench.store.journal("j1") if row.step in AFTER]


def kill_at(bench: Bench, at: At) -> None:
    def reach(now: At) -> None:
        if now == at:
            raise Killed

    bench.reach = reach


async def test_a_command_is_announced_sent_and_confirmed(make_bench: MakeBench) -> None:
    bench = make_bench()
    await verified(bench)
    asked: list[tuple[int, tuple[float, ...], int]] = []

    async def command(number: int, params: Sequence[float]) -> None:
        asked.append((number, tuple(params), len(rows(bench))))

    bench.vehicle.command = command  # type: ignore[method-assign]
    assert await finish(bench.attempt()) == EXPECTED
    assert asked == [(241, (0.0, 0.0, 0.0, 0.0, 76.0, 0.0, 0.0), 1)]  # one row, the announcement, was there before
    assert rows(bench) == [("command", {"index": 0, "command": 241}), ("commanded", {"index": 0})]


async def test_a_confirmed_command_is_not_sent_again(make_bench: MakeBench) -> None:
    bench = make_bench()
    await verified(bench)
    await finish(bench.attempt())
    await finish(bench.restarted().attempt())
    assert bench.vehicle.commands == [241]


@pytest.mark.parametrize(
    ("at", "commands"), [(At.BEFORE_COMMAND, [241]), (At.AFTER_COMMAND, [241, 241])], ids=["unsent", "unconfirmed"]
)
async def test_after_a_crash_a_command_that_is_not_known_to_be_confirmed_is_sent(
    make_bench: MakeBench, at: At, commands: list[int]
) -> None:
    bench = make_bench()
    await verified(bench)
    kill_at(bench, at)
    with pytest.raises(Killed):
        await finish(bench.attempt())
    await finish(bench.restarted().attempt())
    assert bench.vehicle.commands == commands


async def test_a_refused_command_ends_it_unconfirmed_and_restores_nothing(make_bench: MakeBench) -> None:
    bench = make_bench(session=True)
    await verified(bench)
    bench.vehicle.refused_commands = {241}
    with pytest.raises(CommandRefused):
        await finish(bench.attempt())
    assert [step for step, _ in rows(bench)] == ["command"]
    assert bench.vehicle.sets == []


async def test_a_session_setting_is_put_back_and_the_calibration_stays(make_bench: MakeBench) -> None:
    bench = make_bench(session=True, command=False)
    await verified(bench)
    assert bench.vehicle.values()["FLAG"] == 0.0
    assert await finish(bench.attempt()) == EXPECTED | {"FLAG": 1.0}
    assert bench.vehicle.sets == [("FLAG", 1.0)]
    assert rows(bench) == [("restore", {"name": "FLAG"}), ("restored", {"name": "FLAG", "value": 1.0})]


async def test_session_settings_go_back_in_the_reverse_order_of_their_sending(make_bench: MakeBench) -> None:
    bench = make_bench(session=True, command=False)
    await verified(bench)
    bench.vehicle.parameters["SECOND"] = ParameterReading("SECOND", 4.0, ParameterKind.REAL32)
    second = Sent("SECOND", 3.0, 4.0, ParameterKind.REAL32, session=True)
    data = {"name": second.name, "old": second.old, "new": second.new, "kind": "real32", "session": True}
    await bench.handle.record(JournalStep.SEND, **data)
    await finish(bench.attempt())
    assert bench.vehicle.sets == [("SECOND", 3.0), ("FLAG", 1.0)]


@pytest.mark.parametrize("held", [1.0, 7.0], ids=["the old value", "somebody else's"])
async def test_a_session_setting_that_no_longer_holds_our_value_is_left_alone(
    make_bench: MakeBench, held: float
) -> None:
    bench = make_bench(session=True, command=False)
    await verified(bench)
    bench.vehicle.store("FLAG", held)
    values = await finish(bench.attempt())
    assert values["FLAG"] == held
    assert bench.vehicle.sets == []
    assert rows(bench) == [("restored", {"name": "FLAG", "value": held})]


async def test_a_session_setting_that_is_back_is_not_looked_at_again(make_bench: MakeBench) -> None:
    bench = make_bench(session=True, command=False)
    await verified(bench)
    await finish(bench.attempt())
    bench.vehicle.store("FLAG", 0.0)  # the operator has set it since
    await finish(bench.restarted().attempt())
    assert bench.vehicle.sets == [("FLAG", 1.0)]


async def test_after_a_crash_between_announcement_and_restoring_it_is_restored(make_bench: MakeBench) -> None:
    bench = make_bench(session=True, command=False)
    await verified(bench)
    kill_at(bench, At.BEFORE_RESTORE)
    with pytest.raises(Killed):
        await finish(bench.attempt())
    assert bench.vehicle.values()["FLAG"] == 0.0
    await finish(bench.restarted().attempt())
    assert bench.vehicle.values()["FLAG"] == 1.0


async def test_a_calibration_value_that_was_changed_meanwhile_is_found_by_the_last_look(make_bench: MakeBench) -> None:
    bench = make_bench(session=True)
    await verified(bench)
    bench.vehicle.store("INS_GYROFFS_Y", 0.5)
    with pytest.raises(WriteFailed, match=r"INS_GYROFFS_Y holds 0\.5 instead of -0\.0199"):
        await finish(bench.attempt())


async def test_an_armed_vehicle_gets_neither_command_nor_setting(make_bench: MakeBench) -> None:
    bench = make_bench(session=True)
    await verified(bench)
    w = bench.attempt()
    bench.vehicle.change_state(armed=True)
    with pytest.raises(WriteStopped, match="armed"):
        await finish(w)
    assert bench.vehicle.commands == []
    assert bench.vehicle.sets == []
