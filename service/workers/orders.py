"""Computations in the database, for the instance that requests them and the worker. Methods block."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from mavcal.service.store.database import Row
from mavcal.service.store.migrate import Migration, migrations
from mavcal.service.store.postgres import PostgresDatabase

Json = dict[str, Any]


@dataclass(frozen=True)
class Computation:
    """A task of :mod:`service.children.tasks` with its order and limits."""

    id: str
    task: str
    body: Json
    starts: int
    """Number of starts by workers, this one included."""


@dataclass(frozen=True)
class HowFar:
    """Progress of a computation; `result` is None until it has ended."""

    said: str | None
    result: Json | None


class Orders:
    """The computations of a database; one is wanted for `wanted_s` seconds after the last request for its progress."""

    def __init__(self, url: str, wanted_s: float) -> None:
        self._wanted_s = wanted_s
        self._database = PostgresDatabase(url, "workers", _steps())

    def close(self) -> None:
        """Close the connections."""
        self._database.close()

    # --- who asks

    def put(self, order_id: str, task: str, body: Json) -> None:
        """Ask for a computation."""
        self._run(
            "INSERT INTO computations (id, task, body, wanted) VALUES "
            "(?, ?, ?, clock_timestamp() + make_interval(secs => ?))",
            (order_id, task, json.dumps(body, allow_nan=False), self._wanted_s),
        )

    def look(self, order_id: str) -> HowFar:
        """The progress of a computation; also notes that it is still wanted."""
        rows = self._run(
            "UPDATE computations SET wanted = clock_timestamp() + make_interval(secs => ?) WHERE id = ? "
            "RETURNING said, result",
            (self._wanted_s, order_id),
            durable=False,
        )
        if not rows:
            return HowFar(None, {"lost": "its order is gone from the database"})
        return HowFar(rows[0][0], None if rows[0][1] is None else json.loads(rows[0][1]))

    def forget(self, order_id: str) -> None:
        """Withdraw a computation; the worker that runs it stops."""
        self._run("DELETE FROM computations WHERE id = ?", (order_id,))

    # --- who computes

    def take(self, order_id: str, worker: str) -> Computation | None:
        """Begin a computation; None: nobody waits for it, or it has ended."""
        rows = self._run(
            "UPDATE computations SET starts = starts + 1, worker = ? "
            "WHERE id = ? AND result IS NULL AND wanted > clock_timestamp() RETURNING id, task, body, starts",
            (worker, order_id),
        )
        return Computation(rows[0][0], rows[0][1], json.loads(rows[0][2]), int(rows[0][3])) if rows else None

    def report_progress(self, order_id: str, worker: str, said: str) -> None:
        """Store the progress of a computation."""
        self._run(
            "UPDATE computations SET said = ? WHERE id = ? AND worker = ?", (said, order_id, worker), durable=False
        )

    def wanted(self, order_id: str, worker: str) -> bool:
        """Whether somebody waits for it still, and this worker is the one that computes it."""
        sql = "SELECT 1 FROM computations WHERE id = ? AND worker = ? AND wanted > clock_timestamp()"
        with self._database.errors():
            return bool(self._database.read(sql, (order_id, worker)))

    def finish(self, order_id: str, worker: str, result: Json) -> None:
        """Store the result, unless another worker has taken the computation meanwhile."""
        text = json.dumps(result, allow_nan=False)
        self._run("UPDATE computations SET result = ? WHERE id = ? AND worker = ?", (text, order_id, worker))

    def sweep(self, older_s: float) -> None:
        """Delete computations that nobody has waited for in so long."""
        sql = "DELETE FROM computations WHERE wanted < clock_timestamp() - make_interval(secs => ?)"
        self._run(sql, (older_s,), durable=False)

    def _run(self, sql: str, values: Sequence[Any], *, durable: bool = True) -> list[Row]:
        database = self._database
        with database.alone(), database.errors():
            database.begin(durable=durable)
            try:
                rows = database.execute(sql, values)
                database.commit()
            except BaseException:
                database.rollback()
                raise
        return rows


def _steps() -> tuple[Migration, ...]:
    """Our table, then the schema of procrastinate as it was when this step was made."""
    from procrastinate.schema import SchemaManager

    own = migrations(package="mavcal.service.workers")
    return (*own, Migration(len(own) + 1, "procrastinate", SchemaManager.get_schema()))
