from __future__ import annotations

import json
from dataclasses import replace

import click
import pytest

from mavcal.calib.procedures.protocol import Progress
from mavcal.service.campaigns.items import Item, ItemOutcome
from mavcal.service.commands import campaign_output
from mavcal.service.commands.campaign_output import (
    CampaignSnapshot,
    OutputOptions,
    followed,
    print_campaign,
    write_table,
)
from mavcal.service.jobs.core.codec import to_json
from mavcal.service.jobs.core.model import Failure, Result
from mavcal.service.jobs.core.states import JobState

DONE = Item(1, "v1", "boat", ItemOutcome.DONE, "pass", "It may fly.", result={"preflight": {"x": 1}}, starts=2)
WARNED = Item(2, "v2", "", ItemOutcome.WARNED, "warn", "The compass is old.", job_id="j7")
FAILED = Item(3, "v3", "", ItemOutcome.FAILED, "x", "It broke.")


SOME_DONE = Result("2 of 3 are done.")


def campaign(state=JobState.SUCCEEDED, *, options=None, outcome=SOME_DONE, progress=None):
    return CampaignSnapshot("c", state.value, options or {}, to_json(outcome), progress)


def documents(*items):
    """Items as they are told."""
    return [{n: value for n, value in to_json(item).items() if n not in {"result", "starts"}} for item in items]


async def test_a_campaign_is_looked_at_until_it_goes_on_no_more(screen, monkeypatch):
    looks = []

    async def sleep(seconds):
        looks.append(seconds)

    monkeypatch.setattr(campaign_output.asyncio, "sleep", sleep)
    running = campaign(JobState.RUNNING, outcome=None)
    half = replace(running, progress=to_json(Progress(1.0, 2.0, "items", "checking")))
    states = [running, half, half, campaign()]

    async def look():
        return states.pop(0)

    assert (await followed(look, screen)).state == "succeeded"
    assert (len(looks), screen.shares) == (3, [0.5, 0.5])


def test_what_is_not_done_has_a_line(screen):
    assert print_campaign(campaign(), documents(DONE, WARNED, FAILED), OutputOptions(), screen) == 1
    assert [" ".join(line.split()) for line in screen.lines] == [
        "warned v2: The compass is old.",
        "failed v3: It broke.",
        "succeeded: 2 of 3 are done.",
    ]


def test_an_item_is_called_as_a_person_calls_it(screen):
    print_campaign(campaign(), documents(replace(FAILED, name="tug")), OutputOptions(), screen)
    assert "tug:" in screen.lines[0]
    assert FAILED.text in screen.lines[0]
    assert FAILED.subject not in screen.lines[0]


@pytest.mark.parametrize(("count", "more"), [(20, []), (23, ["3 more"])])
def test_a_long_list_is_cut_and_says_where_the_rest_is(screen, count, more):
    many = [replace(FAILED, number=k, subject=f"v{k}") for k in range(1, count + 1)]
    print_campaign(campaign(), documents(*many), OutputOptions(), screen)
    *cut, end = screen.lines[20:]
    assert [" ".join(line.split()[:2]) for line in cut] == more
    assert all("campaign items" in line for line in cut)
    assert end.startswith("succeeded:")


@pytest.mark.parametrize(
    ("items", "options", "code"),
    [
        ((DONE,), {}, 0),
        ((DONE, WARNED), {}, 3),
        ((DONE, WARNED, FAILED), {}, 1),
        ((replace(WARNED, outcome=ItemOutcome.REVIEW),), {}, 0),
        ((replace(WARNED, outcome=ItemOutcome.REVIEW),), {"apply": True}, 1),
    ],
)
def test_the_exit_code_is_that_of_the_items(screen, items, options, code):
    assert print_campaign(campaign(options=options), documents(*items), OutputOptions(), screen) == code


def test_a_campaign_that_failed_is_no_success_whatever_its_items_are(screen):
    failed = campaign(JobState.FAILED, outcome=Failure("x", "The disk is full", "free some space"))
    assert print_campaign(failed, documents(DONE), OutputOptions(), screen) == 1
    assert screen.lines == ["failed: The disk is full. Free some space."]


def test_a_campaign_without_an_outcome_says_its_state(screen):
    print_campaign(campaign(JobState.CANCELLED, outcome=None), documents(DONE), OutputOptions(), screen)
    assert screen.lines == ["cancelled: "]


def test_json_counts_the_items(screen, capsys):
    print_campaign(
        campaign(options={"task": "preflight"}), documents(DONE, WARNED), OutputOptions(as_json=True), screen
    )
    told = json.loads(capsys.readouterr().out)
    assert (told["id"], told["state"], told["options"]) == ("c", "succeeded", {"task": "preflight"})
    assert told["counts"] == {"done": 1, "warned": 1}
    assert [(i["number"], i["outcome"], i["job_id"]) for i in told["items"]] == [(1, "done", None), (2, "warned", "j7")]
    assert len(screen.lines) == 1


def test_the_table_is_written_and_counted(tmp_path, capsys):
    file = tmp_path / "out.csv"
    write_table(file, "item\r\n1\r\n", 1)
    assert file.read_bytes() == b"item\r\n1\r\n"
    assert capsys.readouterr().err == f"{file}: 1 items\n"


def test_a_table_that_cannot_be_written_is_said(tmp_path):
    with pytest.raises(click.ClickException, match="cannot be written: No such file"):
        write_table(tmp_path / "none" / "out.csv", "", 0)
