"""Dependencies of routes: parts of the application by type, and addresses relative to a request.

The service may live behind any path prefix, and cannot know it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Protocol, TypeVar, cast

from fastapi import Depends, Request, Response

from mavcal.service.core import Service


def _service(request: Request) -> Service:
    return cast(Service, request.app.state.service)


ServiceDep = Annotated[Service, Depends(_service)]


class _Addressed(Protocol):
    href: str


Addressed = TypeVar("Addressed", bound=_Addressed)


@dataclass(frozen=True)
class Made:
    """Sets the header Location of an answer to the address of the created object."""

    request: Request
    response: Response

    def at(self, target: str) -> None:
        """Set the address `target`, given from the service's root."""
        self.response.headers["Location"] = relative(self.request, target)

    def __call__(self, model: Addressed) -> Addressed:
        """`model`, which names its own address."""
        self.at(model.href)
        return model


def _made(request: Request, response: Response) -> Made:
    return Made(request, response)


MadeDep = Annotated[Made, Depends(_made)]


def relative(request: Request, target: str) -> str:
    """`target`, given from the service's root, as seen from the address of `request` (RFC 3986, section 4.2)."""
    path: bytes = request.scope.get("raw_path") or request.scope["path"].encode()
    below = path.split(b"?")[0].removeprefix(request.scope.get("root_path", "").encode()).count(b"/") - 1
    return "../" * max(below, 0) + target
