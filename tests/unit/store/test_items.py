from __future__ import annotations

from collections.abc import Iterator

import pytest

from mavcal.service.errors import StoreError
from mavcal.service.store import SqliteStore, Store
from mavcal.service.store.rows import ItemRow, JobRow


@pytest.fixture
def store() -> Iterator[Store]:
    store = SqliteStore(None)
    for job_id in ("c1", "c2"):
        store.save_job(JobRow(job_id, None, "campaign", "running", 1.0, 1.0, {}))
    yield store
    store.close()


def rows(job_id: str, *outcomes: str) -> list[ItemRow]:
    return [ItemRow(job_id, n, f"v{n}", outcome, {"text": f"{n}"}) for n, outcome in enumerate(outcomes, 1)]


def test_items_come_in_their_order_a_page_at_a_time_and_by_outcome(store: Store) -> None:
    kept = rows("c1", "done", "failed", "waiting", "failed", "done")
    store.add_items(kept[::-1])
    store.add_items(rows("c2", "done"))
    assert store.items("c1") == tuple(kept)
    assert [r.number for r in store.items("c1", limit=2)] == [1, 2]
    assert [r.number for r in store.items("c1", after=2, limit=2)] == [3, 4]
    assert [r.number for r in store.items("c1", outcomes={"failed", "waiting"})] == [2, 3, 4]
    assert [r.number for r in store.items("c1", after=2, outcomes=["failed"])] == [4]
    assert store.items("c1", outcomes=()) == ()
    assert store.items("nobody") == ()


def test_outcomes_are_counted_and_changed(store: Store) -> None:
    store.add_items(rows("c1", "done", "running", "waiting"))
    store.add_items(rows("c2", "waiting"))
    store.save_item(ItemRow("c1", 2, "v2", "failed", {"text": "it was too short"}))
    assert store.items("c1")[1] == ItemRow("c1", 2, "v2", "failed", {"text": "it was too short"})
    assert store.item_counts("c1") == {"done": 1, "failed": 1, "waiting": 1}
    store.change_outcomes("c1", {"waiting", "running"}, "cancelled")
    assert store.item_counts("c1") == {"cancelled": 1, "done": 1, "failed": 1}
    assert store.item_counts("c2") == {"waiting": 1}


def test_items_belong_to_a_job_and_go_with_it(store: Store) -> None:
    with pytest.raises(StoreError, match="FOREIGN KEY"):
        store.add_items(rows("c9", "done"))
    store.add_items(rows("c1", "done"))
    store.add_items(rows("c2", "done"))
    with pytest.raises(StoreError):  # all or none
        store.add_items([ItemRow("c2", 2, "v", "done", {}), ItemRow("c2", 1, "v", "done", {})])
    assert store.item_counts("c2") == {"done": 1}
    store.delete_job("c1")
    assert store.items("c1") == ()
    assert len(store.items("c2")) == 1


def test_a_damaged_body_is_one_bad_item(store: Store) -> None:
    store.add_items(rows("c1", "done", "done"))
    assert isinstance(store, SqliteStore)
    store._db.execute("PRAGMA ignore_check_constraints = ON")
    store._db.execute("UPDATE campaign_items SET body = '{' WHERE number = 1")
    assert [r.body for r in store.items("c1")] == [{}, {"text": "2"}]
