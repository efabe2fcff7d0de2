"""A slice of the crossed campaign, and its checks: what is lost, damaged or contradicted is seen."""

from __future__ import annotations

import json
import multiprocessing
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from bench.campaign.crossed.checks import contradicted, damaged, lost, overwritten, recorded
from bench.campaign.crossed.plan import Network, Process, VehicleFault, cross, crosses
from bench.campaign.crossed.postgresql import STORE
from bench.campaign.crossed.run import run_cross
from bench.campaign.crossed.stores import StoreKind
from bench.campaign.judge import Ending
from mavcal.service.store import SqliteStore
from mavcal.service.store.rows import JobRow, JournalRow, SegmentPurpose
from tests.postgres import Server

SEED = 1
RUNS = (3, 8, 21, 26, 42, 51)
"""Losses of power, a SIGKILL, and the databases that were gone while a write was taken back."""
WORKERS = 3


@pytest.mark.campaign
@pytest.mark.long
@pytest.mark.timeout(900)
def test_a_slice_ends_as_it_may() -> None:
    with ProcessPoolExecutor(WORKERS, mp_context=multiprocessing.get_context("spawn")) as pool:
        reports = list(pool.map(run_cross, [cross(index, SEED) for index in RUNS]))
    wrong = [f"{report.reproduce}: {report.complaints}" for report in reports if report.ending == Ending.FAILURE]
    assert not wrong, "\n".join(wrong)
    assert any(report.resumed for report in reports)


def test_every_cell_comes_once_in_a_block() -> None:
    count = len(Network) * len(Process) * len(VehicleFault)
    for first in (0, count):
        cells = {(c.network, c.process, c.vehicle) for c in crosses(count, SEED, first)}
        assert len(cells) == count


@dataclass
class Kept:
    """A store with one job that has written, and the ledger of it."""

    store: SqliteStore
    ledger: Path
    folder: Path
    rows: list[tuple[str, dict[str, object]]] = field(default_factory=list)

    def step(self, step: str, **data: object) -> None:
        self.store.add_journal("j1", 0.0, step, data)
        self.note("add_journal", ["j1", 0.0, step, data])

    def note(self, what: str, arguments: list[object]) -> None:
        with self.ledger.open("a") as ledger:
            ledger.write(json.dumps([what, arguments]) + "\n")


@pytest.fixture
def kept(tmp_path: Path) -> Iterator[Kept]:
    store = SqliteStore(tmp_path / "data")
    store.save_job(JobRow("j1", "v", "gyro", "succeeded", 0.0, 0.0, {}))
    found = Kept(store, tmp_path / "ledger", tmp_path / "data")
    found.note("save_job", [{"id": "j1"}])
    found.step("send", name="A", new=2.0)
    found.step("echo", name="A", value=2.0)
    yield found
    store.close()


def test_a_job_and_a_step_that_are_gone_are_noticed(kept: Kept) -> None:
    assert lost(kept.ledger, kept.store) == []
    kept.note("save_job", [{"id": "j2"}])
    kept.note("add_journal", ["j1", 0.0, "read_back", {}])
    kept.note("add_plan", ["j1", "0123456789abcdef", 0.0, {}])
    assert lost(kept.ledger, kept.store) == [
        "job j2 is lost", "plan 0123456789ab is lost", "the journal has lost read_back {}",
    ]  # fmt: skip


def test_samples_that_have_changed_are_noticed(kept: Kept) -> None:
    log = kept.folder / "tlogs" / "a.tlog"
    log.parent.mkdir()
    log.write_bytes(b"samples")
    before = recorded(kept.folder)
    segment = kept.store.open_segment("j1", SegmentPurpose.CAPTURE, log, 0)
    kept.store.close_segment(segment.id, 7, before[log][1])
    assert damaged(kept.store) == overwritten(before) == []
    log.write_bytes(b"sam")
    assert damaged(kept.store)
    assert overwritten(before) == ["a.tlog has lost samples"]


def test_a_parameter_that_is_not_what_the_journal_says_is_noticed(kept: Kept) -> None:
    def wrong(value: float, *more: tuple[str, dict[str, object]], foreign: dict[str, float] | None = None) -> list[str]:
        rows = [*kept.store.journal("j1"), *(JournalRow(9, "j1", 0.0, step, data) for step, data in more)]
        return contradicted(rows, {"A": value}, foreign or {}, ())

    assert wrong(2.0) == []
    assert wrong(1.0) == ["the journal says that A is 2, the vehicle holds 1"]
    assert wrong(1.0, foreign={"A": 1.0}) == []
    assert wrong(1.0, ("undo", {"name": "A"})) == []  # announced: it may be either
    assert wrong(2.0, ("undo", {"name": "A"}), ("undone", {"name": "A", "value": 1.0}))


def test_a_run_on_postgresql_has_a_database_of_its_own_and_finds_it_again(postgres: Server) -> None:
    kind = StoreKind(STORE, postgres.url("{run}"))
    for run, jobs in (("crossed_1", 0), ("crossed_1", 1), ("crossed_2", 0)):
        with closing(kind.opened(Path("unused"), run)) as store:
            assert len(store.jobs()) == jobs
            store.save_job(JobRow("j1", "v", "gyro", "succeeded", 0.0, 0.0, {}))
    assert not kind.in_data_dir
