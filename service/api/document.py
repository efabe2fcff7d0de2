"""The OpenAPI document: every status that an operation can answer with, and what a problem looks like."""

from __future__ import annotations

from http import HTTPStatus
from typing import Any

from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi
from pydantic import BaseModel, Field

Json = dict[str, Any]

KEYED = "/api/v1"
OPEN = frozenset({"/healthz", "/readyz", "/register_service", "/problems/{code}"})
"""What is told without a key."""
PROBLEM = {"application/problem+json": {"schema": {"$ref": "#/components/schemas/Problem"}}}
ERROR_SCHEMAS = ("HTTPValidationError", "ValidationError")
"""What FastAPI would document instead of the problems that are answered."""


class FieldError(BaseModel):
    """What is wrong with one field of a request."""

    field: str
    message: str


class Problem(BaseModel):
    """A problem document (RFC 9457)."""

    type: str = Field(description="address of the page that explains it, relative to the address of the request")
    title: str
    status: int
    detail: str = Field(description="what happened, and what helps")
    request_id: str = Field(description="under which the log of the service tells more")
    errors: list[FieldError] | None = Field(default=None, description="of an invalid request")


def document(app: FastAPI) -> Json:
    """The document of an application."""
    made = get_openapi(
        title=app.title, version=app.version, description=app.description, routes=app.routes, servers=app.servers
    )
    schemas = made["components"]["schemas"]
    described = Problem.model_json_schema(ref_template="#/components/schemas/{model}")
    schemas.update(described.pop("$defs"))
    schemas["Problem"] = described
    for name in ERROR_SCHEMAS:
        schemas.pop(name, None)
    made["components"]["securitySchemes"] = {"key": {"type": "http", "scheme": "bearer"}}
    for path, methods in made["paths"].items():
        for method, operation in methods.items():
            if path not in OPEN:
                operation["security"] = [{"key": []}, {}]  # none, where the service runs without keys
            for status in statuses(path, method, operation):
                answer = {"description": HTTPStatus(status).phrase, "content": PROBLEM}
                if status == 422 or str(status) not in operation["responses"]:
                    operation["responses"][str(status)] = answer
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
    if path.endswith(("/plan", "/report.html", "/parameters", "/jobs", "/gaps")) or path.startswith(f"{KEYED}/jobs/"):
        found |= {404, 409}
    if path.endswith(("/parameters", "/events", "/stream")):
        found |= {503}
    return sorted(found)
