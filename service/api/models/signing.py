"""Signing keys, which never leave the service."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, SecretStr

from mavcal.service.api.models.base import Request
from mavcal.service.api.models.wire import Wire
from mavcal.service.signing_keys import KnownKey


class SigningKeyRequest(Request):
    """Keep a signing key."""

    name: str = Field(min_length=1, max_length=64, description="what links call it: letters, digits, `.`, `_`, `-`")
    key: SecretStr | None = Field(default=None, description="64 hexadecimal digits; null: a new random key")


SigningKeyModel = Annotated[KnownKey, Wire("SigningKeyModel")]


class SigningRequest(Request):
    """Give the vehicle of a link a key."""

    key: str = Field(min_length=1, max_length=64, description="name of the key")
