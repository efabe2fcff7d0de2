"""The service itself, and its audit trail."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, Field

from mavcal.service.api.models.wire import Wire
from mavcal.service.store.rows import AuditRow


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
    """How BlueOS lists a service; it drops the whole if one of the first seven is missing."""

    name: str
    description: str
    icon: str = Field(description="name of an icon of Material Design Icons")
    company: str
    version: str
    webpage: str
    api: str = Field(description="address of the API's page, relative to the root of the service")
    route: str = Field(description="address of the panel below the root; empty: the root itself")
    new_page: bool = Field(description="whether it opens in a page of its own")
    extra_query: str
    avoid_iframes: bool
    works_in_relative_paths: bool
    extras: dict[str, str] = Field(description="addresses of manifests for other hosts, by host")


AuditModel = Annotated[AuditRow, Wire("AuditModel")]


class AuditPage(BaseModel):
    """Rows of the audit trail, oldest first."""

    rows: list[AuditModel]
    next: int | None = Field(description="`after` of the next page; null: this is the last one")


class AuditCheck(BaseModel):
    """Whether the audit trail is as it was written."""

    # A ChainCheck with its verdict.
    intact: bool
    rows: int = Field(description="how many there are")
    head: str = Field(description="digest of the newest row; kept elsewhere it vouches for all rows up to it")
    broken_at: int | None = Field(description="first row that does not fit; null: all do")
