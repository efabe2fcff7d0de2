"""The service itself."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, Field


class TicketModel(BaseModel):
    """A ticket for one event stream."""

    ticket: str = Field(description="empty: the service runs without keys, and asks for none")
    valid_s: float = Field(description="how long it is good, s")


class HealthModel(BaseModel):
    """The process answers."""

    status: Literal["ok"]


class ReadinessModel(BaseModel):
    """Whether jobs can be run."""

    status: Literal["ready", "not ready"]
    reason: str = Field(default="", description="what keeps jobs from being run")


class InfoModel(BaseModel):
    """Name and versions."""

    name: str
    version: str
    python: str


class RegistrationModel(BaseModel):
    """How BlueOS lists a service."""

    name: str
    description: str
    icon: str
    company: str
    version: str
    webpage: str
    api: str
    works_in_relative_paths: bool
    new_page: bool
