"""The hash chain of the audit trail: an entry that was changed, removed or inserted later does not fit the digests."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from dataclasses import dataclass

from mavcal.service.store.rows import AuditRow

BEGINNING = hashlib.sha256(b"mavcal audit trail").hexdigest()


def link(previous: str, row: AuditRow) -> str:
    """The digest of `row`, which covers `previous`, the digest of the row before it."""
    covered = [previous, row.id, row.at, row.actor, row.action, row.subject, row.detail]
    text = json.dumps(covered, allow_nan=False, separators=(",", ":"), sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


@dataclass(frozen=True)
class ChainCheck:
    """Result of a check of the whole trail; `rows`, `head` and `newest_id` show whether its end was cut off."""

    rows: int
    head: str
    """Digest of the newest row: kept elsewhere, it vouches for everything before it."""
    broken_at: int | None
    """Id of the first row that does not fit; None: all fit."""

    @property
    def intact(self) -> bool:
        """Whether every digest matches its row."""
        return self.broken_at is None


def check(rows: Iterable[AuditRow], newest_id: int) -> ChainCheck:
    """Check a trail from its first row on; `newest_id` is the id that was given out last."""
    head, count, last_id, chained = BEGINNING, 0, 0, False
    for row in rows:
        head = link(head, row)
        count += 1
        fits = row.id == last_id + 1 and (row.sha256 == head or (row.sha256 is None and not chained))
        if not fits:
            return ChainCheck(count, head, row.id)
        chained = chained or row.sha256 is not None
        last_id = row.id
    return ChainCheck(count, head, None if last_id == newest_id else last_id + 1)
