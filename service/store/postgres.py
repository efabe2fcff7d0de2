"""The store in PostgreSQL: one database for any number of service instances and workers.

A commit is on the disk when it returns (``synchronous_commit``), events excepted, as in the SQLite store. Numbers that
all writers share (events, the audit trail) are given out under one lock until the commit. So whoever reads on after a
number misses none. A connection that broke is made again with the next statement.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import psycopg
import structlog
from psycopg import conninfo, pq

from mavcal.service.errors import DiskFull, StoreError
from mavcal.service.store.database import Row
from mavcal.service.store.datadir import DataDirLock
from mavcal.service.store.migrate import Migration, migrations, outstanding
from mavcal.service.store.schema import to_postgres
from mavcal.service.store.sql import SqlStore

log = structlog.get_logger(__name__)

SCHEMA_LOCK, ORDER_LOCK = 0x6D61_7663, 0x6D61_7664
"""Advisory locks: one instance migrates at a time; one writer gives out numbers at a time."""

PATIENCE = {
    "connect_timeout": "10",
    "tcp_user_timeout": "15000",
    "keepalives_idle": "10",
    "keepalives_interval": "5",
    "keepalives_count": "3",
    "application_name": "mavcal",
}
"""What a connection is made with unless its URL says otherwise: a host that has gone is noticed in 15 s."""

_DISK_TROUBLE = {"53100", "58030"}


class _Executes:
    """A connection whose every statement returns its rows."""

    def __init__(self, connection: psycopg.Connection[Row]) -> None:
        self.connection = connection

    def execute(self, sql: str, values: Sequence[Any] = ()) -> list[Row]:
        """Run one statement; the rows that it returns, if any."""
        cursor = self.connection.execute(_placed(sql), values, binary=False)
        return [] if cursor.description is None else cursor.fetchall()


class PostgresDatabase:
    """See :class:`service.store.database.Database`.

    Parameters
    ----------
    url
        A libpq URL or connection string.
    part, steps
        Which part of the schema it brings up to date, and how. Parts have numbers of their own.
    """

    audit_end = "SELECT newest FROM audit_end"

    def __init__(self, url: str, part: str, steps: tuple[Migration, ...]) -> None:
        self._url = _with_patience(url)
        self._lock, self._reading = threading.RLock(), threading.RLock()
        self._writer = _Executes(self._connected())
        self._reader: _Executes | None = None
        with self.errors():
            try:
                self._warn_of_settings()
                self.version = self._migrated(part, steps)
            except BaseException:
                self._writer.connection.close()
                raise

    @contextmanager
    def alone(self) -> Iterator[None]:
        """See Database."""
        with self._lock:
            yield

    def execute(self, sql: str, values: Sequence[Any] = ()) -> list[Row]:
        """See Database."""
        return self._writer.execute(sql, values)

    def begin(self, *, durable: bool) -> None:
        """See Database."""
        start = f"BEGIN; SET LOCAL synchronous_commit = {'on' if durable else 'off'}"
        if self._keeps_more and durable:
            start = "BEGIN"
        try:
            self._writer.connection.execute(start)
        except psycopg.OperationalError:  # it broke after the last transaction, and nothing is open
            self._writer.connection.close()
            self._writer = _Executes(self._connected())
            self._writer.connection.execute(start)

    def commit(self) -> None:
        """See Database."""
        self._writer.connection.execute("COMMIT")

    def rollback(self) -> None:
        """See Database."""
        with suppress(psycopg.OperationalError):  # what has no connection has no transaction
            if self._writer.connection.info.transaction_status != pq.TransactionStatus.IDLE:
                self._writer.connection.execute("ROLLBACK")

    def in_order(self) -> None:
        """See Database."""
        self._writer.connection.execute("SELECT pg_advisory_xact_lock(%s)", (ORDER_LOCK,))

    def read(self, sql: str, values: Sequence[Any] = ()) -> list[Row]:
        """See Database."""
        with self._reading:
            try:
                return self._read_with().execute(sql, values)
            except psycopg.OperationalError:
                if self._reader is None or not self._reader.connection.broken:
                    raise
                self._reader = None
                return self._read_with().execute(sql, values)

    @contextmanager
    def snapshot(self) -> Iterator[_Executes]:
        """See Database."""
        with self._reading:
            reader = self._read_with()
            reader.connection.execute("BEGIN ISOLATION LEVEL REPEATABLE READ READ ONLY")
            try:
                yield reader
            finally:
                with suppress(psycopg.OperationalError):
                    reader.connection.execute("ROLLBACK")

    @contextmanager
    def errors(self) -> Iterator[None]:
        """See Database."""
        with typed_errors():
            yield

    def close(self) -> None:
        """See Database."""
        with self._lock, self._reading:
            self._writer.connection.close()
            if self._reader is not None:
                self._reader.connection.close()

    def _read_with(self) -> _Executes:
        if self._reader is None or self._reader.connection.closed:
            self._reader = _Executes(self._connected())
        return self._reader

    def _connected(self) -> psycopg.Connection[Row]:
        with typed_errors():
            return psycopg.connect(self._url, autocommit=True)

    def _warn_of_settings(self) -> None:
        """What the server is set to must not take back what a commit promises."""
        said = self.execute("SELECT current_setting('synchronous_commit'), current_setting('fsync')")[0]
        self._keeps_more = said[0] == "remote_apply"
        if said[1] == "off":
            log.warning("the database runs with fsync = off: a loss of power loses journals of writes")

    def _migrated(self, part: str, steps: tuple[Migration, ...]) -> int:
        with self._lock:
            self.begin(durable=True)
            try:
                self.execute("SELECT pg_advisory_xact_lock(?)", (SCHEMA_LOCK,))
                self.execute("CREATE TABLE IF NOT EXISTS schema_version (part TEXT PRIMARY KEY, version BIGINT)")
                known = self.execute("SELECT version FROM schema_version WHERE part = ?", (part,))
                version = int(known[0][0]) if known else 0
                if not known:
                    self.execute("INSERT INTO schema_version VALUES (?, 0)", (part,))
                for step in outstanding(version, steps):
                    self._writer.connection.execute(step.sql)
                    version = step.number
                    self.execute("UPDATE schema_version SET version = ? WHERE part = ?", (version, part))
                self.commit()
            except BaseException:
                self.rollback()
                raise
        return version


class PostgresStore(SqlStore):
    """Durable state in a PostgreSQL database; None owns no data directory (tests, commands, workers).

    Raises
    ------
    StoreError
        If the database cannot be reached, or was made by a newer version.
    DataDirLocked
        If another process owns the directory.
    DiskFull
        From every method that writes, when the database's disk is full; nothing of that write remains.
    """

    def __init__(self, url: str, data_dir: Path | None) -> None:
        owned = None if data_dir is None else DataDirLock(data_dir)
        try:
            database = PostgresDatabase(url, "store", _steps())
        except BaseException:
            if owned is not None:
                owned.release()
            raise
        super().__init__(database, owned)


def _steps() -> tuple[Migration, ...]:
    return tuple(replace(step, sql=to_postgres(step.sql)) for step in migrations("postgres"))


@contextmanager
def typed_errors() -> Iterator[None]:
    """Turns errors of the database into StoreError, or DiskFull."""
    try:
        yield
    except psycopg.Error as error:
        if error.sqlstate in _DISK_TROUBLE:
            raise DiskFull(f"{DiskFull.__doc__} ({error})") from error
        if isinstance(error, psycopg.OperationalError):
            raise StoreError(f"the database cannot be reached: {error}") from error
        raise StoreError(f"the database refused: {error}") from error


@cache
def _placed(sql: str) -> str:
    """A statement with its places marked as psycopg wants them."""
    return sql.replace("%", "%%").replace("?", "%s")


def _with_patience(url: str) -> str:
    try:
        given = conninfo.conninfo_to_dict(url)
    except psycopg.ProgrammingError:
        raise StoreError("the database's URL cannot be read: give postgresql://user@host/name") from None
    return conninfo.make_conninfo("", **{**PATIENCE, **given})
