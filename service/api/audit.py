"""The audit trail: what was asked of the service and by whom, on the disk before it is done."""

from __future__ import annotations

import time
from typing import Any

import structlog
from fastapi import Request

from mavcal.service.core import Service
from mavcal.service.errors import StoreError

log = structlog.get_logger(__name__)

LONGEST = 2000
"""Characters of a request that are kept."""
NOT_KEPT = ("/recordings", "/signing-keys")
"""Requests to addresses that end so carry a file, which is not read here, or a secret."""


async def note(request: Request, actor: str) -> None:
    """Put a request that asks for a change into the audit trail.

    Raises
    ------
    StoreError
        If that cannot be kept. What ends something, a job or a link, is done all the same.
    """
    service: Service = request.app.state.service
    subject = _text(next(iter(request.path_params.values()), ""))
    route = request.scope["route"]
    detail: dict[str, Any] = {
        "request": f"{request.method} {_text(request.scope['path'])}",
        "request_id": request.scope.get("request_id", ""),
        "query": {_text(k): _text(v) for k, v in request.query_params.items()},
    }
    if not request.scope["path"].endswith(NOT_KEPT):
        detail["body"] = _text((await request.body()).decode("utf-8", "replace"))
    try:
        row = await service.store.do(
            lambda: service.store.add_audit(time.time(), actor, route.name.replace("_", " "), subject, detail)
        )
        log.info("audit", id=row.id, actor=actor, action=row.action, subject=subject, sha256=row.sha256)
    except StoreError as error:
        log.error("the audit trail cannot be written", actor=actor, action=route.name, reason=str(error))
        if request.method != "DELETE":
            raise


def _text(value: object) -> str:
    """`value` as valid Unicode of at most :data:`LONGEST` characters."""
    return str(value)[:LONGEST].encode("utf-8", "replace").decode()
