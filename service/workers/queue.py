"""The queue that hands computations to workers."""

from __future__ import annotations

from procrastinate import App, PsycopgConnector

QUEUE = "computations"
TASK = "mavcal.compute"


def app_of(url: str) -> App:
    """The queue in a database; open it with ``app.open_async()``."""
    return App(connector=PsycopgConnector(conninfo=url, min_size=1, max_size=4))


def lock_of(order_id: str, vehicle: str | None) -> str:
    """Computations of one lock run one after the other: those on recordings of one vehicle."""
    return f"vehicle:{vehicle}" if vehicle else f"computation:{order_id}"
