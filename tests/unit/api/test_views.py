from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from markupsafe import Markup

from mavcal.calib.firmware.plan import ParameterKind
from mavcal.calib.preflight.check import Verdict
from mavcal.calib.preflight.states import SensorState
from mavcal.calib.procedures.registry import PROCEDURES
from mavcal.calib.recording import Channel, Sensor, Stage
from mavcal.calib.review.criteria import Criterion
from mavcal.calib.review.effect import SensorEffect
from mavcal.calib.review.mountings import MountingChoice, StatedMounting
from mavcal.service.api import vehicles
from mavcal.service.api.views import (
    event_model,
    gap_model,
    gap_summary,
    item_model,
    job_model,
    job_summary,
    link_model,
    parameter_model,
    procedure_model,
    recording_model,
    review_model,
    sensors_model,
    vehicle_model,
)
from mavcal.service.campaigns.items import Item, ItemOutcome
from mavcal.service.jobs.core.model import Failure
from mavcal.service.jobs.core.states import JobState
from mavcal.service.link.types import LinkState, LinkStatistics
from mavcal.service.reviews import Review
from mavcal.service.store.rows import EventRow, JobDocument, RecordingRow
from mavcal.service.vehicle.parameter_bits import Parameter, ParamType
from tests.unit.api import samples


@pytest.mark.parametrize("kind", PROCEDURES)
def test_the_options_of_a_procedure_are_told_in_json(kind: str) -> None:
    told = json.loads(procedure_model(PROCEDURES[kind]).model_dump_json())
    assert [option["name"] for option in told["options"]] == [option.name for option in PROCEDURES[kind].options]
    assert all(list(option) == ["name", "default", "help", "unit", "low", "high"] for option in told["options"])


def test_a_job_has_addresses_of_its_documents_and_no_path_of_this_machine() -> None:
    told = job_model(samples.job(context={"documents": ["report.html", "a.json"], "plan_options": {"only": ["mag0"]}}))
    assert [(d.name, d.href) for d in told.documents] == [
        ("report.html", "api/v1/jobs/j1/documents/report.html"),
        ("a.json", "api/v1/jobs/j1/documents/a.json"),
    ]
    assert [segment.path for segment in told.segments] == ["a.tlog"]
    assert told.plan_options == {"only": ["mag0"]}
    assert "/data" not in told.model_dump_json()


def test_a_job_in_a_list_has_no_results() -> None:
    told = job_summary(samples.job())
    assert (told.id, told.href, told.state) == ("j1", "api/v1/jobs/j1", JobState.IN_DOUBT)
    assert not {"results", "plan", "segments"} & set(type(told).model_fields)


def state(kind: str, verdict: Verdict) -> SensorState:
    return SensorState(kind, verdict, "ok", "Calibrated today.", "", 1.0, "j1", 20.0)


def test_the_sensors_of_a_vehicle_have_one_verdict() -> None:
    told = sensors_model([state("gyro", Verdict.PASS), state("mag", Verdict.FAIL)])
    assert [(one.kind, one.verdict) for one in told.sensors] == [("gyro", Verdict.PASS), ("mag", Verdict.FAIL)]
    assert told.verdict is Verdict.FAIL
    assert told.summary


def review(picture: Markup | None) -> Review:
    effect = SensorEffect(Sensor.GYRO, 1, "rate at rest", "deg/s", 0.5, 0.01, None)
    criterion = Criterion("noise", Verdict.PASS, 1.0, 2.0, "deg/s", "It is quiet.", "")
    choice = MountingChoice(6, "yaw 270", np.eye(3))
    return Review("It turns less.", (effect,), (criterion,), picture, (StatedMounting(0, 4, "yaw 180", 6),), (choice,))


def test_a_review_speaks_of_what_was_done_or_will_be() -> None:
    waits = review_model(samples.job(state=JobState.REVIEW), review(Markup("<svg/>")))
    done = review_model(samples.done(), review(None))
    assert "will be" not in done.sensors[0].text
    assert waits.sensors[0].text != done.sensors[0].text
    assert waits.mountings == [StatedMounting(0, 4, "yaw 180", 6)]
    assert waits.mounting_choices[0].matrix == np.eye(3).tolist()
    assert (waits.picture, done.picture) == ("api/v1/jobs/j1/picture.svg", None)
    assert (waits.sensors[0].before, waits.sensors[0].after, waits.sensors[0].instance) == (0.5, 0.01, 1)


def test_an_event_is_told_without_the_number_of_its_row() -> None:
    told = event_model(EventRow(99, "j1", 3, 2.5, "warning", {"text": "x", "value": float("nan")}))
    data = {"text": "x", "value": None}
    assert told == {"job_id": "j1", "sequence": 3, "at": 2.5, "kind": "warning", "data": data}


def a_link(name: str) -> SimpleNamespace:
    return SimpleNamespace(
        id=name, endpoint="udpin:0.0.0.0:14550", state=LinkState.UP, reason="", signing_key=None, crc_errors=4,
        hand="off", statistics=lambda system, component: LinkStatistics(received=90 + system, lost=9 + component),
    )  # fmt: skip


def test_a_link_names_the_vehicles_on_it_and_no_others() -> None:
    ours, theirs = a_link("l1"), a_link("l2")
    there = [
        SimpleNamespace(id=name, link=link, links=(link,))
        for name, link in (("v1", ours), ("v2", theirs), ("v3", ours))
    ]
    told = link_model(ours, SimpleNamespace(all=lambda: there))  # type: ignore[arg-type]
    assert told.vehicles == ["v1", "v3"]
    assert (told.url, told.crc_errors) == ("udpin:0.0.0.0:14550", 4)


def a_vehicle(**changes: object) -> SimpleNamespace:
    texts = [SimpleNamespace(text=f"text {k}") for k in range(13)]
    fields = {
        "id": "v1", "link": a_link("l1"), "system": 1, "component": 1, "clock": lambda: 7.0, "silent": False,
        "state": SimpleNamespace(armed=None, landed="on_ground", texts=texts, evidence=lambda now: (f"since {now}",)),
        "identity": SimpleNamespace(autopilot="px4", airframe="boat", version_text="1.17.0", uid2="00ab"),
        "writable": lambda: SimpleNamespace(ok=False, reasons=("it is armed", "it flies")),
        "parameters": {"A": 1, "B": 2},
    }  # fmt: skip
    told = SimpleNamespace(**{**fields, **changes})
    told.links, told.way = (told.link,), told.link.id
    return told


def test_a_vehicle_is_told_in_one_page() -> None:
    told = vehicle_model(a_vehicle())  # type: ignore[arg-type]
    assert told.texts == [f"text {k}" for k in range(3, 13)]  # the newest ones
    assert (told.armed, told.writable, told.obstacles) == (False, False, ["it is armed", "it flies"])
    assert (told.received, told.lost, told.loss) == (91, 10, pytest.approx(10 / 101))
    assert told.evidence == ["since 7.0"]
    assert told.parameters_known == 2


@pytest.mark.parametrize(
    ("value", "kind", "told"), [(7, ParamType.INT32, 7), (0.5, ParamType.REAL32, 0.5), (np.nan, ParamType.REAL32, None)]
)
def test_a_parameter_is_told_in_its_kind(value: float, kind: ParamType, told: float | None) -> None:
    found = parameter_model(Parameter("X", value, kind, 0, b""))
    assert found.value == told
    assert type(found.value) is type(told)
    assert found.kind is ParameterKind(kind.name.lower())


@pytest.mark.parametrize(("body", "shown"), [({"inspection": {"a": 1}}, {"a": 1}), ({"inspection": 7}, {}), ({}, {})])
def test_an_upload_with_a_damaged_record_shows_nothing_of_it(body: dict[str, object], shown: object) -> None:
    row = RecordingRow("r1", 1.0, "a.bin", Path("/data/r1"), 10, "ab", body)
    told = recording_model(row)
    assert (told.inspection, told.href, told.name) == (shown, "api/v1/recordings/r1", "a.bin")


def test_an_item_has_its_job_and_its_documents() -> None:
    item = Item(2, "v1", outcome=ItemOutcome.REVIEW, job_id="j1", result={"documents": ["item-2-report.html"]})
    told = item_model(item, "c1", samples.job())
    assert (told.job_state, told.number, told.preflight, told.fits) == (JobState.IN_DOUBT, 2, None, [])
    assert told.documents[0].href == "api/v1/jobs/c1/documents/item-2-report.html"
    assert item_model(replace(item, result=None), "c1", None).job_state is None


GAP = replace(samples.bare(), id="g1", kind="gap", options={"real": "r1", "nominal": ("n1", "n2")})


def test_a_diagnosis_is_told_with_its_report_once_there_is_one() -> None:
    bare = gap_model(GAP, None)
    assert (bare.real, bare.sim, bare.nominal, bare.report, bare.page) == ("r1", None, ["n1", "n2"], None, None)
    told = gap_model(GAP, JobDocument("report.json", "application/json", b'{"verdict": "no_gap"}'))
    assert (told.report, told.page) == ({"verdict": "no_gap"}, "api/v1/gaps/g1/report.html")


def test_a_diagnosis_that_failed_says_why() -> None:
    failed = replace(GAP, outcome=Failure("x", "There is no reference", "give one"))
    assert gap_summary(failed).error == "There is no reference."
    assert gap_summary(replace(GAP, outcome=samples.RESULT)).error is None


def test_live_samples_are_told_by_axis_with_as_many_digits_as_a_sensor_has() -> None:
    values = np.array([[1.23456789, 2.0, np.nan], [np.inf, -0.000123456789, 123456.789]])
    channel = Channel(Sensor.GYRO, 1, np.array([0.12345678, 0.2]), values, "rad/s", Stage.RAW, "HIGHRES_IMU")
    [told] = vehicles._samples([channel])
    assert told.t == [0.1235, 0.2]
    assert told.values == [[1.23457, None], [2.0, -0.000123457], [None, 123457.0]]
