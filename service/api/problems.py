"""Errors as RFC 9457 problem documents; one handler for each root of an exception tree."""

from __future__ import annotations

from typing import Any

import structlog
from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from starlette.exceptions import HTTPException

from calib.errors import CalibError
from service.errors import ServiceError

log = structlog.get_logger(__name__)


class ProblemResponse(JSONResponse):
    """A problem document."""

    media_type = "application/problem+json"


def problem(request: Request, status: int, code: str, title: str, detail: str, **more: Any) -> ProblemResponse:
    """The document: `type` names the page that explains it, relative to the service's root."""
    body = {
        "type": f"problems/{code}",
        "title": title,
        "status": status,
        "detail": detail,
        "request_id": request.scope.get("request_id", ""),
        **more,
    }
    return ProblemResponse(body, status_code=status)


def explanations() -> dict[str, str]:
    """Every problem code with the text that explains it: the docstring of its exception."""
    found: dict[str, str] = {}
    pending: list[type[ServiceError]] = [ServiceError]
    while pending:
        kind = pending.pop()
        found[kind.code] = f"{kind.title} ({kind.status_code}). {(kind.__doc__ or '').strip()}"
        pending += kind.__subclasses__()
    found["invalid-input"] = f"Invalid input (422). {(CalibError.__doc__ or '').strip()}"
    found["validation"] = "Invalid request (422). The request does not have the documented form."
    found["not-found"] = "Not found (404). There is nothing at this address."
    return dict(sorted(found.items()))


def install_problem_handlers(app: FastAPI) -> None:
    """Map every expected exception to its document; anything else becomes a 500 without a trace."""

    async def service_error(request: Request, error: Exception) -> ProblemResponse:
        assert isinstance(error, ServiceError)
        return problem(request, error.status_code, error.code, error.title, str(error))

    async def calib_error(request: Request, error: Exception) -> ProblemResponse:
        return problem(request, 422, "invalid-input", "Invalid input", str(error))

    async def validation_error(request: Request, error: Exception) -> ProblemResponse:
        assert isinstance(error, RequestValidationError)
        fields = [{"field": ".".join(str(p) for p in e["loc"]), "message": e["msg"]} for e in error.errors()]
        detail = "; ".join(f"{f['field']}: {f['message']}" for f in fields)
        return problem(request, 422, "validation", "Invalid request", detail, errors=fields)

    async def http_error(request: Request, error: Exception) -> ProblemResponse:
        assert isinstance(error, HTTPException)
        code = "not-found" if error.status_code == 404 else "http"
        return problem(request, error.status_code, code, str(error.detail), str(error.detail))

    async def unexpected(request: Request, error: Exception) -> ProblemResponse:
        log.error("unexpected error", request_id=request.scope.get("request_id"), exc_info=error)
        detail = "an unexpected error; the log of the service has it under this request id"
        return problem(request, 500, "internal", "Internal error", detail)

    app.add_exception_handler(ServiceError, service_error)
    app.add_exception_handler(CalibError, calib_error)
    app.add_exception_handler(RequestValidationError, validation_error)
    app.add_exception_handler(HTTPException, http_error)
    app.add_exception_handler(Exception, unexpected)
