"""What routes share: the application's parts by type, and references relative to a request.

The service may live behind any path prefix, and cannot know it.
"""

from __future__ import annotations

from typing import Annotated, cast

from fastapi import Depends, Request

from mavcal.service.core import Service


def _service(request: Request) -> Service:
    return cast(Service, request.app.state.service)


ServiceDep = Annotated[Service, Depends(_service)]


def relative(request: Request, target: str) -> str:
    """`target`, given from the service's root, as seen from the address of `request` (RFC 3986, section 4.2)."""
    path: bytes = request.scope.get("raw_path") or request.scope["path"].encode()
    below = path.split(b"?")[0].removeprefix(request.scope.get("root_path", "").encode()).count(b"/") - 1
    return "../" * max(below, 0) + target
