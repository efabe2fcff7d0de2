"""Numbered migrations: ``migrations/NNNN_name.sql``, each applied once and in order."""

from __future__ import annotations

import sqlite3
from dataclasses import dataclass
from importlib import resources

from mavcal.service.errors import StoreError


@dataclass(frozen=True)
class Migration:
    """One step of the schema."""

    number: int
    name: str
    sql: str


def migrations() -> tuple[Migration, ...]:
    """Every migration of this version, in order."""
    folder = resources.files("mavcal.service.store") / "migrations"
    found = []
    for entry in folder.iterdir():
        if entry.name.endswith(".sql"):
            number, _, name = entry.name.removesuffix(".sql").partition("_")
            found.append(Migration(int(number), name, entry.read_text(encoding="utf-8")))
    return tuple(sorted(found, key=lambda m: m.number))


def migrate(connection: sqlite3.Connection, steps: tuple[Migration, ...]) -> int:
    """Bring the schema to the last of `steps`; each step and its number are one transaction. Returns the version.

    Raises
    ------
    StoreError
        If the database was written by a newer version of the program.
    """
    version = int(connection.execute("PRAGMA user_version").fetchone()[0])
    newest = steps[-1].number if steps else 0
    if version > newest:
        raise StoreError(
            f"the database has schema {version}, this program knows {newest}: use the newer version of the program, "
            "or another --data-dir"
        )
    for step in steps:
        if step.number > version:
            # executescript ends an open transaction first, so the script carries its own.
            script = f"BEGIN IMMEDIATE;\n{step.sql}\nPRAGMA user_version = {step.number};\nCOMMIT;"
            try:
                connection.executescript(script)
            except sqlite3.Error:
                if connection.in_transaction:
                    connection.execute("ROLLBACK")
                raise
    return max(version, newest)
