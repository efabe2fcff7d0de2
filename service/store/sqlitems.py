"""Items of campaigns, in statements that every database takes.

These rows are not forced to the disk. An item lost in a loss of power is done again; a killed process loses none. A
calibration begun by an item is a job of its own.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Any

from mavcal.service.store.database import Row
from mavcal.service.store.rows import ItemRow
from mavcal.service.store.sqlrows import SqlRows, dump, object_of

_ITEM = "job_id, number, subject, outcome, body"


class SqlItems(SqlRows):
    """The items of campaigns."""

    def add_items(self, rows: Sequence[ItemRow]) -> None:
        """Keep the items of a campaign, all or none."""
        with self._write() as db:
            for row in rows:
                db.execute(f"INSERT INTO campaign_items ({_ITEM}) VALUES (?, ?, ?, ?, ?)", _values(row))

    def save_item(self, row: ItemRow) -> None:
        """Keep what has become of an item. Not forced to the disk: a loss of power may take the last ones back."""
        sql = "UPDATE campaign_items SET outcome = ?, body = ? WHERE job_id = ? AND number = ?"
        with self._write(durable=False) as db:
            db.execute(sql, (row.outcome, dump(row.body), row.job_id, row.number))

    def items(
        self, job_id: str, *, after: int = 0, limit: int = 1000, outcomes: Collection[str] | None = None
    ) -> tuple[ItemRow, ...]:
        """Items of a campaign behind a number, in their order; `outcomes` None: of every outcome."""
        return tuple(map(item_row, self._read(*select_items(job_id, after=after, limit=limit, outcomes=outcomes))))

    def item_counts(self, job_id: str) -> dict[str, int]:
        """How many items of a campaign have each outcome; outcomes that none has are left out."""
        sql = "SELECT outcome, count(*) FROM campaign_items WHERE job_id = ? GROUP BY outcome ORDER BY outcome"
        return {str(outcome): int(count) for outcome, count in self._read(sql, (job_id,))}

    def change_outcomes(self, job_id: str, outcomes: Collection[str], to: str) -> None:
        """Give all items of these outcomes another one. Not forced to the disk."""
        chosen = sorted(outcomes)
        sql = f"UPDATE campaign_items SET outcome = ? WHERE job_id = ? AND outcome IN ({', '.join('?' * len(chosen))})"
        with self._write(durable=False) as db:
            db.execute(sql, (to, job_id, *chosen))


def select_items(
    job_id: str, *, after: int = 0, limit: int = 1000, outcomes: Collection[str] | None = None
) -> tuple[str, tuple[Any, ...]]:
    """The statement behind :meth:`SqlItems.items`, and its values."""
    chosen = [] if outcomes is None else sorted(outcomes)
    among = "" if outcomes is None else f" AND outcome IN ({', '.join('?' * len(chosen)) or 'NULL'})"
    sql = f"SELECT {_ITEM} FROM campaign_items WHERE job_id = ? AND number > ?{among} ORDER BY number LIMIT ?"
    return sql, (job_id, after, *chosen, limit)


def item_row(row: Row) -> ItemRow:
    """Reads an item; the body of a damaged row is empty."""
    return ItemRow(row[0], row[1], row[2], row[3], object_of(row[4]))


def _values(row: ItemRow) -> tuple[Any, ...]:
    return row.job_id, row.number, row.subject, row.outcome, dump(row.body)
