from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from dataclasses import replace
from typing import Any

import pytest

from mavcal.calib.firmware.plan import ParameterKind, Value, snapshot_sha256
from mavcal.calib.recording import Identity
from mavcal.service.errors import (
    ParameterMissing,
    ParameterTimeout,
    PlanBlocked,
    PlanChanged,
    WriteFailed,
    WriteStopped,
)
from mavcal.service.jobs.core.crashpoints import At
from mavcal.service.jobs.core.journal import JournalStep
from mavcal.service.jobs.write.context import Settling, WriteContext
from mavcal.service.jobs.write.steps import check_in_place, check_plan, prepare, read_back, send_all
from mavcal.service.store.rows import SnapshotPurpose
from mavcal.service.vehicle.job_vehicle import READS_IN_FLIGHT, Condition, ParameterReading, read_values
from tests.unit.jobs.conftest import NEW, OLD, QUICK, Bench, MakeBench, float32, until
from tests.unit.jobs.fakes import FakeVehicle

X = "INS_GYROFFS_X"
REAL = ParameterKind.REAL32


class Ticking(FakeVehicle):
    """Its clock goes on by `step` seconds whenever it is asked for its condition."""

    step = 1.0
    asked = 0

    def condition(self) -> Condition:
        self.asked += 1
        if self.state.boot_time is not None:
            self.state = replace(self.state, boot_time=self.state.boot_time + self.step)
        return self.state


def ticking(bench: Bench, boot_time: float | None, step: float = 1.0) -> Ticking:
    vehicle = Ticking(bench.vehicle.parameters, identity=bench.vehicle.identity)
    vehicle.state, vehicle.step = replace(vehicle.state, boot_time=boot_time), step
    bench.vehicle = vehicle
    return vehicle


class Hanging(FakeVehicle):
    """Never answers a PARAM_SET, and takes a while to be told to give up; says in which order things happened."""

    said: list[str]

    async def set_parameter(self, name: str, value: Value, kind: ParameterKind) -> ParameterReading:
        self.said.append("set")
        try:
            return await asyncio.get_running_loop().create_future()
        finally:
            for _ in range(10):
                await asyncio.sleep(0)
            self.said.append("given up")

    async def identify(self) -> Identity:
        self.said.append("asked who")
        return self.identity


def hanging(bench: Bench) -> Hanging:
    vehicle = Hanging(bench.vehicle.parameters, identity=bench.vehicle.identity)
    vehicle.said = []
    bench.vehicle = vehicle
    return vehicle


async def set_x(w: WriteContext) -> Value:
    return await w.set(X, 0.5, REAL, instead_of=0.0)


async def settled_s(work: Callable[[], Coroutine[Any, Any, object]]) -> float:
    """Seconds that it took at its quickest: a machine that stands still spoils one try of three."""
    loop = asyncio.get_running_loop()
    took = []
    while len(took) < 3 and min(took, default=1.0) >= 0.9:
        began = loop.time()
        await work()
        took.append(loop.time() - began)
    return min(took)


def rows(bench: Bench, step: JournalStep) -> list[Any]:
    return [row.data for row in bench.store.journal("j1") if row.step == step]


# --- one parameter


async def test_what_was_heard_before_is_forgotten_when_a_parameter_is_set(make_bench: MakeBench) -> None:
    bench = make_bench()
    w = bench.attempt()
    w.hear(ParameterReading(X, 7.0, REAL))
    assert w.heard == {X: 7.0}
    assert await set_x(w) == 0.5
    assert w.heard == {}
    assert bench.vehicle._listeners == []
    assert bench.vehicle.sets == [(X, 0.5)]
    assert await w.get(X) == 0.5


@pytest.mark.parametrize("value", [0.0, 0.5])
async def test_the_old_and_the_new_value_are_nobody_elses(make_bench: MakeBench, value: float) -> None:
    bench = make_bench()
    bench.vehicle.before_set = lambda _: bench.vehicle._tell(ParameterReading(X, value, REAL))
    assert await set_x(bench.attempt()) == 0.5


async def test_another_parameters_value_is_nobody_elses(make_bench: MakeBench) -> None:
    bench = make_bench()
    bench.vehicle.before_set = lambda _: bench.vehicle._tell(ParameterReading("INS_GYROFFS_Y", 9.0, REAL))
    assert await set_x(bench.attempt()) == 0.5


async def test_a_repetition_is_given_up_before_somebody_else_is_asked_for(make_bench: MakeBench) -> None:
    bench = make_bench()
    vehicle = hanging(bench)
    setting = asyncio.ensure_future(set_x(bench.attempt()))
    await until(lambda: vehicle.said == ["set"])
    vehicle._tell(ParameterReading(X, 9.0, REAL))
    vehicle._tell(ParameterReading(X, 8.0, REAL))  # the first one counts
    with pytest.raises(WriteFailed, match=f"somebody else set {X} to 9 meanwhile"):
        await setting
    assert sorted(vehicle.said) == ["asked who", "given up", "set"]
    assert vehicle._listeners == []


async def test_px4_itself_may_have_rewritten_a_gyro_offset(make_bench: MakeBench) -> None:
    bench, name = make_bench(), "CAL_GYRO0_XOFF"
    bench.vehicle.parameters[name] = ParameterReading(name, 0.0, REAL)
    vehicle = hanging(bench)
    setting = asyncio.ensure_future(bench.attempt().set(name, 0.5, REAL, instead_of=0.0))
    await until(lambda: vehicle.said == ["set"])
    vehicle._tell(ParameterReading(name, 0.25, REAL))
    with pytest.raises(WriteFailed, match=f"the vehicle itself or somebody else set {name} to 0.25 meanwhile"):
        await setting


async def test_a_set_that_is_cancelled_is_over_when_it_says_so(make_bench: MakeBench) -> None:
    bench = make_bench()
    vehicle = hanging(bench)
    setting = asyncio.ensure_future(set_x(bench.attempt()))
    await until(lambda: vehicle.said == ["set"])
    setting.cancel()
    with pytest.raises(asyncio.CancelledError):
        await setting
    assert vehicle.said == ["set", "given up"]


async def test_a_value_of_another_vehicle_is_found_by_asking_who_it_is(make_bench: MakeBench) -> None:
    bench = make_bench()
    w = bench.attempt()

    class Stranger(FakeVehicle):
        async def identify(self) -> Identity:
            self.identity = replace(self.identity, uid="99")
            return self.identity

    bench.vehicle.__class__ = Stranger
    with pytest.raises(WriteStopped, match="another vehicle"):
        await w.confirm_identity()


@pytest.mark.parametrize(("boot_time", "asked"), [(100.0, True), (None, False)])
async def test_the_vehicles_clock_is_waited_for_where_it_has_one(
    make_bench: MakeBench, boot_time: float | None, asked: bool
) -> None:
    bench = make_bench()
    vehicle = bench.vehicle
    vehicle.change_state(boot_time=boot_time)
    w = bench.attempt()
    w.settings = replace(QUICK, same_boot_s=60.0)
    waiting = asyncio.ensure_future(w.require_same_boot())
    for _ in range(20):
        await asyncio.sleep(0)
    assert waiting.done() is not asked
    if asked:
        vehicle.change_state(boot_time=101.0)
    await waiting


async def test_a_clock_that_stands_still_is_not_waited_for_for_ever(make_bench: MakeBench) -> None:
    bench = make_bench()
    bench.vehicle.change_state(boot_time=100.0)
    w = bench.attempt()
    w.settings = replace(QUICK, same_boot_s=0.03)
    assert 0.03 <= await settled_s(w.require_same_boot) < 0.9


async def test_a_restart_is_found_when_the_clock_is_heard_again(make_bench: MakeBench) -> None:
    bench = make_bench()
    w = bench.attempt()
    bench.vehicle.change_state(reboots=1)
    with pytest.raises(WriteStopped, match="restarted by itself"):
        await w.require_same_boot()


# --- what was kept


async def test_without_a_snapshot_of_the_old_values_nothing_is_written(make_bench: MakeBench) -> None:
    bench = make_bench()
    with pytest.raises(WriteFailed, match="no snapshot of the old values: nothing is written"):
        await send_all(bench.attempt())
    assert bench.vehicle.sets == []


async def test_the_old_values_are_kept_under_their_digest_before_anything_is_sent(make_bench: MakeBench) -> None:
    reached: list[At] = []
    bench = make_bench(session=True)
    bench.reach = reached.append
    w = bench.attempt()
    await prepare(w)
    old = {name: float32(OLD[name]) for name in ["FLAG", *NEW]}
    assert w.old_values() == old
    assert w.composed_on() == bench.vehicle.values()
    kept = bench.store.snapshot("j1", SnapshotPurpose.BEFORE_WRITE)
    assert kept is not None
    assert kept.body[X] == {"value": 0.0, "kind": "real32"}
    assert kept.sha256 == snapshot_sha256(old)
    assert rows(bench, JournalStep.SNAPSHOT) == [{"sha256": snapshot_sha256(old)}]
    assert reached == [At.SNAPSHOT_KEPT]
    assert bench.vehicle.sets == []


# --- waiting


@pytest.mark.parametrize(
    ("until_", "autopilot", "expected"),
    [
        (Settling.SAVED, "ardupilot", 50.0),
        (Settling.SAVED, "px4", 20.0),
        (Settling.KEPT, "ardupilot", 400.0),
        (Settling.KEPT, "px4", 900.0),
        (Settling.KEPT, "unheard of", 900.0),
        (Settling.RESTARTED, "ardupilot", 300.0),  # less by the 100 s that have passed since
    ],
)
async def test_how_long_it_settles_hangs_on_what_is_waited_for(
    make_bench: MakeBench, until_: Settling, autopilot: str, expected: float
) -> None:
    bench = make_bench()
    bench.vehicle.change_state(boot_time=100.0)
    w = bench.attempt()
    w.plan = replace(w.plan, fingerprint=replace(w.plan.fingerprint, autopilot=autopilot))
    w.settings = replace(QUICK, save_s={"ardupilot": 50.0, "px4": 20.0}, settle_s={"ardupilot": 400.0, "px4": 900.0})
    waiting = asyncio.ensure_future(w.settle(until_))
    await until(lambda: bench.handle.job.progress is not None)
    progress = bench.handle.job.progress
    assert progress is not None
    assert progress.text == until_.value
    assert progress.target == expected
    assert not waiting.done()
    waiting.cancel()
    with pytest.raises(asyncio.CancelledError):
        await waiting


@pytest.mark.parametrize(
    ("since", "boot_time", "step", "asked"),
    [
        (500.0, 500.0, 30.0, 4),  # at 620 s
        (500.0, 500.0, 25.0, 4),  # at 600 s
        (0.0, 10.0, 30.0, 3),  # since it started: at exactly 100 s
        (0.0, 500.0, 0.0, 1),  # they have passed already
    ],
)
async def test_the_vehicles_clock_says_when_it_has_settled(
    make_bench: MakeBench, since: float, boot_time: float, step: float, asked: int
) -> None:
    bench = make_bench()
    vehicle = ticking(bench, boot_time, step)
    w = bench.attempt()
    vehicle.state, vehicle.asked = replace(vehicle.state, boot_time=boot_time), 0
    await asyncio.wait_for(w._settled(100.0, since), 5.0)
    assert vehicle.asked == asked


async def test_it_settles_by_our_clock_where_the_vehicle_has_none(make_bench: MakeBench) -> None:
    bench = make_bench()
    assert 0.03 <= await settled_s(lambda: bench.attempt()._settled(0.03, None)) < 0.9


async def test_the_least_time_is_waited_whatever_the_vehicles_clock_says(make_bench: MakeBench) -> None:
    bench = make_bench()
    bench.vehicle.change_state(boot_time=1000.0)
    w = bench.attempt()
    w.settings = replace(QUICK, settle_least_s=0.03)
    assert 0.03 <= await settled_s(lambda: w._settled(60.0, 0.0)) < 0.9


# --- reading


class Busy(FakeVehicle):
    """Counts the reads that are under way at once."""

    under_way = most = 0

    async def read_parameter(self, name: str) -> ParameterReading:
        self.under_way += 1
        self.most = max(self.most, self.under_way)
        try:
            await asyncio.sleep(0)
            return await super().read_parameter(name)
        finally:
            self.under_way -= 1


async def test_a_few_reads_at_a_time_each_name_once_and_counted() -> None:
    names = [f"P{k}" for k in range(25)]
    vehicle = Busy.with_floats(dict.fromkeys(names, 1.0))
    told: list[int] = []
    found = await read_values(vehicle, [*names[::-1], "P3"], progress=told.append)
    assert list(found) == names[::-1]
    assert told == list(range(1, 26))
    assert vehicle.most == READS_IN_FLIGHT == 10


async def test_what_the_vehicle_does_not_have_is_left_out_or_an_error() -> None:
    vehicle = FakeVehicle.with_floats({"A": 1.0})
    told: list[int] = []
    assert list(await read_values(vehicle, ["A", "B"], absent=True, progress=told.append)) == ["A"]
    assert told == [1, 2]
    with pytest.raises(ParameterMissing, match="B is unknown"):
        await read_values(vehicle, ["A", "B"])
    vehicle.mute = {"A"}
    with pytest.raises(ParameterTimeout):
        await read_values(vehicle, ["A", "B"], absent=True)


# --- the plan against the vehicle


def changed_x(bench: Bench) -> None:
    bench.vehicle.store(X, 0.25)


def without_x(bench: Bench) -> None:
    del bench.vehicle.parameters[X]


def other_kind(bench: Bench) -> None:
    bench.vehicle.parameters[X] = replace(bench.vehicle.parameters[X], kind=ParameterKind.INT32)


def other_firmware(bench: Bench) -> None:
    bench.vehicle.identity = replace(bench.vehicle.identity, firmware=(4, 8, 0))


def other_digest(bench: Bench) -> None:
    bench.plan = replace(bench.plan, snapshot_sha256="0" * 64)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (changed_x, f"parameters changed since the plan was made: {X} was 0 and is 0.25. Plan again"),
        (without_x, f"the vehicle no longer has {X}: plan again"),
        (other_kind, f"types are not those of the plan: {X} is int32, not real32. Plan again"),
        (other_digest, "no longer what the plan was made for"),
        (other_firmware, "no longer what the plan was made for"),
    ],
)
async def test_a_plan_that_no_longer_fits_is_refused_with_what_differs(
    make_bench: MakeBench, change: Callable[[Bench], None], words: str
) -> None:
    bench = make_bench()
    assert set(await check_plan(bench.attempt())) == set(OLD)
    change(bench)
    with pytest.raises(PlanChanged, match=words):
        await check_plan(bench.attempt())


async def test_a_blocked_plan_is_refused_before_the_vehicle_is_asked(make_bench: MakeBench) -> None:
    bench = make_bench()
    bench.plan = replace(bench.plan, blockers=("this", "that"))
    vehicle = hanging(bench)
    with pytest.raises(PlanBlocked, match="the plan may not be written: this; that"):
        await check_plan(bench.attempt())
    assert vehicle.said == []


# --- all of it


async def test_every_parameter_is_announced_sent_and_confirmed_in_the_plans_order(make_bench: MakeBench) -> None:
    reached: list[At] = []
    bench = make_bench(session=True)
    bench.reach = reached.append
    w = bench.attempt()
    await prepare(w)
    reached.clear()
    await send_all(w)
    assert bench.handle.job.progress is not None
    assert bench.handle.job.progress.text == "writing: 4 of 4"
    assert reached == [At.BEFORE_SEND, At.AFTER_ECHO, At.ECHO_KEPT] * 4
    sent = rows(bench, JournalStep.SEND)
    new = {"FLAG": 0.0, **{name: float32(value) for name, value in NEW.items()}}
    assert [(d["name"], d["old"], d["new"]) for d in sent] == [(n, float32(OLD[n]), v) for n, v in new.items()]
    assert [(d["kind"], d["session"]) for d in sent] == [("real32", True)] + [("real32", False)] * 3
    assert [(d["name"], d["value"]) for d in rows(bench, JournalStep.ECHO)] == list(new.items())


async def test_a_vehicle_that_may_not_be_written_to_is_found_before_the_announcement(make_bench: MakeBench) -> None:
    bench = make_bench()
    w = bench.attempt()
    await prepare(w)
    bench.vehicle.change_state(armed=True)
    with pytest.raises(WriteStopped, match="armed"):
        await send_all(w)
    assert rows(bench, JournalStep.SEND) == []


async def test_what_was_read_back_is_in_the_journal(make_bench: MakeBench) -> None:
    reached: list[At] = []
    bench = make_bench()
    bench.reach = reached.append
    w = bench.attempt()
    await prepare(w)
    with pytest.raises(WriteFailed, match=f"the read-back differs: {X} holds 0 instead of 0.00999999978"):
        await read_back(w)
    assert rows(bench, JournalStep.READ_BACK) == []
    await send_all(w)
    reached.clear()
    assert await read_back(w) == bench.held()
    assert bench.handle.job.progress is not None
    assert bench.handle.job.progress.text == "reading back: 3 of 3"
    assert len(rows(bench, JournalStep.READ_BACK)) == 1
    assert reached == [At.READ_BACK]


def test_every_parameter_that_differs_is_named(make_bench: MakeBench) -> None:
    bench = make_bench()
    right = {change.name: change.new for change in bench.plan.changes}
    check_in_place(bench.plan.changes, right)
    with pytest.raises(WriteFailed, match=r"INS_GYROFFS_X holds 1 instead of .*, INS_GYROFFS_Z holds 2 instead of"):
        check_in_place(bench.plan.changes, right | {X: 1.0, "INS_GYROFFS_Z": 2.0})
