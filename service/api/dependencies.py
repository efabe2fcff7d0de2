"""Dependencies of the routes: the application's parts by type."""

from __future__ import annotations

from typing import Annotated, cast

from fastapi import Depends, Request

from mavcal.service.core import Service


def _service(request: Request) -> Service:
    return cast(Service, request.app.state.service)


ServiceDep = Annotated[Service, Depends(_service)]
