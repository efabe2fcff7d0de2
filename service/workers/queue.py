"""The queue that hands computations to workers, and paths of uploads in its orders.

An upload is named by its path below the shared folder, wherever each side has that folder.
"""

from __future__ import annotations

from pathlib import Path, PurePath
from typing import Any

from procrastinate import App, PsycopgConnector

QUEUE = "computations"
TASK = "mavcal.compute"


def app_of(url: str) -> App:
    """The queue in a database; open it with ``app.open_async()``."""
    return App(connector=PsycopgConnector(conninfo=url, min_size=1, max_size=4))


def lock_of(order_id: str, vehicle: str | None) -> str:
    """Name of a lock, whose computations run one after the other: those on recordings of one vehicle."""
    return f"vehicle:{vehicle}" if vehicle else f"computation:{order_id}"


BELOW = "uploads:"


def moved(value: Any, away: Path | None, to: Path | None) -> Any:
    """`value` with paths below `away` made names, and such names made paths below `to`; None skips the step."""
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
