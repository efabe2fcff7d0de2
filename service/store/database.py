"""Interface of the store to a database: one writer, one reader, transactions, and our own errors.

Statements are the same for every database. They use only what SQLite and PostgreSQL share: ``?`` for a value, columns
by name, ``ON CONFLICT``, ``RETURNING``. The column ``rowid`` is the order of insertion. What differs is here.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import AbstractContextManager
from typing import Any, Protocol

Row = tuple[Any, ...]


class Session(Protocol):
    """A connection inside a transaction."""

    def execute(self, sql: str, values: Sequence[Any] = ()) -> list[Row]:
        """Run one statement; the rows that it returns, if any."""


class Database(Session, Protocol):
    """One database; its own :meth:`execute` belongs to the transaction that is being written."""

    version: int
    """Number of the last migration."""
    audit_end: str
    """Statement that tells the id of the newest row that the audit trail was ever given; 0: none."""

    def alone(self) -> AbstractContextManager[Any]:
        """Lock the writing connection to the calling thread."""

    def begin(self, *, durable: bool) -> None:
        """Begin a transaction; if not `durable`, a loss of power may lose it and later transactions."""

    def commit(self) -> None:
        """Commit the transaction; a durable one now survives a loss of power."""

    def rollback(self) -> None:
        """Roll back uncommitted changes; without a transaction nothing happens."""

    def in_order(self) -> None:
        """Lock the sequence that all writers share until the end of this transaction."""

    def read(self, sql: str, values: Sequence[Any] = ()) -> list[Row]:
        """The rows last committed, read without waiting for the writer."""

    def snapshot(self) -> AbstractContextManager[Session]:
        """Several statements that see one state of the database."""

    def errors(self) -> AbstractContextManager[Any]:
        """Turns errors of the database into StoreError, or DiskFull."""

    def close(self) -> None:
        """Close every connection."""
