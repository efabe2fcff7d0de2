"""Campaigns through a folder: what each file is computed with, and how its item ends."""

from __future__ import annotations

import asyncio
import json
from concurrent.futures import Executor, Future
from typing import Any

import pytest

from mavcal.calib.errors import InvalidInputError
from mavcal.service.campaigns import archive as module
from mavcal.service.campaigns import uploads, worker
from mavcal.service.campaigns.archive import FolderFits, FolderGaps, archive
from mavcal.service.campaigns.campaigns import CAMPAIGN, ItemTurn
from mavcal.service.campaigns.executors import Workers
from mavcal.service.campaigns.items import Item, ItemOutcome, item_from_row
from mavcal.service.campaigns.uploads import UploadFits, UploadGaps
from mavcal.service.children import DIAGNOSE, FIT, Limits
from mavcal.service.computations import PAGE, REPORT
from mavcal.service.errors import ChildEnded, ChildrenBusy, JobUnknown
from mavcal.service.jobs.core.model import Job
from mavcal.service.jobs.core.states import JobState
from mavcal.service.jobs.uploads import Diagnosis
from mavcal.service.store.rows import JobDocument
from tests.unit.api import samples

LIMITS = Limits(1 << 30, 10.0, 10.0)
FITS = [{"status": "ok", "sensor": "gyro", "instance": 0, "message": ""}]
REPORT_OF = {"verdict": "explained", "tested": True}


class Inline(Executor):
    """Computes at once, by `answer`; notes what was asked."""

    def __init__(self, answer: Any) -> None:
        self.answer, self.asked = answer, []

    def submit(self, fn: Any, /, *args: Any, **_: Any) -> Future[Any]:
        assert fn is module.computed
        self.asked.append(args)
        future: Future[Any] = Future()
        future.set_result(self.answer(args[1]) if callable(self.answer) else self.answer)
        return future


def turn(options: dict[str, Any], subject: str = "a/b.bin", number: int = 3) -> ItemTurn:
    campaign = Job("c", None, CAMPAIGN, {"folder": "/logs", **options}, JobState.RUNNING, 0.0, 0.0)
    return ItemTurn(campaign, Item(number, subject), None, again=False)  # type: ignore[arg-type]


def work(kind: Any, answer: Any) -> tuple[Any, Inline]:
    executor = Inline(answer)
    return kind(Workers(executor, 2), LIMITS, asyncio.Semaphore(2)), executor


FIT_OPTIONS = {"method": "gyro-rest", "options": {"instance": 0}, "reading": {"unit_accel": "g"}}


async def test_a_method_is_run_on_the_file_of_the_item() -> None:
    fits, executor = work(FolderFits, {"done": {"fits": FITS}, "sha256": "ab", "seconds": 1.5})
    end = await fits.run(turn(FIT_OPTIONS))
    [(task, order, limits)] = executor.asked
    assert (task, limits) == (FIT, LIMITS)
    assert (order["path"], order["reading"]) == ("/logs/a/b.bin", {"unit_accel": "g"})
    assert (order["method"], order["options"], order["origin"]) == ("gyro-rest", {"instance": 0}, False)
    assert end.outcome is ItemOutcome.DONE
    assert end.result == {"sha256": "ab", "seconds": 1.5, "fits": FITS}


@pytest.mark.parametrize("kind", [FolderFits, FolderGaps])
async def test_a_file_that_cannot_be_computed_fails_without_its_folder(kind: Any) -> None:
    error = {"code": "invalid-input", "text": "in /logs/a/b.bin"}
    failing, _ = work(kind, {"error": error})
    end = await failing.run(turn({**FIT_OPTIONS, "sim": None, "nominal": []}))
    assert (end.outcome, end.code, end.text) == (ItemOutcome.FAILED, "invalid-input", "In a/b.bin")


async def test_a_file_is_diagnosed_beside_the_same_files_as_all_others() -> None:
    done = {"report": REPORT_OF, "page": "<html>", "summary": "It is explained."}
    gaps, executor = work(FolderGaps, {"done": done, "sha256": "ab", "seconds": 2.0})
    end = await gaps.run(turn({"sim": "/sim.csv", "nominal": ["/n1.csv", "/n2.csv"], "reading": None}))
    [(task, order, _)] = executor.asked
    assert task == DIAGNOSE
    assert [order[role]["path"] for role in ("real", "sim")] == ["/logs/a/b.bin", "/sim.csv"]
    assert [part["path"] for part in order["nominal"]] == ["/n1.csv", "/n2.csv"]
    assert order["title"] == "Sim-to-real gap of b.bin"
    assert (end.outcome, end.text, end.code) == (ItemOutcome.DONE, "It is explained.", "explained")
    assert {d.name: d.media_type for d in end.documents} == {
        f"item-3-{REPORT}": "application/json",
        f"item-3-{PAGE}": "text/html",
    }
    assert json.loads(end.documents[0].body) == REPORT_OF
    alone, executor = work(FolderGaps, {"done": done, "sha256": "ab", "seconds": 2.0})
    await alone.run(turn({"sim": None, "nominal": []}))
    assert executor.asked[0][1]["sim"] is None


@pytest.fixture
def logs(tmp_path):
    folder = tmp_path / "logs"
    folder.mkdir()
    for name in ("a.bin", "b.bin"):
        (folder / name).touch()
    return folder


async def ended(found: Any, job: Job) -> Job:
    while (now := found.book.handle(job.id).job).state is not JobState.SUCCEEDED:  # noqa: ASYNC110 - in this loop
        await asyncio.sleep(0)
    return now


async def test_a_campaign_goes_through_every_file_of_its_folder(tmp_path, logs) -> None:
    def answer(order: Any) -> Any:
        if order["path"].endswith("b.bin"):
            return {"error": {"code": "invalid-input", "text": "no gyro"}}
        return {"done": {"fits": FITS}, "sha256": "ab", "seconds": 1.0}

    async with archive(tmp_path / "data", Workers(Inline(answer), 2), LIMITS, LIMITS) as found:
        job = await found.fit(logs, "*.bin", "gyro-rest", {}, reading={}, at_once=None)
        await ended(found, job)
        items = [item_from_row(row) for row in found.store.items(job.id)]
        assert [(i.subject, i.outcome) for i in items] == [
            ("a.bin", ItemOutcome.DONE),
            ("b.bin", ItemOutcome.FAILED),
        ]
        assert found.book.handle(job.id).job.options["folder"] == str(logs)


@pytest.mark.parametrize(
    ("method", "options", "said"),
    [("no-such", {}, "there is no method 'no-such'"), ("gyro-rest", {"from": float("nan")}, "finite|nan")],
)
async def test_what_cannot_be_computed_begins_no_campaign(tmp_path, logs, method, options, said) -> None:
    async with archive(tmp_path / "data", Workers(Inline(None), 2), LIMITS, LIMITS) as found:
        with pytest.raises(InvalidInputError, match=said):
            await found.fit(logs, "*.bin", method, options)
        assert not found.book.list()


async def test_a_campaign_that_is_left_can_be_resumed_later(tmp_path, logs) -> None:
    class Never(Inline):
        def submit(self, fn: Any, /, *args: Any, **_: Any) -> Future[Any]:
            self.asked.append(args)
            return Future()

    async with archive(tmp_path / "data", Workers(Never(None), 2), LIMITS, LIMITS) as found:
        job = await found.gap(logs, "*.bin", None, [], reading={}, at_once=1)
        await asyncio.sleep(0)
    done = {"report": REPORT_OF, "page": "", "summary": "It is explained."}
    answering = Inline({"done": done, "sha256": "ab", "seconds": 1.0})
    async with archive(tmp_path / "data", Workers(answering, 2), LIMITS, LIMITS) as found:
        assert found.book.handle(job.id).job.state is JobState.INTERRUPTED
        await found.resume(job.id)
        await ended(found, job)
        assert len(answering.asked) == 2
        with pytest.raises(JobUnknown):
            await found.resume("gone")


class Computes:
    """The uploads' computations, whose children are busy so often."""

    def __init__(self, busy: int) -> None:
        self.busy, self.asked = busy, []

    def _asked(self, *what: Any) -> None:
        self.asked.append(what)
        if len(self.asked) <= self.busy:
            raise ChildrenBusy

    async def fit(self, *what: Any) -> Any:
        self._asked(*what)
        return (samples.fit(),)

    async def diagnose(self, *what: Any) -> Diagnosis:
        self._asked(*what)
        page = JobDocument(PAGE, "text/html", b"")
        return Diagnosis("So it is.", (page, JobDocument(REPORT, "application/json", json.dumps(REPORT_OF).encode())))


@pytest.mark.parametrize("busy", [0, 3])
async def test_an_upload_waits_until_a_child_is_free(monkeypatch: pytest.MonkeyPatch, busy: int) -> None:
    monkeypatch.setattr(uploads, "_PAUSE_S", 0.0)
    computes = Computes(busy)
    end = await UploadFits(computes, asyncio.Semaphore(1)).run(turn(FIT_OPTIONS, "r1"))  # type: ignore[arg-type]
    assert computes.asked == [("r1", "gyro-rest", {"instance": 0})] * (busy + 1)
    assert end.outcome is ItemOutcome.DONE
    assert end.result is not None
    assert end.result["fits"][0]["method"] == "thermal-poly"
    computes = Computes(busy)
    options = {"sim": "s", "nominal": ["n"]}
    end = await UploadGaps(computes, asyncio.Semaphore(1)).run(turn(options, "r1"))  # type: ignore[arg-type]
    assert computes.asked == [("r1", "s", ["n"])] * (busy + 1)
    assert (end.text, [d.name for d in end.documents]) == ("So it is.", [f"item-3-{PAGE}", f"item-3-{REPORT}"])


class Runs:
    """The children of a process of a pool."""

    def __init__(self, error: Exception | None = None) -> None:
        self.error = error

    def run(self, *what: Any) -> Any:
        if self.error is not None:
            raise self.error
        return {"what": what[0]}


@pytest.mark.parametrize(
    ("error", "code", "text"),
    [
        (InvalidInputError("it has no gyro"), "invalid-input", "it has no gyro"),
        (ChildEnded("it took too long"), ChildEnded.code, "it took too long"),
    ],
)
def test_what_a_worker_meets_is_data(tmp_path, monkeypatch, error, code, text) -> None:
    file = tmp_path / "a.bin"
    file.write_bytes(b"abc")
    monkeypatch.setattr(worker, "_children", Runs)
    done = worker.computed(FIT, {"path": str(file)}, LIMITS)
    assert done["done"] == {"what": FIT}
    assert done["sha256"].startswith("ba7816bf")  # of the file as it is
    assert done["seconds"] >= 0.0
    monkeypatch.setattr(worker, "_children", lambda: Runs(error))
    found = worker.computed(FIT, {"path": str(file)}, LIMITS)["error"]
    assert found["code"] == code
    assert found["text"].endswith(text)
    gone = worker.computed(FIT, {"path": str(tmp_path / "gone.bin")}, LIMITS)["error"]
    assert gone == {"code": "file-unreadable", "text": "gone.bin cannot be read: No such file or directory"}


def test_folders_of_killed_processes_are_removed_and_no_others(tmp_path, monkeypatch) -> None:
    names = ("mavcal-children-123-ab", "mavcal-children-456-cd", "mavcal-children-x-ef", "other-123")
    for name in names:
        (tmp_path / name).mkdir()
    monkeypatch.setattr(worker, "alive", lambda pid: pid == 456)
    worker._sweep(tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(names[1:])
