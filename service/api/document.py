"""The OpenAPI document: every status that an operation can answer with, its problems, and what streams carry."""

from __future__ import annotations

from http import HTTPStatus
from typing import Any

from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi
from pydantic import BaseModel, Field, TypeAdapter

from mavcal.service.api.models.events import Message
from mavcal.service.api.models.live import LiveMessage
from mavcal.service.api.models.recordings import ReadingOptions
from mavcal.service.api.problems import codes, explanations

Json = dict[str, Any]

KEYED = "/api/v1"
OPEN = frozenset({"/healthz", "/readyz", "/register_service", "/problems/{code}"})
"""Paths that are served without a key."""
ERROR_SCHEMAS = ("HTTPValidationError", "ValidationError")
"""Schemas of FastAPI in place of the problems that are answered."""
REF = "#/components/schemas/{model}"

TAGS = {
    "links": "Connections to vehicles. An endpoint is written as `udpin:0.0.0.0:14550`, `tcp:HOST:PORT` and so on.",
    "vehicles": "Vehicles that were heard, their state and their parameters.",
    "jobs": "Calibrations: start, follow, answer, read the plan, apply it, take it back.",
    "recordings": "Logs that were uploaded, to be fitted, or to be planned for a vehicle.",
    "campaigns": "One preflight, calibration, fit or diagnosis for many vehicles or uploads: a job of many items.",
    "gaps": "Diagnoses of where a real sensor differs from a simulated one.",
    "fleet": "Every unit that was calibrated or heard: ages, drifts, odd sensors, and who should be calibrated again.",
    "host": "Health, metrics, audit trail, and how host systems find the service.",
}
BEARER = {
    "type": "http",
    "scheme": "bearer",
    "description": "An API key (`mavcal config key` makes one). Its scopes say what it may do: `read`, `operate` "
    "(links, jobs, answers, uploads), `write-params` (apply and revert), `admin`. "
    "On loopback the service may run without keys.",
}
TICKET = {
    "type": "apiKey",
    "in": "query",
    "name": "ticket",
    "description": "A ticket of `POST /tickets` for one stream: a browser's EventSource cannot send headers.",
}
STREAMS = {
    "follow_job": "JobMessage",
    "follow_vehicle": "VehicleMessage",
    "follow_samples": "LiveMessage",
    "follow_events": "Message",
}
"""Schema of the messages of each event stream; its fields are the lines `event`, `id` and `data`."""
HEADERS = {
    "Location": (
        *("open_link", "watch_vehicle", "start_job", "upload_recording", "plan_recording"),
        *("fit_recording", "start_fit", "diagnose_gap", "restore_calibration", "add_signing_key"),
        *("start_preflight_campaign", "start_calibration_campaign", "start_fit_campaign", "start_gap_campaign"),
        "start_restore_campaign",
    ),
    "Link": ("list_jobs", "list_fleet", "list_items"),
}
"""Operations whose answer carries a header that a client needs: where what was made is, or the next page."""


class FieldError(BaseModel):
    """What is wrong with one field of a request."""

    field: str
    message: str


class Problem(BaseModel):
    """A problem document (RFC 9457)."""

    type: str = Field(
        description="address of the page that explains it, relative to the address of the request; it ends in `code`",
        pattern="^(\\.\\./)*problems/[a-z-]+$",
    )
    code: str = Field(description="what kind of problem it is, for programs")
    title: str
    status: int = Field(description="that of the answer")
    detail: str = Field(description="what happened, and what helps")
    request_id: str = Field(description="id under which the log of the service has the details")
    errors: list[FieldError] | None = Field(default=None, description="fields of an invalid request")


def document(app: FastAPI) -> Json:
    """The document of an application."""
    made = get_openapi(
        title=app.title,
        version=app.version,
        description=app.description,
        routes=app.routes,
        servers=app.servers,
        tags=[{"name": name, "description": text} for name, text in TAGS.items()],
    )
    made = _by_title(made)
    schemas = made["components"]["schemas"]
    for name in ERROR_SCHEMAS:
        schemas.pop(name, None)
    schemas.update(_further_schemas())
    made["components"]["securitySchemes"] = {"bearer": BEARER, "ticket": TICKET}
    for path, methods in made["paths"].items():
        for method, operation in methods.items():
            _complete(path, method, operation)
            for status in statuses(path, method, operation):
                if status == 422 or str(status) not in operation["responses"]:
                    operation["responses"][str(status)] = _answer(status)
                    schemas[f"Problem{status}"] = _problem(status, schemas["Problem"])
    return made


def statuses(path: str, method: str, operation: Json) -> list[int]:
    """The statuses of problems that an operation can answer with."""
    found = {403, 500}  # a foreign host name; a defect
    if path not in OPEN:
        found |= {401, 429}
    if "{" in path:
        found |= {404}
    if operation.get("parameters") or "requestBody" in operation:
        found |= {422}
    if "requestBody" in operation:
        found |= {400, 408, 413}
    if method != "get":
        found |= {409, 413, 503, 507}
    if path.endswith(
        ("/plan", "/report.html", "/parameters", "/jobs", "/gaps", "/fits", "/fleet", "/fleet.csv")
    ) or path.startswith((f"{KEYED}/jobs/", f"{KEYED}/campaigns/")):
        found |= {404, 409}
    if path.endswith(("/parameters", "/events", "/stream", "/samples")):
        found |= {503}
    return sorted(found)


def _complete(path: str, method: str, operation: Json) -> None:
    """Add problems and streams to an operation, which FastAPI does not know."""
    first, _, rest = operation.get("description", "").partition("\n\n")
    operation["summary"] = first.removesuffix(".")
    if rest:
        operation["description"] = rest
    else:
        operation.pop("description", None)
    if path not in OPEN:
        operation["security"] = [{"bearer": []}, {}]  # none, where the service runs without keys
    if (message := STREAMS.get(operation["operationId"])) is not None:
        operation["security"].insert(1, {"ticket": []})
        ok = operation["responses"]["200"]
        ok["description"] = "A stream of messages; each is as the schema says"
        ok["content"] = {"text/event-stream": {"schema": {"$ref": REF.format(model=message)}}}
    for name, operations in HEADERS.items():
        if operation["operationId"] in operations:
            answer = next(a for status, a in operation["responses"].items() if status < "300")
            text = "relative to the address of the request"
            answer["headers"] = {name: {"description": text, "schema": {"type": "string"}}}
    for parameter in operation.get("parameters", ()):
        if parameter["name"] == "reading":
            del parameter["schema"]
            parameter["content"] = {"application/json": {"schema": {"$ref": REF.format(model="ReadingOptions")}}}


def _further_schemas() -> Json:
    """Schemas of events and problems, which no route names."""
    _, found = TypeAdapter.json_schemas(
        [
            ("message", "serialization", TypeAdapter(Message)),
            ("live", "serialization", TypeAdapter(LiveMessage)),
            ("problem", "serialization", TypeAdapter(Problem)),
            ("reading", "validation", TypeAdapter(ReadingOptions)),
        ],
        ref_template=REF,
    )
    schemas: Json = _by_title({"components": {"schemas": found["$defs"]}})["components"]["schemas"]
    texts = explanations()
    schemas["ProblemCode"] = {
        "title": "ProblemCode",
        "description": "What kind of problem it is.",
        "type": "string",
        "enum": list(texts),
        "x-enum-descriptions": list(texts.values()),
    }
    schemas["Problem"]["properties"]["code"] = {"$ref": REF.format(model="ProblemCode")}
    return schemas


def _by_title(made: Json) -> Json:
    """The document with each schema under its title: pydantic has a dataclass under the name of its class."""
    titles = {name: schema.get("title", name) for name, schema in made["components"]["schemas"].items()}
    references = {REF.format(model=name): REF.format(model=title) for name, title in titles.items()}

    def renamed(part: Any) -> Any:
        if isinstance(part, dict):
            return {key: renamed(value) for key, value in part.items()}
        if isinstance(part, list):
            return [renamed(value) for value in part]
        return references.get(part, part) if isinstance(part, str) else part

    document: Json = renamed(made)
    schemas = document["components"]["schemas"]
    document["components"]["schemas"] = dict(sorted((titles[name], schema) for name, schema in schemas.items()))
    return document


def _answer(status: int) -> Json:
    schema = {"$ref": REF.format(model=f"Problem{status}")}
    return {"description": HTTPStatus(status).phrase, "content": {"application/problem+json": {"schema": schema}}}


def _problem(status: int, general: Json) -> Json:
    """A problem with this status, and the codes that come with it.

    It repeats the fields of `general`: generators of clients cannot merge a number with one value of it.
    """
    chosen = sorted(code for code, known in codes().items() if status in known)
    own = {
        "status": {**general["properties"]["status"], "const": status},
        "code": {"type": "string", "title": f"Problem{status}Code", "enum": chosen},
    }
    return {
        **general,
        "title": f"Problem{status}",
        "description": f"{HTTPStatus(status).phrase}.",
        "properties": {**general["properties"], **own},
    }
