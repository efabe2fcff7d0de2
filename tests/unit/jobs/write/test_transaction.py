from __future__ import annotations

import asyncio
from contextlib import suppress
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from mavcal.calib.firmware.plan import ParameterKind
from mavcal.calib.recording import Identity
from mavcal.service.errors import DiskFull
from mavcal.service.jobs.core.crashpoints import At
from mavcal.service.jobs.core.journal import BY_OPERATOR, JournalStep, Saved
from mavcal.service.jobs.core.model import Failure, Result, Unwritten
from mavcal.service.jobs.core.states import JobState
from mavcal.service.jobs.write.outcome import settle_lost_write
from mavcal.service.vehicle.job_vehicle import ParameterReading
from tests.examples import examples
from tests.unit.jobs.conftest import IMPATIENT, NEW, OLD, QUICK, Bench, Killed, MakeBench, float32, until

EXPECTED = {name: float32(value) for name, value in NEW.items()}
BEFORE = {name: float32(OLD[name]) for name in NEW}


async def test_a_good_write_is_written_read_back_checked_and_closed(make_bench: MakeBench) -> None:
    bench = make_bench()
    await bench.apply()
    assert bench.state == JobState.SUCCEEDED
    assert bench.held() == EXPECTED
    assert [name for name, _ in bench.vehicle.sets] == list(NEW)  # the plan's order, each once
    assert bench.vehicle.commands == [241]
    assert isinstance(bench.handle.job.outcome, Result)
    steps = [row.step for row in bench.store.journal("j1")]
    assert steps[:4] == ["accepted", "snapshot", "send", "echo"]
    assert steps[-4:] == ["verified", "command", "commanded", "closed"]


async def test_the_snapshot_is_kept_and_the_send_announced_before_anything_is_sent(make_bench: MakeBench) -> None:
    bench = make_bench()
    seen: list[tuple[int, list[str]]] = []
    bench.vehicle.before_set = lambda n: seen.append((n, [row.step for row in bench.store.journal("j1")]))
    await bench.apply()
    for number, steps in seen:
        assert "snapshot" in steps
        assert steps.count("send") == number
        assert steps.count("echo") == number - 1


async def test_session_settings_come_back(make_bench: MakeBench) -> None:
    bench = make_bench(session=True)
    await bench.apply()
    assert bench.state == JobState.SUCCEEDED
    assert bench.vehicle.values()["FLAG"] == 1.0
    assert bench.vehicle.sets[0] == ("FLAG", 0.0)
    assert bench.vehicle.sets[-1] == ("FLAG", 1.0)


@pytest.mark.parametrize(
    "trouble",
    [{"armed": True}, {"calibrating": True}, {"obstacles": ("it flies",)}, {"conflict": "two of them"}],
    ids=["armed", "calibrating", "flying", "conflict"],
)
async def test_nothing_is_sent_to_a_vehicle_that_is_not_ready(make_bench: MakeBench, trouble: dict[str, Any]) -> None:
    bench = make_bench()
    bench.settings = IMPATIENT
    bench.vehicle.change_state(**trouble)
    await bench.apply()
    assert bench.state == JobState.REVIEW
    assert bench.vehicle.sets == []
    assert isinstance(bench.handle.job.outcome, Unwritten)
    assert bench.handle.job.outcome.code == ("vehicle-busy" if "calibrating" in trouble else "write-stopped")


async def test_a_parameter_that_counted_as_absent_but_is_there_stops_the_write(make_bench: MakeBench) -> None:
    bench = make_bench()
    bench.vehicle.parameters["INS_TCAL1_ENABLE"] = ParameterReading("INS_TCAL1_ENABLE", 1.0, ParameterKind.REAL32)
    await bench.apply()
    assert bench.state == JobState.REVIEW
    assert bench.vehicle.sets == []
    assert isinstance(bench.handle.job.outcome, Unwritten)
    assert bench.handle.job.outcome.code == "plan-changed"
    assert bench.handle.job.outcome.cause.startswith("INS_TCAL1_ENABLE did not answer when")


@pytest.mark.parametrize("case", ["value", "identity", "missing"])
async def test_a_plan_for_something_else_is_not_written(make_bench: MakeBench, case: str) -> None:
    bench = make_bench()
    if case == "value":
        bench.vehicle.store("INS_GYR_ID", 77.0)
    elif case == "identity":
        bench.vehicle.identity = Identity("ardupilot", 2, (4, 8, 0), "00112233", 1, 1)
    else:
        del bench.vehicle.parameters["INS_GYR_ID"]
    await bench.apply()
    assert bench.state == JobState.REVIEW
    assert bench.vehicle.sets == []
    assert isinstance(bench.handle.job.outcome, Unwritten)
    assert bench.handle.job.outcome.code == "plan-changed"
    assert "lan again" in bench.handle.job.outcome.cause


async def test_a_parameter_without_an_answer_takes_everything_back(make_bench: MakeBench) -> None:
    bench = make_bench()
    bench.vehicle.before_set = lambda n: bench.vehicle.mute.add("INS_GYROFFS_Z") if n == 2 else None

    def speak_again(at: At) -> None:
        if at == At.ROLLBACK_BEGUN:
            bench.vehicle.mute.clear()

    bench.reach = speak_again
    await bench.apply()
    assert bench.state == JobState.REVERTED
    assert bench.held() == BEFORE
    assert bench.vehicle.sets[-2:] == [  # in reverse order
        ("INS_GYROFFS_Y", BEFORE["INS_GYROFFS_Y"]),
        ("INS_GYROFFS_X", BEFORE["INS_GYROFFS_X"]),
    ]
    assert isinstance(bench.handle.job.outcome, Failure)


async def test_echoed_but_not_stored_is_found_by_the_read_back(make_bench: MakeBench) -> None:
    bench = make_bench()
    bench.vehicle.deaf.add("INS_GYROFFS_Y")
    await bench.apply()
    assert bench.state == JobState.REVERTED
    assert bench.held() == BEFORE


async def test_stored_but_without_effect_is_found_by_the_stream(make_bench: MakeBench) -> None:
    bench = make_bench()
    bench.check.deaf.add("INS_GYROFFS_Y")
    await bench.apply()
    assert bench.state == JobState.REVERTED
    assert bench.held() == BEFORE
    assert isinstance(bench.handle.job.outcome, Failure)
    assert "INS_GYROFFS_Y" in bench.handle.job.outcome.cause


@pytest.mark.parametrize("worse", [KeyError("x"), AssertionError(), ExceptionGroup("several", [KeyError("y")])])
async def test_what_nobody_foresaw_while_rolling_back_leaves_no_method_and_is_tried_again(
    make_bench: MakeBench, worse: Exception
) -> None:
    """The transaction itself goes on, without a supervisor that takes the job up once more."""
    bench = make_bench()
    bench.check.deaf.add("INS_GYROFFS_Y")
    broken, states = iter([worse]), []

    def break_once(at: At) -> None:
        if at == At.ROLLBACK_BEGUN:
            states.append(bench.state)
            for error in broken:
                raise error

    bench.reach = break_once
    await bench.apply()
    assert states == [JobState.ROLLING_BACK, JobState.ROLLING_BACK]
    assert JournalStep.STOPPED in [row.step for row in bench.store.journal("j1")]
    assert bench.state == JobState.REVERTED
    assert bench.held() == BEFORE


async def test_a_refused_command_takes_everything_back(make_bench: MakeBench) -> None:
    bench = make_bench()
    bench.vehicle.refused_commands.add(241)
    await bench.apply()
    assert bench.state == JobState.REVERTED
    assert bench.held() == BEFORE


@pytest.mark.parametrize("trouble", [{"armed": True}, {"silent": True}, {"conflict": "two"}, {"reboots": 1}])
async def test_trouble_in_the_middle_stops_at_once(make_bench: MakeBench, trouble: dict[str, Any]) -> None:
    bench = make_bench()
    bench.vehicle.after_set = lambda n: bench.vehicle.change_state(**trouble) if n == 2 else None
    running = asyncio.create_task(bench.apply())
    if "reboots" not in trouble:
        await until(lambda: bench.state == JobState.IN_DOUBT)
        sent = len(bench.vehicle.sets)
        await asyncio.sleep(0.01)
        assert len(bench.vehicle.sets) == sent == 2  # nothing more, for as long as it lasts
        true = bench.held()
        for known in bench.handle.job.standing:
            assert known.value == true[known.name] if known.certain else true[known.name] in (known.old, known.new)
        bench.vehicle.change_state(armed=False, silent=False, conflict=None)
    await running
    assert bench.state == JobState.REVERTED
    assert bench.held() == BEFORE


async def test_armed_after_the_last_parameter_ends_well(make_bench: MakeBench) -> None:
    bench = make_bench()
    bench.vehicle.after_set = lambda n: bench.vehicle.change_state(armed=True) if n == 3 else None
    running = asyncio.create_task(bench.apply())
    await until(lambda: bench.state == JobState.IN_DOUBT)
    bench.vehicle.change_state(armed=False)
    await running
    assert bench.state == JobState.SUCCEEDED
    assert bench.held() == EXPECTED


async def test_a_third_partys_value_is_left_and_named(make_bench: MakeBench) -> None:
    bench = make_bench()
    bench.vehicle.after_set = lambda n: bench.vehicle.store("INS_GYROFFS_X", 0.125) if n == 3 else None
    await bench.apply()
    assert bench.state == JobState.REVERTED
    assert bench.held() == {**BEFORE, "INS_GYROFFS_X": 0.125}
    assert [(s.name, s.value) for s in bench.handle.job.standing] == [("INS_GYROFFS_X", 0.125)]
    outcome = bench.handle.job.outcome
    assert isinstance(outcome, Failure)
    said = (
        "The old values are back, read and verified, except INS_GYROFFS_X, which somebody else set to 0.125 (0 before)."
    )
    assert said in outcome.remedy


async def test_a_value_that_another_vehicle_said_is_neither_left_nor_certain(make_bench: MakeBench) -> None:
    """Two vehicles with one address: that there are two shows only when they are asked who they are."""
    bench = make_bench()
    bench.vehicle.after_set = lambda n: bench.vehicle.store("INS_GYROFFS_X", 0.125) if n == 3 else None
    original = bench.vehicle.identify

    async def identify() -> Any:
        if bench.state == JobState.ROLLING_BACK:
            bench.vehicle.change_state(conflict="two vehicles answer")
        return await original()

    bench.vehicle.identify = identify  # type: ignore[method-assign]
    running = asyncio.create_task(bench.apply())
    await until(lambda: bench.state == JobState.IN_DOUBT)
    assert not any(known.certain for known in bench.handle.job.standing)
    running.cancel()


async def test_somebody_elses_value_heard_meanwhile_is_not_overwritten_by_a_repetition(make_bench: MakeBench) -> None:
    bench = make_bench()

    async def never_echoed(name: str, value: Any, kind: Any) -> Any:
        if name == "INS_GYROFFS_Y":
            bench.vehicle.store(name, 0.125)  # its PARAM_VALUE is heard; the echo of ours never comes
            await asyncio.sleep(30)
        return await original(name, value, kind)

    original = bench.vehicle.set_parameter
    bench.vehicle.set_parameter = never_echoed  # type: ignore[method-assign]
    await bench.apply()
    assert bench.state == JobState.REVERTED
    assert bench.held() == {**BEFORE, "INS_GYROFFS_Y": 0.125}
    assert isinstance(bench.handle.job.outcome, Failure)
    assert "omebody else set INS_GYROFFS_Y to 0.125" in bench.handle.job.outcome.cause


async def test_what_was_never_sent_but_changed_meanwhile_is_named(make_bench: MakeBench) -> None:
    bench = make_bench()
    bench.vehicle.after_set = lambda n: bench.vehicle.store("INS_GYROFFS_Z", 0.5)

    def speak_again(at: At) -> None:
        if at == At.ROLLBACK_BEGUN:
            bench.vehicle.mute.clear()

    bench.reach = speak_again
    bench.vehicle.before_set = lambda n: bench.vehicle.mute.add("INS_GYROFFS_Y") if n == 1 else None
    await bench.apply()
    assert bench.state == JobState.REVERTED
    assert [s.name for s in bench.handle.job.standing] == ["INS_GYROFFS_Z"]
    assert bench.held() == {**BEFORE, "INS_GYROFFS_Z": 0.5}


async def test_after_a_restart_nothing_is_certain(make_bench: MakeBench) -> None:
    bench = make_bench()

    def fail(n: int) -> None:
        if n == 2:
            bench.vehicle.change_state(reboots=1, armed=True)

    bench.vehicle.after_set = fail
    running = asyncio.create_task(bench.apply())
    await until(lambda: bench.state == JobState.IN_DOUBT)
    assert bench.handle.job.standing
    assert not any(s.certain for s in bench.handle.job.standing)
    assert "restarted" in bench.handle.job.standing[0].note
    bench.vehicle.change_state(armed=False)
    await running
    assert bench.held() == BEFORE


def _calibrates_at_boot(bench: Bench, *, silent_first: bool) -> None:
    """The vehicle restarts in mid-write, and its boot calibration rewrites every parameter of the plan."""
    vehicle, values = bench.vehicle, iter((0.2, 0.3, 0.4))

    def boot() -> None:
        vehicle.change_state(reboots=1, silent=False, boot_time=1.0)
        for name in NEW:
            vehicle.store(name, float32(next(values)))

    def strike(n: int) -> None:
        if n == 2:
            if silent_first:
                vehicle.change_state(silent=True)
                asyncio.get_running_loop().call_later(0.05, boot)
            else:  # its new values are heard before its clock shows the restart
                vehicle.store("INS_GYROFFS_Y", float32(0.3))
                asyncio.get_running_loop().call_later(0.02, boot)

    vehicle.change_state(boot_time=100.0)
    vehicle.after_set = strike


@pytest.mark.parametrize("silent_first", [True, False])
async def test_a_restart_stays_the_cause_and_its_boot_calibration_is_not_called_the_old_values(
    make_bench: MakeBench, silent_first: bool
) -> None:
    bench = make_bench()
    _calibrates_at_boot(bench, silent_first=silent_first)
    await bench.apply()
    job = bench.handle.job
    assert job.state == JobState.REVERTED
    assert isinstance(job.outcome, Failure)
    assert job.outcome.cause == "the vehicle restarted by itself."
    assert job.outcome.remedy.startswith("No old value is back: INS_GYROFFS_X (now 0.2")
    assert "which the vehicle itself or somebody else set" in job.outcome.remedy
    assert {s.name: s.value for s in job.standing} == bench.held()


async def test_a_value_lost_in_a_restart_is_no_cause_of_its_own(make_bench: MakeBench) -> None:
    """The read-back differs because the vehicle restarted; that shows on its clock only afterwards."""
    bench = make_bench()
    bench.vehicle.change_state(boot_time=100.0)

    def strike(n: int) -> None:
        if n == 3:
            bench.vehicle.parameters["INS_GYROFFS_X"] = bench.before["INS_GYROFFS_X"]
            loop = asyncio.get_running_loop()
            loop.call_later(0.05, lambda: bench.vehicle.change_state(reboots=1, boot_time=1.0))

    bench.vehicle.after_set = strike
    await bench.apply()
    assert isinstance(bench.handle.job.outcome, Failure)
    assert bench.handle.job.outcome.cause == "the vehicle restarted by itself."
    assert bench.held() == BEFORE


async def test_a_write_that_could_not_begin_says_so_in_a_field_and_an_event(make_bench: MakeBench) -> None:
    bench = make_bench()
    bench.vehicle.change_state(armed=True)
    await bench.apply()
    last = bench.handle.job.last_write
    assert last is not None
    assert (last.result, last.sent) == ("failed", 0)
    assert (last.cause, last.remedy) == ("the vehicle is armed.", "Nothing was written.")
    told = [event.data for event in bench.store.events("j1") if event.kind == "write"]
    assert [(data["result"], data["sent"]) for data in told] == [("failed", 0)]
    row = bench.store.job("j1")
    assert row is not None
    assert row.body["last_write"]["cause"] == "the vehicle is armed."


async def test_armed_between_snapshot_and_first_parameter_is_no_doubt(make_bench: MakeBench) -> None:
    """The journal says that nothing was sent: there is nothing to be in doubt of."""
    bench = make_bench()
    bench.reach = lambda at: bench.vehicle.change_state(armed=True) if at == At.SNAPSHOT_KEPT else None
    await bench.apply()
    assert bench.state == JobState.REVIEW
    assert bench.handle.job.last_write is not None
    assert bench.handle.job.last_write.sent == 0
    assert bench.vehicle.sets == []


async def test_every_end_of_a_write_is_its_last_attempt(make_bench: MakeBench) -> None:
    bench = make_bench()
    await bench.apply()
    assert bench.handle.job.last_write is not None
    assert (bench.handle.job.last_write.result, bench.handle.job.last_write.sent) == ("succeeded", 3)
    deaf = make_bench()
    deaf.check.deaf.add("INS_GYROFFS_Y")
    await deaf.apply()
    assert deaf.handle.job.last_write is not None
    assert (deaf.handle.job.last_write.result, deaf.handle.job.last_write.sent) == ("reverted", 3)


async def test_a_session_setting_that_somebody_else_set_is_named_in_a_success(make_bench: MakeBench) -> None:
    bench = make_bench(session=True)
    bench.reach = lambda at: bench.vehicle.store("FLAG", 7.0) if at == At.VERIFIED else None
    await bench.apply()
    job = bench.handle.job
    assert job.state == JobState.SUCCEEDED
    assert isinstance(job.outcome, Result)
    assert "are back, except FLAG, which the vehicle itself or somebody else set to 7 (1 before)." in job.outcome.text
    assert [(s.name, s.value) for s in job.standing] == [("FLAG", 7.0)]


async def test_revert_of_a_finished_write(make_bench: MakeBench) -> None:
    bench = make_bench()
    await bench.apply()
    await bench.handle.record(JournalStep.ROLL_BACK, because=BY_OPERATOR)
    bench.handle.move(JobState.ROLLING_BACK)
    await bench.transaction.revert()
    assert bench.state == JobState.REVERTED
    assert bench.held() == BEFORE
    assert isinstance(bench.handle.job.outcome, Result)


async def test_our_own_restart_is_waited_for(make_bench: MakeBench) -> None:
    bench = make_bench(reboot=True)

    def reach(at: At) -> None:
        if at == At.REBOOT_SENT:
            asyncio.get_running_loop().call_later(0.02, lambda: bench.vehicle.change_state(reboots=1))

    bench.reach = reach
    await bench.apply()
    assert bench.vehicle.commands == [246, 241]
    assert bench.state == JobState.SUCCEEDED


async def test_the_operator_is_asked_to_restart(make_bench: MakeBench) -> None:
    bench = make_bench(reboot=True, accept_reboot=False)
    running = asyncio.create_task(bench.apply())
    await until(lambda: bench.handle.job.prompt is not None)
    assert bench.handle.job.prompt is not None
    assert bench.state == JobState.WAITING_FOR_REBOOT
    assert bench.handle.job.prompt.step == "reboot"
    bench.vehicle.change_state(reboots=1)
    await running
    assert bench.state == JobState.SUCCEEDED
    assert bench.vehicle.commands == [241]
    assert bench.handle.job.prompt is None


async def test_a_full_disk_before_a_send_takes_back_what_was_sent(make_bench: MakeBench) -> None:
    bench = make_bench()
    page_limit = bench.store._db.execute("PRAGMA max_page_count").fetchone()[0]

    def full(n: int) -> None:
        if n == 1:
            pages = bench.store._db.execute("PRAGMA page_count").fetchone()[0]
            bench.store._db.execute(f"PRAGMA max_page_count = {pages}")
            while True:  # use up what is left of the last page
                try:
                    bench.store.add_event("j1", 0.0, "filler", {"x": "y" * 50})
                except DiskFull:
                    return

    bench.vehicle.after_set = full
    await bench.apply()
    assert bench.held() == BEFORE
    assert bench.state == JobState.REVERTED
    bench.store._db.execute(f"PRAGMA max_page_count = {page_limit}")


CRASHES = [
    at for at in At if at.value not in ("capture_started", "capture_running", "capture_closed", "fitted", "accepted")
]


def _kill_at(bench: Bench, at: At, occurrence: int) -> list[At]:
    struck: list[At] = []
    count = 0

    def reach(now: At) -> None:
        nonlocal count
        count += now == at
        if now == at and count == occurrence:
            struck.append(now)
            raise Killed

    bench.reach = reach
    return struck


async def _resumed(bench: Bench) -> Bench:
    """What the service does with a job at its start."""
    again = bench.restarted()
    if again.state not in (JobState.SUCCEEDED, JobState.REVERTED, JobState.REVIEW):
        if again.state != JobState.IN_DOUBT:
            again.handle.move(JobState.IN_DOUBT)
        await again.transaction.resolve()
    return again


@settings(max_examples=examples(150), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    first=st.sampled_from(CRASHES),
    first_at=st.integers(1, 4),
    second=st.sampled_from([*CRASHES, None]),
    deaf=st.booleans(),
    third_party=st.integers(0, 4),
    session=st.booleans(),
)
def test_killed_anywhere_twice_it_ends_verified_or_as_before(
    make_bench: MakeBench,
    first: At,
    first_at: int,
    second: At | None,
    deaf: bool,
    third_party: int,
    session: bool,
) -> None:
    async def run() -> Bench:
        bench = make_bench(session=session)
        if deaf:
            bench.check.deaf.add("INS_GYROFFS_Y")
        if third_party:
            bench.vehicle.after_set = lambda n: (
                bench.vehicle.store("INS_GYROFFS_X", 0.125) if n == third_party else None
            )
        _kill_at(bench, first, first_at)
        with suppress(Killed):
            await bench.apply()
        again = bench.restarted()
        if second is not None and again.state in (
            JobState.APPLYING,
            JobState.VERIFYING,
            JobState.ROLLING_BACK,
            JobState.IN_DOUBT,
        ):
            _kill_at(again, second, 1)
            if again.state != JobState.IN_DOUBT:
                again.handle.move(JobState.IN_DOUBT)
            with suppress(Killed):
                await again.transaction.resolve()
        return await _resumed(again)

    bench = asyncio.run(run())
    held = bench.held()
    foreign = {n: v for n, v in held.items() if v not in (BEFORE[n], EXPECTED[n])}
    assert set(foreign) <= {"INS_GYROFFS_X"}
    if bench.state == JobState.SUCCEEDED:
        assert held == EXPECTED
        assert not deaf
    else:
        assert bench.state in (JobState.REVERTED, JobState.REVIEW)
        assert {n: v for n, v in held.items() if n not in foreign} == {
            n: v for n, v in BEFORE.items() if n not in foreign
        }
        if bench.state == JobState.REVIEW:
            assert bench.vehicle.sets == []
    assert bench.vehicle.values()["FLAG"] == 1.0


def test_settings_give_each_autopilot_time_to_save() -> None:
    from mavcal.service.jobs.core.settings import JobSettings

    patient = JobSettings()
    assert patient.settle_s["ardupilot"] >= 1.0  # its I/O thread
    assert patient.settle_s["px4"] > 5.0  # gyro_calibration rewrites 5 s after the last change
    assert patient.save_s["ardupilot"] >= 1.0
    assert patient.save_s["px4"] > 2.3  # the pause between two savings, and the delay before one
    assert QUICK.settle_s["px4"] == 0.0


async def stopped_at_the_restart(bench: Bench) -> Bench:
    """The service ended while it waited for the operator's restart; what the next one finds."""
    writing = asyncio.create_task(bench.apply())
    await until(lambda: bench.handle.job.prompt is not None and bench.handle.job.prompt.step == "reboot")
    writing.cancel()
    await asyncio.gather(writing, return_exceptions=True)
    again = bench.restarted()
    await settle_lost_write(again.handle, "the service was interrupted")
    return again


async def test_a_restart_that_came_while_nobody_listened_is_not_asked_for_again(make_bench: MakeBench) -> None:
    bench = make_bench(reboot=True, accept_reboot=False)
    bench.vehicle.change_state(boot_time=100.0)
    again = await stopped_at_the_restart(bench)
    again.vehicle.change_state(boot_time=12.0)
    prompts: list[str] = []
    again.handle.prompt = lambda prompt: prompts.append(prompt.text if prompt else "")  # type: ignore[method-assign]
    await again.transaction.resolve()
    assert again.state == JobState.SUCCEEDED
    assert again.held() == EXPECTED
    assert not any("Restart" in text for text in prompts)


async def test_without_a_sign_of_a_restart_it_is_asked_for(make_bench: MakeBench) -> None:
    bench = make_bench(reboot=True, accept_reboot=False)
    bench.vehicle.change_state(boot_time=100.0)
    again = await stopped_at_the_restart(bench)
    again.vehicle.change_state(boot_time=101.0)
    resolving = asyncio.create_task(again.transaction.resolve())
    await until(lambda: again.handle.job.prompt is not None and again.handle.job.prompt.step == "reboot")
    again.vehicle.change_state(reboots=1, boot_time=1.0)
    await resolving
    assert again.state == JobState.SUCCEEDED


@pytest.mark.parametrize(
    ("passed", "boot_time", "restarted"),
    [
        (10.0, 99.0, True),  # it has run for less than before
        (10.0, 110.0, False),
        (3600.0, 3700.0, False),
        (3600.0, 3500.0, False),  # its clock may be slow by 5 %
        (3600.0, 600.0, True),
        (103.0, 100.5, False),  # too near to be told apart
    ],
)
def test_what_tells_of_a_restart(passed: float, boot_time: float, restarted: bool) -> None:
    assert Saved(1000.0, 100.0).restarted_since(1000.0 + passed, boot_time) == restarted
