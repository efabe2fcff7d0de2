"""Durable state: jobs and their events, the write journal, snapshots, plans, and where the samples lie.

:class:`~service.store.sql.Store` is what the rest of the service sees; :class:`~service.store.sqlite.SqliteStore`
keeps it in one SQLite file inside a data directory that one process owns. Rows carry plain JSON: the store does not
know what a job or a plan means.
"""

from mavcal.service.store.sql import Store
from mavcal.service.store.sqlite import SqliteStore

__all__ = ["SqliteStore", "Store"]
