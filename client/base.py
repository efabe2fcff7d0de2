"""What the models share."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict

Number = int | float
"""A number as it was sent: an integer stays one."""


class Answer(BaseModel):
    """What the service says. A field that a newer service adds is passed over."""

    model_config = ConfigDict(frozen=True, extra="ignore", defer_build=True)


class Request(BaseModel):
    """What is asked. Fields that were not given are not sent, and the service takes its defaults."""

    model_config = ConfigDict(frozen=True, extra="forbid", defer_build=True)
