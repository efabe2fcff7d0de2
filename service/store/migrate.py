"""Numbered migrations: ``migrations/NNNN_name.sql``, each applied once and in order.

They are written in the words of SQLite. A file of the same name in ``migrations/postgres`` is read there instead of it;
:mod:`service.store.postgres` translates either.
"""

from __future__ import annotations

import sqlite3
from dataclasses import dataclass
from importlib import resources
from importlib.resources.abc import Traversable

from mavcal.service.errors import StoreError


@dataclass(frozen=True)
class Migration:
    """One step of the schema."""

    number: int
    name: str
    sql: str


def migrations(instead: str = "", *, package: str = "mavcal.service.store") -> tuple[Migration, ...]:
    """Every migration of a package, in order; `instead` names the folder of those that replace some."""
    folder = resources.files(package) / "migrations"
    files = _files(folder) | (_files(folder / instead) if instead else {})
    found = []
    for name, entry in files.items():
        number, _, title = name.removesuffix(".sql").partition("_")
        found.append(Migration(int(number), title, entry.read_text(encoding="utf-8")))
    return tuple(sorted(found, key=lambda m: m.number))


def _files(folder: Traversable) -> dict[str, Traversable]:
    return {entry.name: entry for entry in folder.iterdir() if entry.name.endswith(".sql")}


def outstanding(version: int, steps: tuple[Migration, ...]) -> tuple[Migration, ...]:
    """The steps that a database of that version lacks.

    Raises
    ------
    StoreError
        If the database was written by a newer version of the program.
    """
    newest = steps[-1].number if steps else 0
    if version > newest:
        raise StoreError(
            f"the database has schema {version}, this program knows {newest}: use the newer version of the program, "
            "or another database"
        )
    return tuple(step for step in steps if step.number > version)


def migrate(connection: sqlite3.Connection, steps: tuple[Migration, ...]) -> int:
    """Bring a SQLite schema to the last of `steps`; each step and its number are one transaction. Returns the version.

    Raises
    ------
    StoreError
        If the database was written by a newer version of the program.
    """
    version = int(connection.execute("PRAGMA user_version").fetchone()[0])
    for step in outstanding(version, steps):
        # executescript ends an open transaction first, so the script carries its own.
        script = f"BEGIN IMMEDIATE;\n{step.sql}\nPRAGMA user_version = {step.number};\nCOMMIT;"
        try:
            connection.executescript(script)
        except sqlite3.Error:
            if connection.in_transaction:
                connection.execute("ROLLBACK")
            raise
        version = step.number
    return version
