"""Signing keys, which never leave the service."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, Field, SecretStr

from mavcal.service.api.models.base import Request


class SigningKeyRequest(Request):
    """Keep a signing key."""

    name: str = Field(min_length=1, max_length=64, description="what links call it: letters, digits, `.`, `_`, `-`")
    key: SecretStr | None = Field(default=None, description="64 hexadecimal digits; null: a new random key")


class SigningKeyModel(BaseModel):
    """A signing key without the key."""

    name: str
    fingerprint: str = Field(description="the first 12 digits of the SHA-256 of the key's 32 bytes")
    source: Literal["settings", "file"] = Field(description="where it is kept")


class SigningRequest(Request):
    """Give the vehicle of a link a key."""

    key: str = Field(min_length=1, max_length=64, description="name of the key")
