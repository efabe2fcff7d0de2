"""The store that the settings name: SQLite in the data directory, or a PostgreSQL database shared by instances.

What PostgreSQL needs is imported only where the settings name a database.
"""

from __future__ import annotations

from contextlib import closing
from importlib.util import find_spec
from typing import TYPE_CHECKING

from mavcal.service.errors import StoreError
from mavcal.service.settings import Settings
from mavcal.service.store import SqliteStore, Store
from mavcal.service.store.chain import ChainCheck
from mavcal.service.store.rows import FleetRows, JobRow
from mavcal.service.store.sqlite import check_audit_of as check_sqlite
from mavcal.service.store.sqlite import fleet_of as fleet_of_sqlite
from mavcal.service.store.sqlite import jobs_of as jobs_of_sqlite

if TYPE_CHECKING:
    from pathlib import Path

    from mavcal.service.store.postgres import PostgresStore


def open_store(settings: Settings) -> Store:
    """The store, and the data directory with it.

    Raises
    ------
    DataDirLocked
        If another process owns the data directory.
    StoreError
        If the database cannot be reached or used.
    """
    if settings.database_url is None:
        return SqliteStore(settings.data_dir)
    return postgres_store(settings, settings.data_dir)


def postgres_store(settings: Settings, data_dir: Path | None) -> PostgresStore:
    """The PostgreSQL store of the settings; without a directory it owns none.

    Raises
    ------
    StoreError
        If the settings name no database, the extra ``fleet`` is not installed, or the database cannot be used.
    """
    url = require_fleet(settings)
    from mavcal.service.store.postgres import PostgresStore

    return PostgresStore(url, data_dir)


def require_fleet(settings: Settings) -> str:
    """The URL of the database that instances share.

    Raises
    ------
    StoreError
        If the settings name none, or the extra ``fleet`` is not installed.
    """
    if settings.database_url is None:
        raise StoreError("no database is named: set `database_url` (MAVCAL_DATABASE_URL) to a PostgreSQL database")
    missing = [name for name in ("psycopg", "procrastinate") if find_spec(name) is None]
    if missing:
        raise StoreError(f"PostgreSQL needs the extra `fleet` ({', '.join(missing)}): pip install 'mavcal[fleet]'")
    return settings.database_url.get_secret_value()


def check_audit_of(settings: Settings) -> ChainCheck:
    """Whether the audit trail is as it was written, also while a service runs. Raises StoreError."""
    if settings.database_url is None:
        return check_sqlite(settings.data_dir)
    with closing(postgres_store(settings, None)) as store:
        return store.check_audit()


def jobs_of(settings: Settings) -> tuple[JobRow, ...]:
    """Every job, oldest first, also while a service runs. Raises StoreError."""
    if settings.database_url is None:
        return jobs_of_sqlite(settings.data_dir)
    with closing(postgres_store(settings, None)) as store:
        return store.jobs()


def fleet_of(settings: Settings) -> FleetRows:
    """Every unit, also while a service runs. Raises StoreError."""
    if settings.database_url is None:
        return fleet_of_sqlite(settings.data_dir)
    with closing(postgres_store(settings, None)) as store:
        return store.fleet()
