"""Links."""

from __future__ import annotations

from pydantic import BaseModel, Field

from mavcal.service.api.models.base import Request
from mavcal.service.link.types import LinkState


class LinkRequest(Request):
    """Open a link."""

    url: str = Field(description="an endpoint such as udpin:0.0.0.0:14550", examples=["udpin:0.0.0.0:14550"])


class LinkModel(BaseModel):
    """A link."""

    # A Link as far as it can be told, with its vehicles.
    id: str
    url: str
    state: LinkState
    reason: str = Field(description="why it is in that state")
    signing_key: str | None = Field(description="name of the key that signs it; null: it is not signed")
    vehicles: list[str] = Field(description="ids of the vehicles heard on it")
    crc_errors: int = Field(description="damaged frames, which cannot be attributed to a sender")
