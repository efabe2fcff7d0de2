"""Errors as RFC 9457 problem documents; one handler for each root of an exception tree."""

from __future__ import annotations

import json
import math
from http import HTTPStatus
from typing import Any

import structlog
from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from starlette.exceptions import HTTPException

from mavcal.calib.errors import CalibError
from mavcal.service.api.dependencies import relative
from mavcal.service.errors import AuthError, ServiceError, TooManyAttempts, TooManyStreams, kinds

log = structlog.get_logger(__name__)


class ProblemResponse(JSONResponse):
    """A problem document."""

    media_type = "application/problem+json"

    def render(self, content: Any) -> bytes:
        """The document as ASCII, since text quoted from a request need not be valid Unicode."""
        return json.dumps(content, separators=(",", ":")).encode()


def problem(request: Request, status: int, code: str, title: str, detail: str, **more: Any) -> ProblemResponse:
    """The document: `type` is the page that explains it, relative to the request's address."""
    body = {
        "type": relative(request, f"problems/{code}"),
        "code": code,
        "title": title,
        "status": status,
        "detail": detail,
        "request_id": request.scope.get("request_id", ""),
        **more,
    }
    return ProblemResponse(body, status_code=status)


def refusal(request: Request, error: ServiceError) -> ProblemResponse:
    """The answer to a request whose body is not read; it closes the connection."""
    answer = problem(request, error.status_code, error.code, error.title, str(error))
    if error.status_code == 401:
        answer.headers["WWW-Authenticate"] = "Bearer"
    if isinstance(error, TooManyAttempts):
        answer.headers["Retry-After"] = str(math.ceil(error.wait_s))
    if isinstance(error, TooManyStreams):
        answer.headers["Retry-After"] = "5"
    if request.headers.get("content-length", "0") != "0" or "transfer-encoding" in request.headers:
        answer.headers["Connection"] = "close"
    return answer


def internal_problem(request: Request, error: Exception) -> ProblemResponse:
    """The answer to an internal error; its trace is in the log under the request's id."""
    log.error("unexpected error", request_id=request.scope.get("request_id"), exc_info=error)
    detail = "an unexpected error; the log of the service has it under this request id"
    return problem(request, 500, ServiceError.code, ServiceError.title, detail)


def codes() -> dict[str, frozenset[int]]:
    """Every problem code with the statuses that it comes with."""
    found = {kind.code: frozenset({kind.status_code}) for kind in kinds()}
    return found | {
        "invalid-input": frozenset({422}),
        "validation": frozenset({422}),
        "not-found": frozenset({404}),
        "http": frozenset({400, 405, 408, 413}),
    }


def explanations() -> dict[str, str]:
    """Every problem code with the text that explains it: the docstring of its exception."""
    found = {kind.code: f"{kind.title} ({kind.status_code}). {(kind.__doc__ or '').strip()}" for kind in kinds()}
    found["invalid-input"] = f"Invalid input (422). {(CalibError.__doc__ or '').strip()}"
    found["validation"] = "Invalid request (422). The request does not have the documented form."
    found["not-found"] = "Not found (404). There is nothing at this address."
    found["http"] = "The request cannot be handled: its method, form or size is not what this address takes."
    return dict(sorted(found.items()))


def install_problem_handlers(app: FastAPI) -> None:
    """Map every expected exception to its document; :class:`Envelope` sees to the others."""

    async def service_error(request: Request, error: Exception) -> ProblemResponse:
        assert isinstance(error, ServiceError)
        if isinstance(error, AuthError):
            return refusal(request, error)
        return problem(request, error.status_code, error.code, error.title, _without_paths(request, str(error)))

    async def calib_error(request: Request, error: Exception) -> ProblemResponse:
        return problem(request, 422, "invalid-input", "Invalid input", _without_paths(request, str(error)))

    async def validation_error(request: Request, error: Exception) -> ProblemResponse:
        assert isinstance(error, RequestValidationError)
        fields = [{"field": ".".join(str(p) for p in e["loc"]), "message": e["msg"]} for e in error.errors()]
        detail = "; ".join(f"{f['field']}: {f['message']}" for f in fields)
        return problem(request, 422, "validation", "Invalid request", detail, errors=fields)

    async def http_error(request: Request, error: Exception) -> ProblemResponse:
        assert isinstance(error, HTTPException)
        code = "not-found" if error.status_code == 404 else "http"
        title = HTTPStatus(error.status_code).phrase
        detail = explanations()["not-found"] if code == "not-found" else str(error.detail)
        answer = problem(request, error.status_code, code, title, detail)
        answer.headers.update(error.headers or {})
        return answer

    app.add_exception_handler(ServiceError, service_error)
    app.add_exception_handler(CalibError, calib_error)
    app.add_exception_handler(RequestValidationError, validation_error)
    app.add_exception_handler(HTTPException, http_error)


def _without_paths(request: Request, text: str) -> str:
    """`text` without the path of the data directory."""
    return text.replace(str(request.app.state.settings.data_dir), "the data directory")
