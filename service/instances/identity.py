"""Which instance this is: the same as before its restart if it has the same data directory."""

from __future__ import annotations

import secrets
import socket

from mavcal.service.instances.leases import Owner
from mavcal.service.settings import Settings

FILE = "instance"


def owner_of(settings: Settings) -> Owner:
    """The owner of this data directory, which no other process has; its earlier leases are taken back at once."""
    path = settings.data_dir / FILE
    known = path.read_text(encoding="ascii").strip() if path.is_file() else ""
    if not known:
        known = secrets.token_hex(8)
        path.write_text(f"{known}\n", encoding="ascii")
    return Owner(known, settings.fleet.name or f"{socket.gethostname()}:{settings.port}", settings.fleet.url)
