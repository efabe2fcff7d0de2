"""The models leave the JSON of the domain as it is, to the byte, and name every field of it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from pydantic import BaseModel, ValidationError

from mavcal.calib.firmware.plan import LeftOut, Value
from mavcal.calib.procedures.registry import PROCEDURES
from mavcal.calib.recording import Sensor
from mavcal.service.api.models.fits import FitModel, FitsModel
from mavcal.service.api.models.jobs import WriteFailedModel
from mavcal.service.api.models.plans import PlanModel
from mavcal.service.api.models.steps import ProgressModel, PromptModel
from mavcal.service.api.models.wire import Number
from mavcal.service.api.views import job_model, job_summary, plan_model, procedure_model
from mavcal.service.jobs.core.codec import to_json
from mavcal.service.jobs.core.model import Unwritten
from mavcal.service.jobs.core.states import JobState

from . import samples

BEFORE: dict[str, str] = json.loads((Path(__file__).parent / "before.json").read_text())
"""What the service answered before its models were typed."""


def text(value: Any) -> str:
    return json.dumps(value, separators=(",", ":"), ensure_ascii=False)


def without(text_of: str, added: str) -> str:
    """The JSON `text_of` without a field that was added since, wherever it stands."""

    def cut(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        return {key: value for key, value in pairs if key != added or "method" not in dict(pairs)}

    return text(json.loads(text_of, object_pairs_hook=cut))


def assert_without_what_was_added(prompt: dict[str, Any] | None) -> None:
    """Take off the prompt what it says since, which is nothing in these jobs."""
    added = {"taken": False, "tilts": [], "unfinished": "", "silence": None}
    assert prompt is None or {name: prompt.pop(name) for name in added} == added


@pytest.mark.parametrize("name", ["job", "bare", "done"])
def test_a_job_is_told_as_before_to_the_byte(name: str) -> None:
    job = getattr(samples, name)()
    told = json.loads(without(job_model(job).model_dump_json(), "parameters"))
    assert told.pop("readiness") is None  # added since
    assert told.pop("left_out") == told.pop("broken") == []
    assert_without_what_was_added(told["prompt"])
    assert told["plan"] is None or told["plan"].pop("left_out") == []
    assert text(told) == text(json.loads(BEFORE[name]))
    told = json.loads(job_summary(job).model_dump_json())
    assert told.pop("options") == json.loads(BEFORE[name])["options"]
    assert told.pop("left_out") == told.pop("broken") == []
    assert_without_what_was_added(told["prompt"])
    assert text(told) == BEFORE[f"{name}_summary"]


def test_fits_are_told_as_before_to_the_byte() -> None:
    told = FitsModel.model_validate({"method": "thermal-poly", "fits": [to_json(samples.fit())]})
    assert without(told.model_dump_json(), "parameters") == text(json.loads(BEFORE["fits"]))


LEFT = (LeftOut(Sensor.MAG, 1, "it does not stream"),)


@pytest.mark.parametrize(
    ("model", "domain"),
    [
        (PlanModel, json.loads(plan_model(replace(samples.PLAN, left_out=LEFT)).model_dump_json())),
        (PromptModel, to_json(samples.PROMPT)),
        (ProgressModel, to_json(samples.PROGRESS)),
    ],
)
def test_what_the_domain_says_is_told_to_the_byte(model: type[BaseModel], domain: Any) -> None:
    assert text(json.loads(model.model_validate(domain).model_dump_json())) == text(domain)
    with pytest.raises(ValidationError):
        model.model_validate({key: value for key, value in domain.items() if key != next(iter(domain))})


@pytest.mark.parametrize("field", ["verification", "last_write", "standing"])
def test_what_a_job_holds_of_the_domain_is_told_to_the_byte(field: str) -> None:
    job = samples.job()
    assert text(json.loads(job_model(job).model_dump_json())[field]) == text(to_json(getattr(job, field)))


def test_every_procedure_is_told() -> None:
    for spec in PROCEDURES.values():
        told = json.loads(procedure_model(spec).model_dump_json())
        options = told.pop("options")
        assert text(told) == text({name: to_json(getattr(spec, name)) for name in told})
        assert [(o["name"], o["default"], o["help"], o["unit"]) for o in options] == [
            (o.name, o.default, o.help, o.unit) for o in spec.options
        ]
        assert set(told) == {*vars(spec)} - {"aliases", "still_only", "aiding", "options"}


def test_a_fit_lists_its_parameters_with_value_deviation_and_unit() -> None:
    fit = samples.fit()
    told = FitModel.model_validate(to_json(fit)).parameters
    assert [p.name for p in told] == list(fit.names)
    assert [p.value for p in told] == fit.values.tolist()
    assert [p.sd for p in told] == [to_json(float(sd)) for sd in fit.sd]
    units = {p.name: p.unit for p in told}
    assert (units["offset_x"], units["matrix_xy"]) == ("rad/s", "")
    assert (units["poly1_z"], units["poly2_z"]) == ("rad/s/degC", "rad/s/degC^2")
    assert [p.name for p in told if p.sd is None] == ["offset_z"]


def test_a_write_that_failed_is_an_outcome_of_its_own() -> None:
    outcome = Unwritten("vehicle-armed", "the vehicle is armed", "Nothing was written.")
    told = job_summary(samples.job(state=JobState.REVIEW, outcome=outcome)).outcome
    assert isinstance(told, WriteFailedModel)
    assert (told.code, told.cause, told.remedy) == ("vehicle-armed", "the vehicle is armed.", "Nothing was written.")


def test_a_plan_has_one_shape() -> None:
    assert plan_model(samples.PLAN).model_dump_json() == job_model(samples.job()).plan.model_dump_json()  # type: ignore[union-attr]


@pytest.mark.parametrize("value", [3, 3.0, -1, 1e-300])
def test_an_integer_stays_one(value: Value) -> None:
    class Told(BaseModel):
        value: Number

    assert json.loads(Told(value=value).model_dump_json()) == {"value": value}
    assert type(Told(value=value).value) is type(value)


def test_states_are_enums() -> None:
    assert job_model(samples.job()).state is JobState.IN_DOUBT
    with pytest.raises(ValidationError):
        type(job_model(samples.bare())).model_validate({**job_model(samples.bare()).model_dump(), "state": "lost"})
