"""Computations on uploads: what a child is asked for, and what becomes of its answer."""

from __future__ import annotations

import json
import math
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import pytest

from mavcal.calib.errors import FirmwareError, InvalidInputError, UnreadableError
from mavcal.calib.firmware.in_force.origin import Origin
from mavcal.calib.report import to_json
from mavcal.service.children import DIAGNOSE, FIT, Limits
from mavcal.service.computations import PAGE, REPORT, UploadComputations
from mavcal.service.errors import RecordingUnknown, UploadError
from tests.unit.api import samples
from tests.unit.uploads import LIMITS, Runs, chunks, uploads_of

OF_GAPS = Limits(1 << 31, 100.0, 200.0)


@pytest.fixture
def computing(tmp_path):
    """Computations on two uploads, whose children answer so."""
    with ExitStack() as stack:

        async def make(**answers):
            children = Runs(**answers)
            found = stack.enter_context(uploads_of(tmp_path / "up", children))
            rows = [await found.add(name, chunks(name.encode()), {"rate": 50.0}) for name in ("real.bin", "sim.csv")]
            children.asked.clear()
            return UploadComputations(found, children, LIMITS, OF_GAPS), children, rows

        yield make


FIT_ANSWER = {"fits": [to_json(samples.fit())], "origin": None}


async def test_a_fit_is_of_the_upload_as_it_was_read(computing):
    made, children, [real, _] = await computing(**{FIT: FIT_ANSWER})
    [fit] = await made.fit(real.id, "gyro-rest", {"instance": 1})
    assert (fit.method, fit.instance) == ("thermal-poly", 1)
    [(task, order, limits)] = children.asked
    assert (task, limits) == (FIT, LIMITS)
    assert order == {
        "path": str(real.path),
        "reading": {"rate": 50.0},
        "sha256": real.sha256,
        "method": "gyro-rest",
        "options": {"instance": 1},
        "origin": False,
        "vehicle": "00ab",
    }
    assert made.at_once == 3


async def test_a_fit_for_a_vehicle_says_whose_sensors_it_is_of(computing):
    origin = Origin("px4", "00ab", (("gyro", 0, 7),), {"SENS_BOARD_ROT": 0})
    made, children, [real, _] = await computing(**{FIT: {**FIT_ANSWER, "origin": to_json(origin)}})
    _, whose = await made.fit_of_vehicle(real.id, "gyro-rest", {})
    assert whose == origin
    assert children.asked[0][1]["origin"] is True
    children.answers[FIT] = FIT_ANSWER
    with pytest.raises(FirmwareError, match="does not say which vehicle"):
        await made.fit_of_vehicle(real.id, "gyro-rest", {})


async def test_what_is_not_there_is_not_computed(computing):
    made, children, [real, _] = await computing()
    with pytest.raises(RecordingUnknown):
        await made.fit("gone", "gyro-rest", {})
    with pytest.raises(InvalidInputError, match="there is no method 'no-such'"):
        await made.fit(real.id, "no-such", {})
    with pytest.raises(RecordingUnknown):
        await made.diagnose(real.id, "gone", ())
    made.check(real.id)
    assert children.asked == []


DIAGNOSIS = {"report": {"verdict": "no_gap"}, "page": "<html>", "summary": "Nothing was found."}


@pytest.mark.parametrize("with_sim", [False, True])
async def test_a_diagnosis_has_every_upload_in_its_role(computing, with_sim):
    made, children, [real, sim] = await computing(**{DIAGNOSE: DIAGNOSIS})
    found = await made.diagnose(real.id, sim.id if with_sim else None, (sim.id,))
    [(task, order, limits)] = children.asked
    assert (task, limits) == (DIAGNOSE, OF_GAPS)
    assert order["real"]["path"] == str(real.path)
    assert (order["sim"] or {}).get("path") == (str(sim.path) if with_sim else None)
    assert [part["path"] for part in order["nominal"]] == [str(sim.path)]
    assert (order["title"], order["vehicle"]) == ("Sim-to-real gap of real.bin", "00ab")
    assert found.summary == "Nothing was found."
    assert [(d.name, d.media_type) for d in found.documents] == [(REPORT, "application/json"), (PAGE, "text/html")]
    assert json.loads(found.documents[0].body) == DIAGNOSIS["report"]


@pytest.mark.parametrize(("asked", "limit"), [(None, None), (5.0, 5.0), (1000.0, 160.0), (math.inf, 160.0)])
async def test_a_diagnosis_answers_before_its_child_would_be_ended(computing, asked, limit):
    made, children, [real, _] = await computing(**{DIAGNOSE: DIAGNOSIS})
    await made.diagnose(real.id, None, (), limit_s=asked)
    order = children.asked[0][1]
    assert order.get("limit_s") == (None if limit is None else pytest.approx(limit))
    assert order["wall_s"] == pytest.approx(160.0)


async def test_an_error_names_the_uploads_as_their_owner_does(computing):
    made, children, [real, sim] = await computing()

    def broken(order):
        return UnreadableError(f"{order['real']['path']} and {Path(order['sim']['path']).name}")

    children.answers[DIAGNOSE] = broken
    with pytest.raises(UnreadableError, match=r"^real\.bin and sim\.csv$"):
        await made.diagnose(real.id, sim.id, ())
    children.answers[FIT] = lambda order: InvalidInputError(f"{order['path']} has no gyro")
    with pytest.raises(InvalidInputError, match=r"^real\.bin has no gyro$"):
        await made.fit(real.id, "gyro-rest", {})


@pytest.mark.parametrize("body", [{}, {"reading": 7}, {"reading": None}])
async def test_an_upload_whose_record_is_damaged_is_to_be_sent_again(computing, body):
    made, children, [real, _] = await computing()
    row = replace(real, id="damaged", body=body)
    made._recordings._store.add_recording(row)
    with pytest.raises(UploadError, match=r"the record of real\.bin on the disk is damaged"):
        await made.fit("damaged", "gyro-rest", {})
    assert children.asked == []


@pytest.mark.parametrize("inspection", [None, 7, {}, {"identity": None}, {"identity": {"uid": ""}}])
async def test_an_upload_that_does_not_say_whose_it_is_is_of_no_vehicle(computing, inspection):
    made, children, [real, _] = await computing(**{FIT: FIT_ANSWER})
    row = replace(real, id="nobody", body={"reading": {}, "inspection": inspection})
    made._recordings._store.add_recording(row)
    await made.fit("nobody", "gyro-rest", {})
    assert children.asked[0][1]["vehicle"] is None
