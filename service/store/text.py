"""JSON as the store keeps it."""

from __future__ import annotations

import json

from mavcal.service.store.rows import Json


def dump(value: Json) -> str:
    """JSON text; raises ValueError for a number that is not finite."""
    return json.dumps(value, allow_nan=False, separators=(",", ":"))


def object_of(text: str) -> Json:
    """The JSON object of a damaged row is empty: one row must not hide the others."""
    try:
        value = json.loads(text)
    except ValueError:
        return {}
    return value if isinstance(value, dict) else {}
