"""The root of everything that ``service`` raises on purpose."""

from __future__ import annotations

from typing import ClassVar


class ServiceError(Exception):
    """Something went wrong inside the service; its log says what."""

    status_code: ClassVar[int] = 500
    title: ClassVar[str] = "Internal error"
    code: ClassVar[str] = "internal-error"

    def __init__(self, message: str | None = None) -> None:
        super().__init__(message or self.__doc__)
