"""Taking a write back: the last parameter first, never over somebody else's value, and as often as a crash asks for."""

from __future__ import annotations

from typing import Any

import pytest

from mavcal.calib.recording import Identity
from mavcal.service.errors import DiskFull, ParameterTimeout, WriteStopped
from mavcal.service.jobs.core.crashpoints import At
from mavcal.service.jobs.core.journal import JournalStep
from mavcal.service.jobs.write.context import WriteContext
from mavcal.service.jobs.write.steps import prepare, roll_back, send_all
from tests.unit.jobs.conftest import NEW, OLD, Bench, Killed, MakeBench, float32

X, Y, Z = "INS_GYROFFS_X", "INS_GYROFFS_Y", "INS_GYROFFS_Z"
BEFORE = {name: float32(OLD[name]) for name in NEW}
BACKWARD = (JournalStep.UNDO, JournalStep.UNDONE, JournalStep.LEFT)


async def half_written(bench: Bench, sent: int = 3) -> None:
    """Send the first `sent` parameters of the plan, then fail; forget what was sent for that."""
    await bench.handle.record(JournalStep.ACCEPTED)
    await prepare(bench.attempt())
    reached: list[At] = []

    def reach(at: At) -> None:
        reached.append(at)
        if reached.count(At.ECHO_KEPT) == sent:
            raise Killed

    bench.reach = reach
    with pytest.raises(Killed):
        await send_all(bench.attempt())
    bench.reach = lambda _: None
    await bench.handle.record(JournalStep.ROLL_BACK, because="a test")
    bench.vehicle.sets.clear()


def rows(bench: Bench) -> list[tuple[str, dict[str, Any]]]:
    return [(row.step, row.data) for row in bench.store.journal("j1") if row.step in BACKWARD]


async def test_old_values_go_back_in_the_reverse_order(make_bench: MakeBench) -> None:
    bench = make_bench()
    await half_written(bench)
    assert await roll_back(bench.attempt()) == BEFORE
    assert bench.vehicle.sets == [(Z, BEFORE[Z]), (Y, BEFORE[Y]), (X, BEFORE[X])]
    assert [(step, data["name"]) for step, data in rows(bench)] == [
        (step, name) for name in (Z, Y, X) for step in ("undo", "undone")
    ]


async def test_what_was_never_sent_is_not_touched(make_bench: MakeBench) -> None:
    bench = make_bench()
    await half_written(bench, sent=1)
    bench.vehicle.store(Z, 0.75)
    assert await roll_back(bench.attempt()) == BEFORE | {Z: 0.75}
    assert bench.vehicle.sets == [(X, BEFORE[X])]


async def test_the_announcement_is_on_the_disk_before_the_old_value_is_sent(make_bench: MakeBench) -> None:
    bench = make_bench()
    await half_written(bench)
    known: list[list[str]] = []
    bench.vehicle.before_set = lambda _: known.append([data["name"] for step, data in rows(bench) if step == "undo"])
    await roll_back(bench.attempt())
    assert known == [[Z], [Z, Y], [Z, Y, X]]


async def test_somebody_elses_value_is_left_alone_and_told_of(make_bench: MakeBench) -> None:
    bench = make_bench()
    await half_written(bench)
    bench.vehicle.store(Y, 0.5)
    assert await roll_back(bench.attempt()) == BEFORE | {Y: 0.5}
    assert [name for name, _ in bench.vehicle.sets] == [Z, X]
    assert bench.handle.write_record().left == {Y: 0.5}


async def test_before_a_foreign_value_is_taken_as_said_it_is_asked_who_answers(make_bench: MakeBench) -> None:
    bench = make_bench()
    await half_written(bench)
    bench.vehicle.store(Y, 0.5)
    w = bench.attempt()

    async def identify() -> Identity:
        bench.vehicle.change_state(conflict="two vehicles answer under one address")
        return bench.vehicle.identity

    bench.vehicle.identify = identify  # type: ignore[method-assign]
    with pytest.raises(WriteStopped, match="two vehicles answer"):
        await roll_back(w)
    assert bench.handle.write_record().left == {}
    assert [name for name, _ in bench.vehicle.sets] == [Z]


async def test_a_value_that_is_the_old_one_already_is_not_written_again(make_bench: MakeBench) -> None:
    bench = make_bench()
    await half_written(bench)
    bench.vehicle.store(Y, BEFORE[Y])
    assert await roll_back(bench.attempt()) == BEFORE
    assert [name for name, _ in bench.vehicle.sets] == [Z, X]
    assert ("undone", {"name": Y, "value": BEFORE[Y]}) in rows(bench)


async def test_values_are_compared_as_single_precision_where_the_vehicle_keeps_them_so(make_bench: MakeBench) -> None:
    bench = make_bench()
    await half_written(bench)
    bench.vehicle.store(Y, NEW[Y])  # in double precision another number than float32(NEW[Y])
    assert await roll_back(bench.attempt()) == BEFORE


@pytest.mark.parametrize("at", [At.BEFORE_UNDO, At.AFTER_UNDO], ids=["unsent", "unconfirmed"])
async def test_a_crash_in_the_middle_is_followed_by_the_rest(make_bench: MakeBench, at: At) -> None:
    bench = make_bench()
    await half_written(bench)

    def reach(now: At) -> None:
        if now == at:
            raise Killed

    bench.reach = reach
    with pytest.raises(Killed):
        await roll_back(bench.attempt())
    again = bench.restarted()
    assert await roll_back(again.attempt()) == BEFORE
    assert [name for name, _ in bench.vehicle.sets] == [Z, Y, X]


async def test_a_full_disk_does_not_keep_the_old_values_from_the_vehicle(
    make_bench: MakeBench, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench = make_bench()
    await half_written(bench)

    def full(*_: object) -> None:
        raise DiskFull

    monkeypatch.setattr(bench.store, "add_journal", full)
    assert await roll_back(bench.attempt()) == BEFORE
    assert any("the disk is full" in text for text in bench.handle.job.warnings)


async def test_an_armed_vehicle_keeps_what_it_holds(make_bench: MakeBench) -> None:
    bench = make_bench()
    await half_written(bench)
    w = bench.attempt()
    bench.vehicle.after_set = lambda _: bench.vehicle.change_state(armed=True)
    with pytest.raises(WriteStopped, match="armed"):
        await roll_back(w)
    assert len(bench.vehicle.sets) == 1


async def test_a_parameter_that_gets_no_answer_ends_it_and_a_later_attempt_goes_on(make_bench: MakeBench) -> None:
    bench = make_bench()
    await half_written(bench)
    bench.vehicle.mute = {Y}
    with pytest.raises(ParameterTimeout):
        await roll_back(bench.attempt())
    assert bench.held() == {X: float32(NEW[X]), Y: float32(NEW[Y]), Z: BEFORE[Z]}
    bench.vehicle.mute = set()
    assert await roll_back(bench.attempt()) == BEFORE
    assert [name for name, _ in bench.vehicle.sets] == [Z, Y, X]


async def test_what_is_returned_was_read_after_the_vehicle_settled(
    make_bench: MakeBench, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A PARAM_SET from before the stop arrives late: what it wrote is seen, not what was confirmed before."""
    bench = make_bench()
    await half_written(bench)

    async def settle(_: WriteContext) -> None:
        bench.vehicle.store(X, float32(NEW[X]))

    monkeypatch.setattr(WriteContext, "settle", settle)
    assert await roll_back(bench.attempt()) == BEFORE | {X: float32(NEW[X])}


async def test_a_session_setting_is_taken_back_too_and_last(make_bench: MakeBench) -> None:
    bench = make_bench(session=True)
    await half_written(bench, sent=4)
    assert await roll_back(bench.attempt()) == BEFORE | {"FLAG": 1.0}
    assert bench.vehicle.sets[-1] == ("FLAG", 1.0)
