"""A write in doubt is taken up where the journal and the vehicle say, told while it waits, and closed."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from typing import Any

import pytest

from mavcal.calib.firmware.plan import Movement, Verification
from mavcal.calib.procedures.protocol import Prompt, PromptStep
from mavcal.calib.recording import Identity
from mavcal.service.errors import VehicleUnknown
from mavcal.service.jobs.core.crashpoints import At
from mavcal.service.jobs.core.journal import BY_OPERATOR, JournalStep
from mavcal.service.jobs.core.model import Failure, Result
from mavcal.service.jobs.core.states import JobState
from mavcal.service.jobs.write.context import WriteContext
from mavcal.service.jobs.write.transaction import Transaction
from tests.patience import scaled
from tests.unit.jobs.conftest import NEW, OLD, QUICK, Bench, Killed, MakeBench, float32, until

EXPECTED = {name: float32(value) for name, value in NEW.items()}
BEFORE = {name: float32(OLD[name]) for name in NEW}


async def crashed(bench: Bench, at: At) -> Bench:
    """The service ends there, and begins again with the job in doubt."""

    def reach(now: At) -> None:
        if now == at:
            raise Killed

    bench.reach = reach
    with pytest.raises(Killed):
        await bench.apply()
    again = bench.restarted()
    again.handle.move(JobState.IN_DOUBT)
    return again


def steps(bench: Bench) -> list[str]:
    return [row.step for row in bench.store.journal("j1")]


async def shown(bench: Bench) -> list[str]:
    """The prompts that were shown, oldest first."""
    await bench.handle.kept()
    told = [e.data for e in bench.store.events("j1") if e.kind == "prompt"]
    return [str(data.get("text", "")) for data in told]


async def test_a_write_that_was_interrupted_before_its_restart_is_read_back_and_restarted(
    make_bench: MakeBench,
) -> None:
    again = await crashed(make_bench(reboot=True), At.READ_BACK)
    seen = len(steps(again))

    def reach(at: At) -> None:
        if at == At.REBOOT_SENT:
            asyncio.get_running_loop().call_later(0.01, lambda: again.vehicle.change_state(reboots=1))

    again.reach = reach
    await again.transaction.resolve()
    assert again.state == JobState.SUCCEEDED
    assert again.held() == EXPECTED
    done = steps(again)[seen:]
    assert done[:4] == ["read_back", "reboot", "rebooted", "read_back"]
    assert done[-1] == "closed"
    states = [e.data["state"] for e in again.store.events("j1") if e.kind == "state" and e.data]
    assert states[-4:] == ["in_doubt", "waiting_for_reboot", "verifying", "succeeded"]


async def test_what_was_lost_before_the_restart_is_found_before_the_vehicle_is_restarted(make_bench: MakeBench) -> None:
    """The first reading may be of what is not saved yet: it is read once more when that has settled."""
    again = await crashed(make_bench(reboot=True), At.READ_BACK)
    reads = 0
    read = again.vehicle.read_parameter

    async def forgetting(name: str) -> Any:
        nonlocal reads
        reads += name == "INS_GYROFFS_X"
        if reads == 2:
            again.vehicle.store("INS_GYROFFS_X", 0.0)
        return await read(name)

    again.vehicle.read_parameter = forgetting  # type: ignore[method-assign]
    await again.transaction.resolve()
    assert again.state == JobState.REVERTED
    assert 246 not in again.vehicle.commands


async def test_a_write_that_was_interrupted_after_its_restart_is_not_restarted_again(make_bench: MakeBench) -> None:
    bench = make_bench(reboot=True)

    def reach(at: At) -> None:
        if at == At.REBOOT_SENT:
            asyncio.get_running_loop().call_later(0.01, lambda: bench.vehicle.change_state(reboots=1))
        if at == At.REBOOTED:
            raise Killed

    bench.reach = reach
    with pytest.raises(Killed):
        await bench.apply()
    again = bench.restarted()
    again.handle.move(JobState.IN_DOUBT)
    await again.transaction.resolve()
    assert again.state == JobState.SUCCEEDED
    assert again.vehicle.commands.count(246) == 1
    assert "verified" in steps(again)


async def test_a_write_that_was_verified_is_only_finished(make_bench: MakeBench) -> None:
    again = await crashed(make_bench(), At.VERIFIED)
    seen = len(steps(again))
    await again.transaction.resolve()
    assert again.state == JobState.SUCCEEDED
    assert steps(again)[seen:] == ["command", "commanded", "closed"]


async def test_nothing_that_was_sent_is_closed_in_the_journal_and_back_in_review(make_bench: MakeBench) -> None:
    again = await crashed(make_bench(), At.SNAPSHOT_KEPT)
    await again.transaction.resolve()
    assert again.state == JobState.REVIEW
    assert steps(again)[-1] == "closed"
    outcome = again.handle.job.outcome
    assert isinstance(outcome, Failure)
    assert outcome.code == "interrupted"
    assert outcome.cause == "the service was interrupted while it wrote."
    assert outcome.remedy == "Nothing was written. Apply the plan again."


@pytest.mark.parametrize("sent", [False, True])
async def test_rates_are_put_back_before_a_write_is_closed(make_bench: MakeBench, sent: bool) -> None:
    bench = make_bench()
    bench.store.add_journal("j1", 0.0, JournalStep.STREAMS, {"intervals": {"27": 4000}})
    bench.vehicle.message_intervals[27] = 20000
    again = await crashed(bench, At.ECHO_KEPT if sent else At.SNAPSHOT_KEPT)
    await again.transaction.resolve()
    assert again.state == (JobState.REVERTED if sent else JobState.REVIEW)
    assert again.vehicle.message_intervals == {27: 4000}
    assert steps(again)[-2:] == ["streams_restored", "closed"]


async def test_rates_are_put_back_after_a_good_write(make_bench: MakeBench) -> None:
    bench = make_bench()
    bench.store.add_journal("j1", 0.0, JournalStep.STREAMS, {"intervals": {"27": 4000}})
    await bench.apply()
    assert bench.vehicle.message_intervals == {27: 4000}
    assert steps(bench)[-2:] == ["streams_restored", "closed"]


async def test_a_write_that_is_taken_back_is_closed(make_bench: MakeBench) -> None:
    again = await crashed(make_bench(), At.ECHO_KEPT)
    await again.transaction.resolve()
    assert again.state == JobState.REVERTED
    assert again.held() == BEFORE
    (row,) = [row for row in again.store.journal("j1") if row.step == JournalStep.ROLL_BACK]
    assert row.data["because"] == "the service was interrupted while it wrote"
    assert steps(again)[-1] == "closed"


async def test_a_cause_that_was_noted_first_is_that_of_the_taking_back(make_bench: MakeBench) -> None:
    again = await crashed(make_bench(), At.ECHO_KEPT)
    again.store.add_journal("j1", 0.0, JournalStep.STOPPED, {"reason": "the vehicle is armed"})
    await again.transaction.resolve()
    assert isinstance(again.handle.job.outcome, Failure)
    assert again.handle.job.outcome.cause == "the vehicle is armed."


async def test_a_taking_back_that_the_operator_asked_for_is_gone_on_with_as_such(make_bench: MakeBench) -> None:
    bench = make_bench()
    await bench.apply()
    await bench.handle.record(JournalStep.ROLL_BACK, because=BY_OPERATOR)
    bench.handle.move(JobState.ROLLING_BACK)
    again = bench.restarted()
    again.handle.move(JobState.IN_DOUBT)
    await again.transaction.resolve()
    assert again.state == JobState.REVERTED
    assert isinstance(again.handle.job.outcome, Result)  # no failure: it was asked for
    assert again.held() == BEFORE


async def test_another_vehicle_under_this_ones_address_is_not_written_to(make_bench: MakeBench) -> None:
    again = await crashed(make_bench(), At.ECHO_KEPT)
    sent = len(again.vehicle.sets)
    ours, again.vehicle.identity = again.vehicle.identity, Identity("ardupilot", 2, (4, 7, 0), "99", 1, 1)
    resolving = asyncio.create_task(again.transaction.resolve())
    await asyncio.sleep(0.02)
    assert again.state == JobState.IN_DOUBT
    assert len(again.vehicle.sets) == sent
    again.vehicle.identity = ours
    await resolving
    assert again.state == JobState.REVERTED


async def test_what_is_waited_for_is_told_until_the_write_is_at_its_end(make_bench: MakeBench) -> None:
    again = await crashed(make_bench(), At.ECHO_KEPT)
    again.vehicle.change_state(armed=True)
    resolving = asyncio.create_task(again.transaction.resolve())
    await until(lambda: again.handle.job.prompt is not None)
    text = "Waiting to finish this write or to take it back: the vehicle is armed."
    assert again.handle.job.prompt == Prompt(PromptStep.WAIT, text)
    again.vehicle.change_state(armed=False, conflict="Two vehicles answer.")
    await until(lambda: again.handle.job.prompt is not None and "Two" in again.handle.job.prompt.text)
    assert again.handle.job.prompt is not None
    assert again.handle.job.prompt.text.endswith("take it back: Two vehicles answer.")
    again.vehicle.change_state(conflict=None)
    await resolving
    assert again.state == JobState.REVERTED
    assert again.handle.job.prompt is None
    assert text in await shown(again)


async def test_a_vehicle_that_is_not_there_is_waited_for_and_that_is_told(make_bench: MakeBench) -> None:
    again = await crashed(make_bench(), At.ECHO_KEPT)
    there = False

    def attempt() -> WriteContext:
        if not there:
            raise VehicleUnknown("there is no vehicle vehicle-1")
        return again.attempt()

    resolving = asyncio.create_task(Transaction(again.handle, attempt, QUICK.retry_s).resolve())
    await until(lambda: again.handle.job.prompt is not None)
    assert again.handle.job.prompt is not None
    assert "take it back: there is no vehicle vehicle-1." in again.handle.job.prompt.text
    there = True
    await resolving
    assert again.state == JobState.REVERTED


async def test_a_defect_while_a_write_is_taken_up_does_not_strand_it(make_bench: MakeBench) -> None:
    again = await crashed(make_bench(), At.ECHO_KEPT)
    times = 0

    def attempt() -> WriteContext:
        nonlocal times
        times += 1
        if times == 1:
            raise RuntimeError("of any kind")
        return again.attempt()

    await Transaction(again.handle, attempt, QUICK.retry_s).resolve()
    assert times == 2
    assert again.state == JobState.REVERTED


async def test_a_taking_back_whose_vehicle_has_gone_is_in_doubt_and_made_later(make_bench: MakeBench) -> None:
    bench = make_bench()
    await bench.apply()
    await bench.handle.record(JournalStep.ROLL_BACK, because=BY_OPERATOR)
    bench.handle.move(JobState.ROLLING_BACK)
    seen: list[JobState] = []

    def attempt() -> WriteContext:
        seen.append(bench.state)
        if len(seen) == 1:
            raise VehicleUnknown("there is no vehicle vehicle-1")
        return bench.attempt()

    await Transaction(bench.handle, attempt, QUICK.retry_s).revert()
    assert seen == [JobState.ROLLING_BACK, JobState.IN_DOUBT]
    assert bench.state == JobState.REVERTED
    assert bench.held() == BEFORE


async def test_a_vehicle_that_has_gone_before_anything_was_sent_leaves_the_plan_in_review(
    make_bench: MakeBench,
) -> None:
    bench = make_bench()

    def attempt() -> WriteContext:
        raise VehicleUnknown("there is no vehicle vehicle-1")

    await Transaction(bench.handle, attempt, QUICK.retry_s).apply()
    assert bench.state == JobState.REVIEW
    assert isinstance(bench.handle.job.outcome, Failure)
    assert bench.handle.job.outcome.code == VehicleUnknown("").code


async def test_the_check_and_its_proof_are_kept_with_the_job(make_bench: MakeBench) -> None:
    bench = make_bench()
    bench.handle.prompt(Prompt(PromptStep.PROVE, "Turn it."))
    await bench.apply()
    job = bench.handle.job
    assert job.verification is not None
    assert job.verification.proved
    assert job.prompt is None
    await bench.handle.kept()
    (told,) = [e.data for e in bench.store.events("j1") if e.kind == "verification"]
    assert told == {"proved": True, "proof": "full"}


async def test_a_check_after_which_the_write_must_go_is_kept_and_taken_back(make_bench: MakeBench) -> None:
    bench = make_bench()
    bench.check.deaf.add("INS_GYROFFS_Y")
    await bench.apply()
    assert bench.handle.job.verification is not None
    assert bench.handle.job.verification.contradicted == ("INS_GYROFFS_Y",)
    assert "verified" not in steps(bench)


async def test_nobody_listens_to_the_vehicle_after_a_write(make_bench: MakeBench) -> None:
    bench = make_bench()
    await bench.apply()
    assert bench.vehicle._listeners == []
    assert bench.vehicle._frames == []


async def test_a_doubt_is_over_when_it_is_taken_up(make_bench: MakeBench) -> None:
    """What stood in doubt, and why, is not said any more once the write goes on."""
    again = await crashed(make_bench(), At.READ_BACK)
    again.handle.change("standing", {}, outcome=Failure("in-doubt", "a", "b"))
    seen: list[Any] = []
    check = again.check.after

    async def after(*arguments: Any) -> Verification:
        seen.append((again.state, again.handle.job.outcome, again.handle.job.standing))
        return replace(await check(*arguments), movement=Movement("x"))

    again.check.after = after  # type: ignore[method-assign]
    await again.transaction.resolve()
    assert seen == [(JobState.VERIFYING, None, ())]
    assert again.state == JobState.SUCCEEDED


async def test_a_write_that_is_resolved_waits_for_nothing_more(make_bench: MakeBench) -> None:
    """The pause is for the next try; its task claims the vehicle as long as it lasts."""
    again = await crashed(make_bench(), At.ECHO_KEPT)
    async with asyncio.timeout(scaled(20.0)):
        await Transaction(again.handle, again.attempt, 3600.0).resolve()
    assert again.state == JobState.REVERTED
