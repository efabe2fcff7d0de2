from __future__ import annotations

import csv
import io

from mavcal.service.campaigns.items import Item, ItemOutcome
from mavcal.service.campaigns.outcome import COLUMNS, head, lines
from mavcal.service.commands.campaign import OUTCOMES
from mavcal.service.commands.campaign_output import exit_code


def read(text: str) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(text, newline="")))


def test_the_outcome_is_a_table_with_times_in_utc() -> None:
    items = [
        Item(1, "v1", "", ItemOutcome.REVIEW, "review", 'waits, "in review"', "j1", 0.0, 2.5),
        Item(2, "a", "a.bin", ItemOutcome.DONE, began_at=0.0, ended_at=9.0, result={"seconds": 0.25}),
        Item(3, "b"),
    ]
    first, second, third = read(head() + lines(items))
    assert tuple(first) == COLUMNS
    assert (first["outcome"], first["text"], first["job"]) == ("review", 'waits, "in review"', "j1")
    assert (first["begun_utc"], first["seconds"]) == ("1970-01-01T00:00:00.000+00:00", "2.500")
    assert second["seconds"] == "0.250"  # what its worker measured, without the wait for the worker
    assert (third["outcome"], third["begun_utc"], third["seconds"]) == ("waiting", "", "")


def test_no_cell_is_a_formula() -> None:
    texts = ["=1+1", "+1", "-1", "@SUM(A1)", "\t=1"]
    rows = read(head() + lines([Item(1, text, text) for text in texts]))
    assert [(row["subject"], row["name"]) for row in rows] == [(f"'{text}", f"'{text}") for text in texts]


def test_exit_codes() -> None:
    assert exit_code({}, ["done", "review"]) == 0
    assert exit_code({"apply": True}, ["done", "review"]) == 1
    assert exit_code({}, ["done", "warned"]) == 3
    assert exit_code({}, ["warned", "skipped"]) == 1
    assert set(OUTCOMES) == {outcome.value for outcome in ItemOutcome}
