"""Links: bytes between this machine and vehicles, recorded, counted, and handed to the event loop in batches."""

from __future__ import annotations

from mavcal.service.link.endpoint import Endpoint, EndpointKind, Hand, parse_endpoint
from mavcal.service.link.link import Link
from mavcal.service.link.types import (
    Address,
    Batch,
    LinkEvent,
    LinkEventKind,
    LinkState,
    LinkStatistics,
    OwnIdentity,
    SigningConfig,
)

__all__ = [
    "Address",
    "Batch",
    "Endpoint",
    "EndpointKind",
    "Hand",
    "Link",
    "LinkEvent",
    "LinkEventKind",
    "LinkState",
    "LinkStatistics",
    "OwnIdentity",
    "SigningConfig",
    "parse_endpoint",
]
