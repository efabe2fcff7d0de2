"""A job whose capture went well: fitted, planned and in review, with everything that was said on the way."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mavcal.calib.firmware.plan import Agreement
from mavcal.calib.fit import FitResult, FitStatus
from mavcal.calib.procedures.protocol import Done, Progress, Prompt, PromptStep
from mavcal.calib.recording import Identity, Sensor
from mavcal.calib.report import from_json, to_json
from mavcal.calib.triad import TriadModel
from mavcal.service.errors import CaptureDisturbed
from mavcal.service.jobs.calibrate import runner as runner_module
from mavcal.service.jobs.calibrate.digest import Fitted, JobFitRequest
from mavcal.service.jobs.calibrate.planning import Planned
from mavcal.service.jobs.calibrate.runner import Runner
from mavcal.service.jobs.core.handle import JobHandle
from mavcal.service.jobs.core.model import Result
from mavcal.service.jobs.core.segments import SET_ASIDE
from mavcal.service.jobs.core.states import JobState
from mavcal.service.jobs.write.context import Settling, WriteContext
from mavcal.service.jobs.write.steps import read_back
from mavcal.service.store import SqliteStore
from mavcal.service.store.rows import SegmentPurpose, SnapshotPurpose
from mavcal.service.vehicle.job_vehicle import Condition
from tests.unit.jobs.calibrate.test_runner import IDENTITY, AtOnce, job, runner, store
from tests.unit.jobs.conftest import OLD, QUICK, MakeBench, make_plan, until
from tests.unit.jobs.fakes import FakeRegistry, FakeVehicle

__all__ = ["store"]


def fit(status: FitStatus = FitStatus.OK, instance: int = 0, **changes: Any) -> FitResult:
    covariance = np.zeros((12, 12))
    covariance[:3, :3] = 1e-10 * np.eye(3)
    model = TriadModel(offset=np.array([0.05, 0.0, 0.0]))
    made = FitResult("gyro-rest", Sensor.GYRO, instance, status, "", model, covariance, "rad/s", 500, 500, 1e-3, 1.0)
    return replace(made, **changes)


PARAMETERS = {**OLD, "INS_GYR_CAL": 0.0}


class Asking(AtOnce):
    """Keeps what was asked to be fitted."""

    def submit(self, fn: Any, /, *args: Any, **more: Any) -> Any:
        self.requests = [*getattr(self, "requests", []), *args]
        return super().submit(fn, *args, **more)


async def test_a_capture_that_is_done_is_fitted_with_what_it_recorded(
    store: SqliteStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    handle = job(store, JobState.QUEUED)
    vehicle = FakeVehicle({}, identity=Identity("ardupilot", 2, (4, 6, 0), "77", 1, 1))
    runs = runner(registry=FakeRegistry({vehicle.id: vehicle}))
    states: list[JobState] = []

    async def record(_self: object) -> None:
        states.append(handle.job.state)
        handle.prompt(Prompt(PromptStep.TURN, "Turn it."))
        row = store.open_segment("j1", SegmentPurpose.CAPTURE, Path("a.tlog"), 4)
        store.close_segment(row.id, 10, "0" * 64)

    async def fitted(held: JobHandle) -> None:
        states.append(held.job.state)

    monkeypatch.setattr(runner_module.Capture, "run", record)
    monkeypatch.setattr(runs, "fit", fitted)
    await runs.calibrate(handle)
    assert states == [JobState.RUNNING, JobState.FITTING]
    assert [(span.start_byte, span.end_byte) for span in handle.job.segments] == [(4, 10)]
    assert handle.job.prompt is None
    assert from_json(handle.job.context["identity"], Identity) == vehicle.identity


async def test_a_capture_that_goes_on_keeps_the_identity_of_its_beginning(
    store: SqliteStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    handle = job(store, JobState.RUNNING)
    vehicle = FakeVehicle({}, identity=Identity("ardupilot", 2, (4, 6, 0), "77", 1, 1))
    runs = runner(registry=FakeRegistry({vehicle.id: vehicle}))

    async def nothing(*_: object) -> None:
        return None

    monkeypatch.setattr(runner_module.Capture, "run", nothing)
    monkeypatch.setattr(runs, "fit", nothing)
    await runs.calibrate(handle)
    assert handle.job.context == {"identity": to_json(IDENTITY)}


async def test_a_fit_is_asked_for_with_all_that_it_depends_on_and_becomes_a_plan(store: SqliteStore) -> None:
    handle = job(store, JobState.FITTING)
    results = (
        fit(message="fine", warnings=("too short",)),
        fit(FitStatus.REFUSED, 1, message="it was moved", warnings=("too short", "too warm")),
    )
    asking = Asking(Fitted(Done(results, "enough"), dict(PARAMETERS)))
    vehicle = FakeVehicle({})
    runs = Runner(FakeRegistry({vehicle.id: vehicle}), QUICK, asking, tuple)
    context = {**handle.job.context, "answers": [[1.5, "finish"]], "plan_options": {"keep_gyro_at_boot": True}}
    handle.change("x", {}, context=context, warnings=("said before",), options={"a": 1})
    handle.prompt(Prompt(PromptStep.WAIT, "Wait."))
    await runs.fit(handle)
    (request,) = asking.requests
    assert request == JobFitRequest("gyro", {"a": 1}, (), IDENTITY.system, 0.0, ((1.5, "finish"),))
    now = handle.job
    assert (now.state, now.outcome, now.prompt) == (JobState.REVIEW, None, None)
    assert now.results == results
    assert now.warnings == ("said before", "it was moved", "too short", "too warm")
    assert now.plan is not None
    assert [c.name for c in now.plan.changes] == ["INS_GYROFFS_X", "INS_GYROFFS_Y"]
    assert now.fingerprint == now.plan.fingerprint
    await handle.kept()
    assert store.plan("j1", now.plan.sha256) is not None
    kept_on = store.snapshot("j1", SnapshotPurpose.COMPOSED_ON)
    assert kept_on is not None
    assert kept_on.sha256 == now.plan.snapshot_sha256


async def test_a_fit_that_agrees_with_what_is_in_force_ends_the_job(
    store: SqliteStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    handle = job(store, JobState.FITTING)
    vehicle = FakeVehicle.with_floats(OLD)
    plan = replace(make_plan(vehicle), changes=(), agreements=(Agreement(Sensor.GYRO, 0, 0.4, "gyro 1 agrees"),))
    monkeypatch.setattr(runner_module, "make_plan", lambda *_, **__: Planned(plan, vehicle.values()))
    await runner(Fitted(Done((fit(),), "enough"), dict(PARAMETERS))).fit(handle)
    assert handle.job.state == JobState.SUCCEEDED
    assert isinstance(handle.job.outcome, Result)
    assert handle.job.outcome.text == "Nothing to write: gyro 1 agrees."


async def test_a_rest_that_begins_again_forgets_its_answers_and_what_it_showed(
    store: SqliteStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    handle = job(store, JobState.RUNNING)
    handle.change("x", {}, context={**handle.job.context, "answers": [[1.0, "skip"]], "plan_options": {}})
    rows = []

    async def once(_self: object) -> None:
        if rows:
            return
        row = store.open_segment("j1", SegmentPurpose.CAPTURE, Path("a.tlog"), 0)
        rows.append(store.close_segment(row.id, 10, "0" * 64))
        handle.progress(Progress(1.0, 2.0, "s", "recording"))
        raise CaptureDisturbed("it calibrated itself", remedy="")

    async def nothing(*_: object) -> None:
        return None

    runs = runner()
    monkeypatch.setattr(runner_module.Capture, "run", once)
    monkeypatch.setattr(runs, "fit", nothing)
    await runs.calibrate(handle)
    assert handle.job.context == {
        "identity": to_json(IDENTITY), "plan_options": {}, SET_ASIDE: rows[0].id
    }  # fmt: skip
    assert handle.job.progress is None
    assert handle.job.warnings == ("it calibrated itself: the capture begins again",)
    assert handle.job.segments == ()
    await handle.kept()
    (told,) = [event.data for event in store.events("j1") if event.kind == "set_aside"]
    assert told == {"segments": 1}


@pytest.mark.parametrize("stage", [Settling.KEPT, Settling.SAVED])
async def test_nothing_is_read_back_before_the_vehicle_has_saved(make_bench: MakeBench, stage: Settling) -> None:
    bench = make_bench()
    bench.vehicle.change_state(boot_time=100.0)
    settings = replace(QUICK, settle_s={"ardupilot": 9.0}, save_s={"ardupilot": 9.0})
    w = WriteContext(bench.handle, bench.vehicle, bench.plan, bench.accept, bench.check, settings)
    for change in bench.plan.changes:
        bench.vehicle.store(change.name, change.new)
    looks, stated = 0, bench.vehicle.condition

    def condition() -> Condition:
        nonlocal looks
        looks += 1
        return stated()

    bench.vehicle.condition = condition  # type: ignore[method-assign]
    reading = asyncio.create_task(read_back(w, stage))
    await until(lambda: looks > 30)
    assert not reading.done()
    assert bench.store.journal("j1") == ()
    bench.vehicle.change_state(boot_time=109.0)
    assert await reading == {change.name: change.new for change in bench.plan.changes}
    assert [row.step for row in bench.store.journal("j1")] == ["read_back"]


async def test_what_a_write_waits_for_is_saving_where_a_restart_follows(
    make_bench: MakeBench, monkeypatch: pytest.MonkeyPatch
) -> None:
    waited: list[Settling] = []
    settle = WriteContext.settle

    async def noted(self: WriteContext, until_then: Settling = Settling.KEPT) -> None:
        waited.append(until_then)
        await settle(self, until_then)

    monkeypatch.setattr(WriteContext, "settle", noted)
    await make_bench().apply()
    assert waited[0] == Settling.KEPT
    assert Settling.SAVED not in waited
    waited.clear()
    bench = make_bench(reboot=True, accept_reboot=False)
    running = asyncio.create_task(bench.apply())
    await until(lambda: bench.state == JobState.WAITING_FOR_REBOOT)
    bench.vehicle.change_state(reboots=1)
    await running
    assert waited[:2] == [Settling.SAVED, Settling.RESTARTED]
