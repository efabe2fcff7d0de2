"""The store in one SQLite file: write-ahead log, one writer at a time, readers that never wait for it.

State is written with ``synchronous = FULL`` (an fsync a commit: 5 ms on a good disk, 50 ms on an SD card), events with
``NORMAL``. Whoever runs on an event loop writes through :meth:`SqliteStore.do` or :meth:`SqliteStore.soon`.
"""

from __future__ import annotations

import sqlite3
import threading
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from mavcal.service.errors import DiskFull, StoreError
from mavcal.service.store import chain
from mavcal.service.store.database import Row
from mavcal.service.store.datadir import DataDirLock, require_database
from mavcal.service.store.fleet import read_fleet
from mavcal.service.store.migrate import migrate, migrations
from mavcal.service.store.rows import FleetRows, ItemRow, JobRow
from mavcal.service.store.sql import Store, checked
from mavcal.service.store.sqlitems import item_row, select_items
from mavcal.service.store.sqlrows import JOB, job_row

DATABASE = "mavcal.sqlite3"

MOST_ITEMS = 1_000_000
"""Limit of the items read of a campaign; no campaign has as many."""

_DISK_TROUBLE = {sqlite3.SQLITE_FULL, sqlite3.SQLITE_IOERR, sqlite3.SQLITE_READONLY, sqlite3.SQLITE_CANTOPEN}


class _Executes:
    """A connection whose every statement returns its rows."""

    def __init__(self, connection: sqlite3.Connection) -> None:
        self.connection = connection

    def execute(self, sql: str, values: Sequence[Any] = ()) -> list[Row]:
        """Run one statement; the rows that it returns, if any."""
        return self.connection.execute(sql, values).fetchall()


class SqliteDatabase(_Executes):
    """See :class:`service.store.database.Database`; None keeps it in memory."""

    audit_end = "SELECT coalesce(max(seq), 0) FROM sqlite_sequence WHERE name = 'audit'"

    def __init__(self, data_dir: Path | None) -> None:
        self._lock = threading.RLock()
        target = ":memory:" if data_dir is None else (data_dir / DATABASE).absolute().as_uri()
        super().__init__(_connection(target))
        if data_dir is not None:
            require_database(data_dir, empty=_is_empty(self.connection))
        self.execute("PRAGMA journal_mode = WAL")
        self.execute("PRAGMA synchronous = FULL")
        self._durable = True
        self.version = migrate(self.connection, migrations())
        self.execute("PRAGMA foreign_keys = ON")  # after migrations, which may make a table once more
        # A database in memory belongs to its one connection.
        self._reader, self._reading = (
            (self.connection, self._lock) if data_dir is None else (_connection(target), threading.RLock())
        )

    @contextmanager
    def alone(self) -> Iterator[None]:
        """See Database."""
        with self._lock:
            yield

    def begin(self, *, durable: bool) -> None:
        """See Database."""
        if durable != self._durable:
            self.execute(f"PRAGMA synchronous = {'FULL' if durable else 'NORMAL'}")
            self._durable = durable
        self.execute("BEGIN IMMEDIATE")

    def commit(self) -> None:
        """See Database."""
        self.execute("COMMIT")

    def rollback(self) -> None:
        """See Database."""
        if self.connection.in_transaction:
            self.execute("ROLLBACK")

    def in_order(self) -> None:
        """Nothing: there is one writer."""

    def read(self, sql: str, values: Sequence[Any] = ()) -> list[Row]:
        """See Database."""
        with self._reading:
            return self._reader.execute(sql, values).fetchall()

    @contextmanager
    def snapshot(self) -> Iterator[_Executes]:
        """See Database."""
        with self._reading:
            own = self._reader is not self.connection
            if own:
                self._reader.execute("BEGIN")
            try:
                yield _Executes(self._reader)
            finally:
                if own:
                    self._reader.execute("ROLLBACK")

    @contextmanager
    def errors(self) -> Iterator[None]:
        """See Database."""
        with _typed_errors():
            yield

    def close(self) -> None:
        """See Database."""
        with self._lock, self._reading:
            self._reader.close()
            self.connection.close()


class SqliteStore(Store):
    """Durable state of one data directory; None keeps it in memory (for tests and one-off commands).

    Raises
    ------
    DataDirLocked
        If another process owns the directory.
    DiskFull
        From every method that writes, when the disk is full; nothing of that write remains.
    """

    def __init__(self, data_dir: Path | None) -> None:
        owned = None if data_dir is None else DataDirLock(data_dir)
        try:
            with _typed_errors():
                database = SqliteDatabase(data_dir)
        except StoreError:
            if owned is not None:
                owned.release()
            raise
        super().__init__(database, owned)
        self._db = database.connection


def check_audit_of(data_dir: Path) -> chain.ChainCheck:
    """Whether the audit trail of a data directory is as it was written, also while another process owns it.

    Raises
    ------
    StoreError
        If there is no database, or it has no chain.
    """
    with _read_only(data_dir) as db:
        return checked(db, SqliteDatabase)


def jobs_of(data_dir: Path) -> tuple[JobRow, ...]:
    """Every job of a data directory, oldest first, also while another process owns it.

    Raises
    ------
    StoreError
        If there is no database.
    """
    with _read_only(data_dir) as db:
        return tuple(map(job_row, db.execute(f"SELECT {JOB} FROM jobs ORDER BY created_at, rowid")))


def fleet_of(data_dir: Path) -> FleetRows:
    """Every unit of a data directory, also while another process owns it. Raises StoreError: there is no database."""
    with _read_only(data_dir) as db:
        return read_fleet(db.execute)


def items_of(data_dir: Path, job_id: str, outcomes: Collection[str] | None = None) -> tuple[ItemRow, ...]:
    """The items of a campaign, also while another process owns the data directory.

    Raises
    ------
    StoreError
        If there is no database.
    """
    with _read_only(data_dir) as db:
        sql, values = select_items(job_id, limit=MOST_ITEMS, outcomes=outcomes)
        return tuple(map(item_row, db.execute(sql, values)))


@contextmanager
def _read_only(data_dir: Path) -> Iterator[_Executes]:
    """One state of the database of a data directory, whoever owns it."""
    path = data_dir / DATABASE
    if not path.is_file():
        raise StoreError(f"there is no database in {data_dir}: give the --data-dir of the service")
    with _typed_errors():
        db = _connection(f"{path.absolute().as_uri()}?mode=ro")
        try:
            db.execute("BEGIN")
            yield _Executes(db)
        finally:
            db.close()


def _is_empty(db: sqlite3.Connection) -> bool:
    return int(db.execute("SELECT count(*) FROM sqlite_master").fetchone()[0]) == 0


def _connection(target: str) -> sqlite3.Connection:
    connection = sqlite3.connect(target, isolation_level=None, check_same_thread=False, timeout=5.0, uri=True)
    connection.text_factory = _text
    return connection


@contextmanager
def _typed_errors() -> Iterator[None]:
    try:
        yield
    except sqlite3.Error as error:
        code = getattr(error, "sqlite_errorcode", 0) & 0xFF  # the low byte is the primary code
        if code in _DISK_TROUBLE:
            raise DiskFull(f"{DiskFull.__doc__} ({error})") from error
        raise StoreError(f"the database refused: {error}") from error


def _text(data: bytes) -> str:
    return data.decode("utf-8", "replace")  # a damaged text is one bad row, not a failed query
