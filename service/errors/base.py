"""The root of everything that ``service`` raises on purpose."""

from __future__ import annotations

from collections.abc import Iterator
from typing import ClassVar


class ServiceError(Exception):
    """Something went wrong inside the service; its log says what."""

    status_code: ClassVar[int] = 500
    title: ClassVar[str] = "Internal error"
    code: ClassVar[str] = "internal-error"

    def __init__(self, message: str | None = None) -> None:
        super().__init__(message or self.__doc__)


def kinds() -> Iterator[type[ServiceError]]:
    """Every class of the tree."""
    pending: list[type[ServiceError]] = [ServiceError]
    while pending:
        kind = pending.pop()
        yield kind
        pending += kind.__subclasses__()


def error_of(code: str, detail: str) -> ServiceError | None:
    """The error that was told by this code and in these words; None: no class has the code."""
    for kind in kinds():
        if kind.code == code:
            error = kind.__new__(kind, detail)
            ServiceError.__init__(error, detail)
            return error
    return None
