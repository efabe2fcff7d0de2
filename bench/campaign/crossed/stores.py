"""The one seam to the store: which kind a campaign runs on, and what is seen of every write on its way there."""

from __future__ import annotations

import importlib
import json
import os
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, cast

from bench.campaign.crossed.disk import Disk
from mavcal.calib.report import to_json
from mavcal.service.store import SqliteStore, Store
from mavcal.service.store.sqlite import DATABASE

SQLITE = "sqlite"
NOT_FORCED = frozenset({"add_event", "drop_events"})
KEPT = frozenset({"save_job", "add_journal", "add_snapshot", "add_plan", "close_segment", "add_audit"})
"""What must not be lost once the store has taken it."""
WRITES = KEPT | NOT_FORCED | {"open_segment", "save_document", "delete_job"}


class _PlainSqlite(SqliteStore):
    """Its write-ahead log only grows, so that a loss of power is the cutting of its end."""

    def __init__(self, data_dir: Path) -> None:
        super().__init__(data_dir)
        self._db.execute("PRAGMA wal_autocheckpoint = 0")


@dataclass(frozen=True)
class StoreKind:
    """Which store: ``sqlite``, or ``MODULE:CLASS`` that is made of a `url` alone (``{run}`` in it names the run)."""

    name: str = SQLITE
    url: str = ""

    def opened(self, data_dir: Path, run: str) -> Store:
        """The store of a run; a second opening finds what the first has left."""
        if self.name == SQLITE:
            return _PlainSqlite(data_dir)
        module, _, attribute = self.name.partition(":")
        factory: Callable[[str], Store] = getattr(importlib.import_module(module), attribute)
        return factory(self.url.replace("{run}", run))

    @property
    def in_data_dir(self) -> bool:
        """Whether a loss of power takes what the store has not brought onto the disk; else its server lives on."""
        return self.name == SQLITE


class Ledger:
    """What the store has taken, in a file that survives the process."""

    def __init__(self, path: Path) -> None:
        self._file = os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_CLOEXEC, 0o600)

    def keep(self, what: str, arguments: tuple[Any, ...]) -> None:
        """Note one write that has returned."""
        os.write(self._file, json.dumps([what, to_json(arguments)], default=str).encode() + b"\n")

    def close(self) -> None:
        """Close the file."""
        os.close(self._file)


class WatchedStore:
    """A store whose writes pass a disk and a ledger; everything else is the store's own."""

    def __init__(self, store: Store, data_dir: Path, disk: Disk, ledger: Ledger) -> None:
        self._store, self._disk, self._ledger = store, disk, ledger
        self._wal = (data_dir / f"{DATABASE}-wal").resolve()

    def __getattr__(self, name: str) -> Any:
        method = getattr(self._store, name)
        return partial(self._write, name, method) if name in WRITES else method

    def _write(self, name: str, method: Callable[..., Any], *arguments: Any, **options: Any) -> Any:
        durable = name not in NOT_FORCED
        self._disk.store_write(name, durable=durable)
        result = method(*arguments, **options)
        if durable and self._wal.exists():
            self._disk.synced[self._wal] = self._wal.stat().st_size
        if name in KEPT:
            self._ledger.keep(name, (result,) if name == "close_segment" else arguments)
        return result


def watched(store: Store, data_dir: Path, disk: Disk, ledger: Ledger) -> Store:
    """`store` with its writes on their way through a disk and into a ledger."""
    return cast(Store, WatchedStore(store, data_dir, disk, ledger))
