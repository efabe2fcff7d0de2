"""What the models share."""

from __future__ import annotations

from functools import cached_property
from typing import Any, Generic, TypeVar

from pydantic import BaseModel, ConfigDict, TypeAdapter

T = TypeVar("T")

Number = int | float
"""A number as it was sent: an integer stays one."""


class Answer(BaseModel):
    """What the service says. A field that a newer service adds is passed over."""

    model_config = ConfigDict(frozen=True, extra="ignore", defer_build=True)


class Request(BaseModel):
    """What is asked. Fields that were not given are not sent, and the service takes its defaults."""

    model_config = ConfigDict(frozen=True, extra="forbid", defer_build=True)


class Reader(Generic[T]):
    """How answers of one shape are read. Made ready at the first answer: a program needs few of all shapes."""

    def __init__(self, shape: Any) -> None:
        self._shape = shape

    @cached_property
    def adapter(self) -> TypeAdapter[T]:
        """What reads them."""
        return TypeAdapter(self._shape)
