"""Leases in the database: acquired, renewed, given back, and checked inside transactions of others.

They end by the database's clock. Our own leases are also judged by a local clock that runs on while the process or the
machine sleeps. It counts from the moment at which the last renewal was asked for, so it never counts too long.
"""

from __future__ import annotations

import time
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from mavcal.service.errors import LeaseLost
from mavcal.service.store.database import Row, Session
from mavcal.service.store.migrate import migrations
from mavcal.service.store.postgres import PostgresDatabase
from mavcal.service.store.sqlrows import Fence

EVERY_INSTANCE = "instance:"


@dataclass(frozen=True)
class Owner:
    """One life of an instance. `id` is that of its data directory, which one process owns at a time."""

    id: str
    name: str
    url: str | None

    def __str__(self) -> str:
        return f"{self.name} ({self.url})" if self.url else self.name


def clock() -> float:
    """Monotonic seconds that also count while the machine is suspended."""
    return time.clock_gettime(time.CLOCK_BOOTTIME) if hasattr(time, "CLOCK_BOOTTIME") else time.monotonic()


class Leases:
    """The leases of one instance; methods that ask the database block.

    Parameters
    ----------
    url
        The database; a connection of its own keeps renewals from waiting behind other transactions.
    owner
        Who acquires.
    lease_s
        How long a lease holds without renewal.
    """

    def __init__(self, url: str, owner: Owner, lease_s: float) -> None:
        self.owner = owner
        self.lease_s = lease_s
        self._database = PostgresDatabase(url, "instances", migrations(package="mavcal.service.instances"))
        self._held: dict[str, tuple[int, float]] = {}
        """Token, and the time until which it certainly holds, by subject."""

    def close(self) -> None:
        """Close the connection; leases that were not given back run out."""
        self._database.close()

    def acquire(self, subject: str) -> bool:
        """Acquire the lease of `subject`; False if another instance owns it."""
        began = clock()
        rows = self._run(
            "INSERT INTO leases (subject, owner, name, url, token, expires) VALUES "
            "(?, ?, ?, ?, nextval('lease_tokens'), clock_timestamp() + make_interval(secs => ?)) "
            "ON CONFLICT (subject) DO UPDATE SET owner = excluded.owner, name = excluded.name, url = excluded.url, "
            "token = excluded.token, expires = excluded.expires "
            "WHERE leases.owner = excluded.owner OR leases.expires < clock_timestamp() RETURNING token",
            (subject, self.owner.id, self.owner.name, self.owner.url, self.lease_s),
        )
        if rows:
            self._held[subject] = (int(rows[0][0]), began + self.lease_s)
        return bool(rows)

    def renew(self) -> set[str]:
        """Renew every lease; returns the subjects whose lease was lost."""
        held = dict(self._held)
        began = clock()
        rows = self._run(
            "UPDATE leases SET expires = clock_timestamp() + make_interval(secs => ?) "
            "WHERE owner = ? AND token = ANY(?) RETURNING subject, token",
            (self.lease_s, self.owner.id, [token for token, _ in held.values()]),
        )
        kept = {(subject, token) for subject, token in rows}
        lost = set()
        for subject, (token, _) in held.items():
            if (subject, token) in kept:
                self._held[subject] = (token, began + self.lease_s)
            elif self._held.get(subject, (0, 0.0))[0] == token:
                del self._held[subject]
                lost.add(subject)
        return lost

    def release(self, subject: str) -> None:
        """Give a lease back; one that is not held is no error."""
        token, _ = self._held.pop(subject, (0, 0.0))
        if token:
            self._run("DELETE FROM leases WHERE subject = ? AND token = ?", (subject, token))

    def mine(self, prefix: str) -> tuple[str, ...]:
        """Subjects of a kind that were acquired and not lost, also where the lease may have run out meanwhile."""
        return tuple(subject for subject in tuple(self._held) if subject.startswith(prefix))

    def holds(self, subject: str) -> bool:
        """Whether the lease certainly holds at this instant."""
        _, until = self._held.get(subject, (0, 0.0))
        return clock() < until

    def owners(self) -> dict[str, Owner]:
        """The present owner of every subject, this instance included."""
        with self._database.errors():
            rows = self._database.read("SELECT subject, owner, name, url FROM leases WHERE expires > clock_timestamp()")
        return {subject: Owner(owner, name, url) for subject, owner, name, url in rows}

    def fence(self, subject: str) -> Fence:
        """Check at the beginning of our transactions, which go on only while the present lease holds.

        Until its end nobody else can acquire the lease. Raises LeaseLost, also at once if it is not held now.
        """
        token, _ = self._held.get(subject, (0, 0.0))
        if not token:
            raise LeaseLost(f"{subject} is not owned by this instance")

        def check(db: Session) -> None:
            held = db.execute(
                "SELECT 1 FROM leases WHERE subject = ? AND token = ? AND expires > clock_timestamp() FOR SHARE",
                (subject, token),
            )
            if not held:
                self._mark_lost(subject, token)
                raise LeaseLost(f"this instance does not own {subject} any more: nothing is kept or written for it")

        return check

    def _mark_lost(self, subject: str, token: int) -> None:
        """Treat a lease as lost until it is renewed."""
        if self._held.get(subject, (0, 0.0))[0] == token:
            self._held[subject] = (token, 0.0)

    def _run(self, sql: str, values: Collection[Any]) -> list[Row]:
        with self._transaction() as db:
            return db.execute(sql, tuple(values))

    @contextmanager
    def _transaction(self) -> Iterator[Session]:
        database = self._database
        with database.alone(), database.errors():
            database.begin(durable=True)
            try:
                yield database
                database.commit()
            except BaseException:
                database.rollback()
                raise
