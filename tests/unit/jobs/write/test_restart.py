"""A restart in the middle of a write: ours if it was accepted, else the operator's; never another vehicle's."""

from __future__ import annotations

import asyncio
import dataclasses
from collections.abc import Sequence

import pytest

from mavcal.calib.recording import Identity
from mavcal.service.errors import WriteFailed, WriteStopped
from mavcal.service.jobs.core.journal import JournalStep
from mavcal.service.jobs.write.steps import PREFLIGHT_REBOOT_SHUTDOWN, restart
from mavcal.service.vehicle.commands import check_allowed
from tests.unit.jobs.conftest import IMPATIENT, Bench, MakeBench, until


def restarted(bench: Bench, **changes: object) -> None:
    state = bench.vehicle.condition()
    bench.vehicle.change_state(reboots=state.reboots + 1, **changes)


def says(bench: Bench, uid: str | None) -> None:
    """What it answers once it is asked who it is; until then it is taken for the one that it was."""

    async def identify() -> Identity:
        bench.vehicle.identity = dataclasses.replace(bench.vehicle.identity, uid=uid)
        return bench.vehicle.identity

    bench.vehicle.identify = identify  # type: ignore[method-assign]


def steps(bench: Bench) -> list[str]:
    return [row.step for row in bench.store.journal("j1")]


async def test_an_accepted_restart_is_commanded_and_waited_for(make_bench: MakeBench) -> None:
    bench = make_bench(reboot=True)
    working = asyncio.create_task(restart(bench.attempt()))
    await until(lambda: PREFLIGHT_REBOOT_SHUTDOWN in bench.vehicle.commands)
    assert bench.handle.job.prompt is None
    assert not working.done()
    restarted(bench)
    await working
    assert [s for s in steps(bench) if s.startswith("reboot")] == [JournalStep.REBOOT, JournalStep.REBOOTED]


async def test_without_an_accept_the_operator_is_asked_and_nothing_is_commanded(make_bench: MakeBench) -> None:
    bench = make_bench(reboot=True, accept_reboot=False)
    working = asyncio.create_task(restart(bench.attempt()))
    await until(lambda: bench.handle.job.prompt is not None)
    assert bench.handle.job.prompt is not None
    assert bench.handle.job.prompt.step == "reboot"
    assert bench.vehicle.commands == []
    restarted(bench)
    await working
    assert bench.handle.job.prompt is None
    assert JournalStep.REBOOT not in steps(bench)


async def test_a_vehicle_that_refuses_to_restart_has_the_operator_asked(make_bench: MakeBench) -> None:
    bench = make_bench(reboot=True)
    bench.vehicle.refused_commands = {PREFLIGHT_REBOOT_SHUTDOWN}
    working = asyncio.create_task(restart(bench.attempt()))
    await until(lambda: bench.handle.job.prompt is not None)
    assert bench.handle.job.prompt is not None
    assert bench.handle.job.prompt.step == "reboot"
    assert JournalStep.REBOOT in steps(bench)
    assert any("refused" in text for text in bench.handle.job.warnings)
    restarted(bench)
    await working


async def test_it_is_back_only_when_it_is_heard_disarmed_and_on_the_ground(make_bench: MakeBench) -> None:
    bench = make_bench(reboot=True)
    working = asyncio.create_task(restart(bench.attempt()))
    await until(lambda: bool(bench.vehicle.commands))
    restarted(bench, obstacles=("not on the ground",))
    await asyncio.sleep(0.01)
    assert not working.done()
    bench.vehicle.change_state(obstacles=())
    await working


async def test_another_vehicle_that_comes_back_is_not_written_to(make_bench: MakeBench) -> None:
    bench = make_bench(reboot=True)
    working = asyncio.create_task(restart(bench.attempt()))
    await until(lambda: bool(bench.vehicle.commands))
    says(bench, "ffff")
    restarted(bench)
    with pytest.raises(WriteFailed, match="another vehicle came back"):
        await working
    assert JournalStep.REBOOTED not in steps(bench)


async def test_one_that_does_not_say_who_it_is_is_taken_for_the_same(make_bench: MakeBench) -> None:
    bench = make_bench(reboot=True)
    working = asyncio.create_task(restart(bench.attempt()))
    await until(lambda: bool(bench.vehicle.commands))
    says(bench, None)
    restarted(bench)
    await working


async def test_arming_instead_stops_the_write(make_bench: MakeBench) -> None:
    bench = make_bench(reboot=True, accept_reboot=False)
    working = asyncio.create_task(restart(bench.attempt()))
    await until(lambda: bench.handle.job.prompt is not None)
    bench.vehicle.change_state(armed=True)
    with pytest.raises(WriteStopped, match="armed while it should restart"):
        await working


async def test_one_that_never_restarts_stops_the_write(make_bench: MakeBench) -> None:
    bench = make_bench(reboot=True)
    bench.settings = IMPATIENT
    with pytest.raises(WriteStopped, match="did not restart within 0 s"):
        await restart(bench.attempt())


async def test_what_is_commanded_is_a_plain_restart_of_the_autopilot_which_the_guard_of_commands_lets_through(
    make_bench: MakeBench,
) -> None:
    """MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN: 1 restarts it; other arguments mean another unit, or the bootloader."""
    bench = make_bench(reboot=True)
    sent: list[tuple[int, tuple[float, ...]]] = []

    async def command(number: int, params: Sequence[float]) -> None:
        check_allowed(number, params)
        sent.append((number, tuple(params)))
        restarted(bench)

    bench.vehicle.command = command  # type: ignore[method-assign]
    await restart(bench.attempt())
    assert sent == [(246, (1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))]
