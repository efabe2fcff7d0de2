"""The document is true: schemathesis asks every operation with and without keys, with valid and with invalid data."""

from __future__ import annotations

import re
import socket
import threading
import time
from collections.abc import Iterator
from typing import Any

import pytest
import schemathesis
import uvicorn
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import seed as seeded
from openapi_spec_validator import validate
from schemathesis.generation import GenerationMode
from schemathesis.specs.openapi.checks import negative_data_rejection, positive_data_acceptance

from mavcal.service.api.document import OPEN
from mavcal.service.api.problems import explanations
from mavcal.service.app import create_app

from .api_bench import described, kept_document, settings_in
from .test_api import keys

ENDLESS = "/api/v1/events"
"""A stream without an end; its other answers are in test_api."""


@pytest.fixture(scope="module")
def addresses(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, str]]:
    """The service on two loopback ports: open, and with keys."""
    servers, threads, found = [], [], {}
    for name, chosen in (("open", ()), ("keyed", keys())):
        app = create_app(settings_in(tmp_path_factory.mktemp(name), api_keys=chosen))
        listener = socket.socket()
        listener.bind(("127.0.0.1", 0))
        config = uvicorn.Config(app, log_config=None, access_log=False, timeout_graceful_shutdown=1)
        server = uvicorn.Server(config)
        thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]})
        thread.start()
        servers.append(server)
        threads.append(thread)
        found[name] = f"http://127.0.0.1:{listener.getsockname()[1]}"
    while not all(server.started for server in servers):
        time.sleep(0.02)
    yield found
    for server, thread in zip(servers, threads, strict=True):
        server.should_exit = True
        thread.join(20)


@pytest.fixture(scope="module")
def operations() -> dict[str, Any]:
    """Those of the application that end, by method and path."""
    schema = schemathesis.openapi.from_dict(described())
    found = [result.ok() for result in schema.get_all_operations()]
    return {f"{o.method} {o.path}": o for o in found if o.path != ENDLESS}


ASKED = [
    f"{method} {path}" for path, methods in kept_document()["paths"].items() for method in methods if path != ENDLESS
]
KEY = {"Authorization": "Bearer admin"}
NOT_CHECKED = [positive_data_acceptance]
"""A request of the right form may name what does not exist; of a parameter that is repeated the last one counts."""


def ask(operation: Any, address: str, headers: dict[str, str], mode: GenerationMode, times: int) -> set[int]:
    """Ask some generated requests; each answer has a documented status."""
    statuses: set[int] = set()

    @seeded(20_260_000)
    @settings(
        max_examples=times,
        deadline=None,
        database=None,
        phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )
    @given(case=operation.as_strategy(generation_mode=mode))
    def asked(case: Any) -> None:
        response = case.call(base_url=address, headers=headers, timeout=60)
        statuses.add(response.status_code)
        repeated = any(isinstance(value, list) for value in (case.query or {}).values())
        left_out = [*NOT_CHECKED, negative_data_rejection] if repeated else NOT_CHECKED
        case.validate_response(response, excluded_checks=left_out)

    asked()
    return statuses


def may_be_wrong(operation: Any) -> bool:
    """Whether there is a request of that operation which is not valid."""
    raw = operation.definition.raw
    return "requestBody" in raw or any(p["in"] != "path" for p in raw.get("parameters", ()))


def test_every_operation_is_asked(operations: dict[str, Any]) -> None:
    assert list(operations) == ASKED


@pytest.mark.parametrize("asked", ASKED)
def test_every_answer_is_as_documented(addresses: dict[str, str], operations: dict[str, Any], asked: str) -> None:
    operation = operations[asked]
    assert ask(operation, addresses["open"], {}, GenerationMode.POSITIVE, 4)
    if may_be_wrong(operation):
        assert ask(operation, addresses["open"], {}, GenerationMode.NEGATIVE, 4)
    assert 401 not in ask(operation, addresses["keyed"], KEY, GenerationMode.POSITIVE, 2)
    without = ask(operation, addresses["keyed"], {}, GenerationMode.POSITIVE, 1)
    assert (without == {401}) == (operation.path not in OPEN)


def test_every_operation_names_its_problems() -> None:
    for path, methods in described()["paths"].items():
        for method, operation in methods.items():
            answers = operation["responses"]
            if path not in OPEN:
                assert {"401", "403", "429"} <= answers.keys(), (method, path)
            if "{" in path:
                assert "404" in answers, (method, path)
            if "requestBody" in operation:
                assert {"413", "422"} <= answers.keys(), (method, path)
            for status, answer in answers.items():
                if int(status) >= 400 and path not in {"/readyz", "/problems/{code}"}:
                    assert list(answer["content"]) == ["application/problem+json"], (method, path, status)


def every_operation() -> Iterator[tuple[str, str, dict[str, Any]]]:
    for path, methods in described()["paths"].items():
        for method, operation in methods.items():
            yield path, method, operation


def test_the_document_is_valid() -> None:
    validate(described())


def test_every_operation_has_a_name_of_its_own() -> None:
    names = [operation["operationId"] for _, _, operation in every_operation()]
    assert len(set(names)) == len(names) > 35
    assert [name for name in names if not re.fullmatch("[a-z]+(_[a-z]+)+", name)] == []
    assert {"list_vehicles", "start_job", "follow_job", "answer_job", "get_plan", "apply_plan", "revert_job"} <= {
        *names
    }


def test_every_operation_has_a_tag_that_is_described_and_a_key() -> None:
    tags = {tag["name"]: tag["description"] for tag in described()["tags"]}
    assert described()["components"]["securitySchemes"]["bearer"]["scheme"] == "bearer"
    for path, _, operation in every_operation():
        assert set(operation["tags"]) <= tags.keys()
        assert operation["summary"]
        assert ("security" in operation) == (path not in OPEN)


def test_every_problem_names_the_codes_that_it_may_have() -> None:
    schemas = described()["components"]["schemas"]
    known = set(schemas["ProblemCode"]["enum"])
    assert known == set(explanations())
    for path, method, operation in every_operation():
        for status, answer in operation["responses"].items():
            problem = answer.get("content", {}).get("application/problem+json")
            if problem is None:
                assert int(status) < 400 or path in {"/readyz", "/problems/{code}"}
                continue
            name = problem["schema"]["$ref"].rsplit("/", 1)[1]
            assert name == f"Problem{status}", (method, path)
            own = schemas[name]["properties"]
            assert own["status"]["const"] == int(status)
            assert own["code"]["enum"]
            assert set(own["code"]["enum"]) <= known


def numeric(schema: dict[str, Any]) -> bool:
    """Whether a value of this schema may be a number, or a list of numbers."""
    options = [schema, *schema.get("anyOf", ()), schema.get("items", {})]
    return any({"number", "integer"} & {option.get("type")} for option in options if isinstance(option, dict))


def test_every_number_says_what_it_counts_or_in_which_unit() -> None:
    document = described()
    fields = {
        f"{name}.{field}": schema
        for name, model in document["components"]["schemas"].items()
        for field, schema in model.get("properties", {}).items()
    }
    parameters = {
        f"{operation['operationId']}.{parameter['name']}": {**parameter.get("schema", {}), **parameter}
        for _, _, operation in every_operation()
        for parameter in operation.get("parameters", ())
    }
    numbers = {name: schema for name, schema in (fields | parameters).items() if numeric(schema)}
    assert len(numbers) > 80
    assert [name for name, schema in numbers.items() if not schema.get("description")] == []


def test_what_is_one_of_a_few_words_says_which() -> None:
    schemas = described()["components"]["schemas"]
    words = {
        f"{name}.{field}": schema
        for name, model in schemas.items()
        for field, schema in model.get("properties", {}).items()
        if field in {"state", "step", "verdict", "status", "holds", "result", "proof", "landed", "autopilot"}
    }
    assert len(words) > 15
    loose = [
        name
        for name, schema in words.items()
        if schema.get("type") == "string" and not {"enum", "const"} & schema.keys()
    ]
    assert loose == ["FingerprintModel.autopilot", "FleetUnitModel.autopilot"]  # as it was heard, whatever that was


def test_a_stream_takes_a_ticket_and_nothing_else_does() -> None:
    scheme = described()["components"]["securitySchemes"]["ticket"]
    assert (scheme["in"], scheme["name"]) == ("query", "ticket")
    taking = [o["operationId"] for _, _, o in every_operation() if {"ticket": []} in o.get("security", ())]
    assert sorted(taking) == ["follow_events", "follow_job", "follow_samples", "follow_vehicle"]


def test_whatever_is_begun_names_its_address() -> None:
    begun = {
        o["operationId"]: o["responses"] for _, _, o in every_operation() if {"201", "202"} & o["responses"].keys()
    }
    acts = {
        "refit_job",
        "resume_campaign",
        "apply_plan",
        "revert_job",
        "make_ticket",
    }  # on a job whose address was asked, or nowhere
    without = {name for name, of in begun.items() if "headers" not in (of.get("201") or of["202"])}
    assert without == acts


def test_streams_say_what_they_carry() -> None:
    schemas = described()["components"]["schemas"]
    found = {}
    for _, _, operation in every_operation():
        content = operation["responses"].get("200", {}).get("content", {})
        if "text/event-stream" in content:
            found[operation["operationId"]] = content["text/event-stream"]["schema"]["$ref"].rsplit("/", 1)[1]
    assert found == {
        "follow_job": "JobMessage",
        "follow_vehicle": "VehicleMessage",
        "follow_samples": "LiveMessage",
        "follow_events": "Message",
    }
    assert schemas["Message"]["discriminator"]["propertyName"] == "event"
    assert schemas["JobEvent"]["discriminator"]["propertyName"] == "kind"
    assert schemas["OutcomeModel"]["discriminator"]["propertyName"] == "kind"
