"""Links, and the signing keys of their vehicles, which never leave the service."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, Field, SecretStr

from mavcal.service.api.models.base import Request
from mavcal.service.api.models.wire import Wire
from mavcal.service.link.types import LinkState
from mavcal.service.signing_keys import KnownKey


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


class SigningKeyRequest(Request):
    """Keep a signing key."""

    name: str = Field(min_length=1, max_length=64, description="what links call it: letters, digits, `.`, `_`, `-`")
    key: SecretStr | None = Field(default=None, description="64 hexadecimal digits; null: a new random key")


SigningKeyModel = Annotated[KnownKey, Wire("SigningKeyModel")]


class SigningRequest(Request):
    """Give the vehicle of a link a key."""

    key: str = Field(min_length=1, max_length=64, description="name of the key")
