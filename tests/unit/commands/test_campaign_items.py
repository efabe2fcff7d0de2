"""The items of a campaign are listed alike from a data directory and through a service."""

from __future__ import annotations

import csv
import json

import click
import pytest
from click.testing import CliRunner

from mavcal.calib.preflight.check import Check, CheckId, Report, Verdict
from mavcal.client.models import ItemModel
from mavcal.service.api.views import item_model
from mavcal.service.campaigns.campaigns import CAMPAIGN
from mavcal.service.campaigns.items import BEGUN_BY, Item, ItemOutcome, item_from_row, row_from_item
from mavcal.service.campaigns.outcome import head, lines
from mavcal.service.campaigns.vehicles import of_preflight
from mavcal.service.commands import campaign_items
from mavcal.service.commands.campaign import command
from mavcal.service.commands.campaign_archive import is_of_folder
from mavcal.service.errors import JobUnknown
from mavcal.service.jobs.core.codec import to_json
from mavcal.service.jobs.core.states import JobState
from mavcal.service.preflights import Preflight
from mavcal.service.store import SqliteStore
from mavcal.service.store.rows import JobRow
from tests.unit.api import samples
from tests.unit.commands.doubles import plain
from tests.unit.jobs.fakes import FakeVehicle

SERVICE = ("--url", "http://127.0.0.1:8765")
CHECK = Check(
    CheckId.GYRO_REST, Verdict.WARN, 0.01, 0.001, 0.5, "deg/s", "reads 0.01 deg/s", "Wait.", ("n = 3",), ("gyro",)
)
FOUND = Preflight("v1", FakeVehicle.with_floats({}).identity, 5.0, 8.0, Report((CHECK,)), ("slow link",))
ITEMS = (
    Item(1, "v1", "boat", ItemOutcome.DONE, "pass", "It may fly.", result=of_preflight(FOUND).result, starts=2),
    Item(2, "v2", "", ItemOutcome.WARNED, "warn", "The compass is old.", job_id="j7", began_at=1.5, ended_at=4.0),
    Item(3, "v3", "", ItemOutcome.FAILED, "x", "It broke."),
    Item(4, "a.bin", "", ItemOutcome.REFUSED, "refused", "One is open.", result={"fits": [to_json(samples.fit())]}),
    Item(5, "b.bin", "", ItemOutcome.DONE, "explained", "All of it.", result={"documents": ["item-5-report.json"]}),
)


@pytest.fixture
def folder(tmp_path):
    """A data directory with campaigns, and a job that is none."""
    store = SqliteStore(tmp_path)
    of_folder, of_vehicles = {"folder": "/logs"}, {"task": "preflight"}
    for name, kind, options in (("c", CAMPAIGN, of_vehicles), ("f", CAMPAIGN, of_folder), ("j", "gyro", of_folder)):
        store.save_job(JobRow(name, None, kind, "succeeded", 1.0, 2.0, {"options": options}))
    store.save_job(JobRow("damaged", None, CAMPAIGN, "succeeded", 1.0, 2.0, {}))
    store.add_items([row_from_item("c", item) for item in ITEMS])
    store.close()
    return tmp_path


@pytest.fixture
def listed(folder, make_service, runs, monkeypatch):
    """Lists items both ways: exit code and stdout of each, and what was written as a table."""
    service = make_service(plain("c", JobState.SUCCEEDED, kind=CAMPAIGN), plain("j", JobState.SUCCEEDED))
    store = SqliteStore(None)
    store.save_job(JobRow("c", None, CAMPAIGN, "succeeded", 1.0, 2.0, {}))
    store.add_items([row_from_item("c", item) for item in ITEMS])
    monkeypatch.setattr(campaign_items, "PAGE", 2)

    def kept(job_id, outcome, **page):
        wanted = None if outcome is None else [o.value for o in outcome]
        return [item_from_row(row) for row in store.items(job_id, outcomes=wanted, **page)]

    async def list_items(job_id, *, outcome, after, limit):
        found = kept(job_id, outcome, after=after or 0, limit=limit)
        return [ItemModel.model_validate(item_model(item, job_id, None).model_dump(mode="json")) for item in found]

    async def export_items(job_id, form, *, outcome):
        assert form == "csv"
        return head() + lines(kept(job_id, outcome, limit=9))

    service.list_items, service.export_items = list_items, export_items
    runs(service)

    def run(*words):
        found = []
        for where in (("--data-dir", str(folder)), SERVICE):
            table = folder / "out.csv"
            done = CliRunner().invoke(command, ["items", *words, "--csv", str(table), *where], standalone_mode=False)
            if done.exception is not None:
                raise done.exception
            found.append((done.return_value, done.stdout, table.read_bytes()))
        return found

    yield run
    store.close()


def test_the_text_and_the_table_are_those_of_the_data_directory(listed):
    here, there = listed("c")
    assert there == here
    code, text, _ = here
    said = [line.split() for line in text.splitlines()]
    assert code == 0
    assert [line[:2] for line in said[:4]] == [["item", "outcome"], ["1", "done"], ["2", "warned"], ["3", "failed"]]
    assert said[1][2:] == ["boat", "It", "may", "fly."]
    assert said[2][2:4] == ["j7", "v2"]


def test_items_are_chosen_by_outcome_for_the_table_as_well(listed):
    here, there = listed("c", "--outcome", "warned", "--outcome", "failed")
    assert there == here
    assert [line.split()[0] for line in here[1].splitlines()[1:]] == ["2", "3"]
    assert [row["item"] for row in csv.DictReader(here[2].decode().splitlines())] == ["2", "3"]


def test_the_json_of_a_service_lacks_nothing_but_what_http_does_not_tell(listed):
    here, there = (json.loads(text) for _, text, _ in listed("c", "--json"))
    assert here["items"][0]["result"]["preflight"]["report"]["checks"][0]["suspects"] == ["gyro"]
    for item in here["items"]:
        del item["starts"]
    preflight = here["items"][0]["result"]["preflight"]
    for untold in ("identity", "readings"):
        del preflight[untold]
    assert there == here
    assert [item["result"] is None for item in there["items"]] == [False, True, True, False, False]


def test_a_data_directory_names_the_newest_job_of_an_item_that_runs(folder):
    store = SqliteStore(folder)
    items = (Item(1, "v1", outcome=ItemOutcome.RUNNING), Item(2, "v2", outcome=ItemOutcome.RUNNING), Item(3, "v3"))
    store.save_job(JobRow("r", None, CAMPAIGN, "running", 3.0, 3.0, {"options": {}}))
    store.add_items([row_from_item("r", item) for item in items])
    for name, campaign, number in (("old", "r", 1), ("new", "r", 1), ("other", "c", 2), ("waits", "r", 3)):
        body = {"context": {BEGUN_BY: {"id": campaign, "item": number}}}
        store.save_job(JobRow(name, "v1", "gyro", "running", 4.0, 4.0, body))
    store.close()
    words = ["items", "r", "--json", "--data-dir", str(folder)]
    done = CliRunner().invoke(command, words, standalone_mode=False, catch_exceptions=False)
    assert [item["job_id"] for item in json.loads(done.stdout)["items"]] == ["new", None, None]


@pytest.mark.parametrize("name", ["gone", "j"])
def test_what_is_no_campaign_of_a_data_directory_has_no_items(folder, name):
    with pytest.raises(JobUnknown, match=f"{name} in this data directory"):
        CliRunner().invoke(
            command, ["items", name, "--data-dir", str(folder)], standalone_mode=False, catch_exceptions=False
        )
    with pytest.raises(JobUnknown, match=name):
        is_of_folder(folder, name)


@pytest.mark.parametrize("name", ["gone", "j"])
def test_what_is_no_campaign_of_a_service_has_no_items(make_service, runs, name):
    runs(make_service(plain("j", JobState.SUCCEEDED)))
    with pytest.raises(JobUnknown, match=name):
        CliRunner().invoke(command, ["items", name, *SERVICE], standalone_mode=False, catch_exceptions=False)


def test_a_service_has_a_data_directory_of_its_own(tmp_path):
    words = ["items", "c", *SERVICE, "--data-dir", str(tmp_path)]
    with pytest.raises(click.UsageError, match="leave it out"):
        CliRunner().invoke(command, words, standalone_mode=False, catch_exceptions=False)


def test_a_campaign_through_files_is_told_from_one_of_vehicles(folder):
    assert [is_of_folder(folder, name) for name in ("c", "f", "damaged")] == [False, True, False]
