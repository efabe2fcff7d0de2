from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mavcal.calib.errors import InvalidInputError, UndeterminedError
from mavcal.service.campaigns.items import (
    OPEN,
    Item,
    ItemOutcome,
    ended_by,
    item_from_row,
    of_diagnosis,
    of_fits,
    row_from_item,
)
from mavcal.service.errors import (
    ChildEnded,
    LinkDown,
    PhysicalJobRunning,
    PreflightRunning,
    StoreError,
    VehicleArmed,
    VehicleBusy,
    VehicleSilent,
)
from mavcal.service.store.rows import ItemRow, JobDocument
from tests.examples import examples

TEXT = st.text(max_size=20)
TIMES = st.none() | st.floats(0.0, 1e10)


@pytest.mark.long
@settings(max_examples=examples(15))
@given(
    st.builds(
        Item,
        st.integers(1, 10_000),
        TEXT,
        TEXT,
        st.sampled_from(ItemOutcome),
        TEXT,
        TEXT,
        st.none() | TEXT,
        TIMES,
        TIMES,
        st.integers(0, 9),
        st.none() | st.dictionaries(TEXT, TEXT, max_size=2),
    )
)
def test_an_item_comes_back_from_its_row_as_it_was(item: Item) -> None:
    row = row_from_item("c", item)
    assert (row.job_id, row.number, row.subject, row.outcome) == ("c", item.number, item.subject, item.outcome)
    assert item_from_row(row) == item


@pytest.mark.parametrize(
    ("outcome", "read"), [("done", ItemOutcome.DONE), ("waiting", ItemOutcome.WAITING), ("sung", ItemOutcome.FAILED)]
)
def test_a_damaged_row_says_what_its_columns_say(outcome: str, read: ItemOutcome) -> None:
    found = item_from_row(ItemRow("c", 3, "v1", outcome, {"starts": "many"}))
    assert (found.number, found.subject, found.outcome) == (3, "v1", read)
    assert found.text == "The record of this item is damaged."


@pytest.mark.parametrize(
    ("error", "outcome", "code"),
    [
        (VehicleSilent("nobody"), ItemOutcome.SKIPPED, "vehicle-silent"),
        (VehicleArmed("it is armed"), ItemOutcome.SKIPPED, "vehicle-armed"),
        (VehicleBusy("it is busy"), ItemOutcome.SKIPPED, VehicleBusy.code),
        (LinkDown("it is down"), ItemOutcome.SKIPPED, "link-down"),
        (PhysicalJobRunning("another job runs"), ItemOutcome.SKIPPED, "physical-job-running"),
        (PreflightRunning("it is looked at"), ItemOutcome.SKIPPED, "preflight-running"),
        (StoreError("the disk"), ItemOutcome.FAILED, "store-error"),
        (ChildEnded("too long"), ItemOutcome.FAILED, ChildEnded.code),
        (InvalidInputError("no gyro"), ItemOutcome.FAILED, "invalid-input"),
        (UndeterminedError("it moved"), ItemOutcome.FAILED, "invalid-input"),
    ],
)
def test_a_vehicle_that_cannot_be_had_is_skipped_and_all_else_has_failed(error, outcome, code) -> None:
    end = ended_by(error)
    assert (end.outcome, end.code) == (outcome, code)
    assert end.text[0].isupper()
    assert end.text.endswith(".")


@pytest.mark.parametrize(
    ("said", "told"),
    [("it has none.", "It has none."), ("Is it there?", "Is it there?"), ("a.b is no file", "A.b is no file.")],
)
def test_a_reason_is_one_sentence(said: str, told: str) -> None:
    assert ended_by(InvalidInputError(said)).text == told


def test_what_is_to_be_done_still_is_open() -> None:
    assert {outcome for outcome in ItemOutcome if outcome not in OPEN} >= {ItemOutcome.REVIEW, ItemOutcome.IN_DOUBT}
    assert Item(1, "v").outcome in OPEN


FIT = {"status": "ok", "sensor": "gyro", "instance": 0, "message": ""}
REFUSED = {**FIT, "status": "refused", "instance": 1, "message": "it moved"}


@pytest.mark.parametrize(
    ("fits", "outcome", "text"),
    [
        ([FIT], ItemOutcome.DONE, "gyro-rest fitted 1 of 1 sensor."),
        ([FIT, FIT], ItemOutcome.DONE, "gyro-rest fitted 2 of 2 sensors."),
        ([FIT, REFUSED], ItemOutcome.REFUSED, "gyro-rest fitted 1 of 2 sensors. gyro1: It moved."),
        ([], ItemOutcome.REFUSED, "gyro-rest fitted 0 of 0 sensors."),
        ([{**FIT, "status": "partial"}], ItemOutcome.DONE, "gyro-rest fitted 1 of 1 sensor."),
    ],
)
def test_a_log_is_done_if_every_sensor_of_it_is_fitted(fits, outcome, text) -> None:
    end = of_fits(fits, "gyro-rest", sha256="ab")
    assert (end.outcome, end.text) == (outcome, text)
    assert end.result == {"sha256": "ab", "fits": fits}
    assert end.code == ("refused" if REFUSED in fits else "")


@pytest.mark.parametrize(("tested", "outcome"), [(True, ItemOutcome.DONE), (False, ItemOutcome.REFUSED)])
def test_a_diagnosis_keeps_its_documents_under_names_of_the_item(tested: bool, outcome: ItemOutcome) -> None:
    documents = [JobDocument("report.json", "application/json", b"{}"), JobDocument("report.html", "text/html", b"")]
    report = {"tested": tested, "verdict": "no_gap"}
    end = of_diagnosis(Item(7, "a.bin"), "Nothing was found.", report, documents, seconds=1.5)
    assert (end.outcome, end.code, end.text) == (outcome, "no_gap", "Nothing was found.")
    assert end.documents == tuple(replace(d, name=f"item-7-{d.name}") for d in documents)
    assert end.result == {"seconds": 1.5, "documents": ["item-7-report.json", "item-7-report.html"]}
