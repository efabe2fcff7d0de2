"""The outcome of a campaign as a table."""

from __future__ import annotations

from collections.abc import Iterable
from datetime import UTC, datetime

from mavcal.service.campaigns.items import Item
from mavcal.service.spreadsheet import csv_text, inert

COLUMNS = ("item", "subject", "name", "outcome", "code", "text", "job", "begun_utc", "ended_utc", "seconds")


def head() -> str:
    """The first line of the CSV."""
    return csv_text([COLUMNS])


def lines(items: Iterable[Item]) -> str:
    """One line an item."""
    return csv_text(map(_cells, items))


def _cells(item: Item) -> tuple[str, ...]:
    texts = (item.subject, item.name, item.outcome.value, item.code, item.text, item.job_id or "")
    return (str(item.number), *map(inert, texts), _utc(item.began_at), _utc(item.ended_at), _seconds(item))


def _seconds(item: Item) -> str:
    """Duration of the work; as the worker measured it, if it did, without the wait for the worker."""
    measured = (item.result or {}).get("seconds")
    if measured is None and item.began_at is not None and item.ended_at is not None:
        measured = item.ended_at - item.began_at
    return "" if measured is None else f"{measured:.3f}"


def _utc(at: float | None) -> str:
    return "" if at is None else datetime.fromtimestamp(at, UTC).isoformat(timespec="milliseconds")
