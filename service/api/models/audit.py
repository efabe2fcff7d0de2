"""The audit trail."""

from __future__ import annotations

from pydantic import BaseModel, Field

from mavcal.service.api.models.base import Json, Stamp


class AuditModel(BaseModel):
    """Who asked for what."""

    id: int = Field(description="rows are numbered in the order of their arrival")
    at: Stamp
    actor: str
    action: str
    subject: str
    detail: Json
    sha256: str | None = Field(description="covers this row and all before it; null: from before there was a chain")


class AuditPage(BaseModel):
    """Rows of the audit trail, oldest first."""

    rows: list[AuditModel]
    next: int | None = Field(description="`after` of the next page; null: this is the last one")


class AuditCheck(BaseModel):
    """Whether the audit trail is as it was written."""

    intact: bool
    rows: int = Field(description="how many there are")
    head: str = Field(description="digest of the newest row; kept elsewhere it vouches for all rows up to it")
    broken_at: int | None = Field(description="first row that does not fit; null: all do")
