"""Paths of uploads in orders: the name below the shared folder, wherever each side has that folder."""

from __future__ import annotations

from pathlib import Path, PurePath
from typing import Any

BELOW = "uploads:"


def moved(value: Any, away: Path | None, to: Path | None) -> Any:
    """`value` with paths below `away` said by name, and such names as paths below `to`; None: that is not done."""
    if isinstance(value, dict):
        return {key: moved(part, away, to) for key, part in value.items()}
    if isinstance(value, list):
        return [moved(part, away, to) for part in value]
    if not isinstance(value, str):
        return value
    if away is not None and PurePath(value).parent == away:
        return f"{BELOW}{PurePath(value).name}"
    if to is not None and value.startswith(BELOW):
        return str(to / PurePath(value.removeprefix(BELOW)).name)
    return value
