"""The audit trail."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, Field

from mavcal.service.api.models.wire import Wire
from mavcal.service.store.rows import AuditRow

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
