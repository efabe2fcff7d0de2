"""A PostgreSQL of one's own for crossed runs: on loopback, in a temporary folder, one database a run."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress

import psycopg
from psycopg import conninfo, sql

from bench.campaign.crossed.stores import StoreKind
from mavcal.service.store.postgres import PostgresStore

STORE = f"{__name__}:database"


def database(url: str) -> PostgresStore:
    """The store of the run that the database of `url` is named after; it is made if it is not there."""
    parts = conninfo.conninfo_to_dict(url)
    name = str(parts["dbname"])
    with (
        suppress(psycopg.errors.DuplicateDatabase),  # the run has lived before
        psycopg.connect(conninfo.make_conninfo(url, dbname="postgres"), autocommit=True) as connection,
    ):
        connection.execute(sql.SQL("CREATE DATABASE {}").format(sql.Identifier(name)))
    return PostgresStore(url, None)


@contextmanager
def served() -> Iterator[StoreKind]:
    """A server that runs as long as the context.

    Raises
    ------
    NoServer
        If PostgreSQL is not installed.
    """
    from tests.postgres import Server

    server = Server()
    try:
        yield StoreKind(STORE, server.url("{run}"))
    finally:
        server.stop()
