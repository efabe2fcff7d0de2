"""What every store promises, on each of them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from mavcal.service.errors import StoreError
from mavcal.service.store import SqliteStore, Store
from mavcal.service.store.rows import JobDocument, JobRow, LinkRow, RecordingRow, SegmentPurpose, SnapshotPurpose

DIGEST = "a" * 64


def row(job_id: str = "j1", *, state: str = "queued", vehicle: str = "v1", at: float = 1.0) -> JobRow:
    return JobRow(job_id, vehicle, "gyro", state, at, at, {"options": {"uncertainty": 0.1}})


def test_job_is_kept_and_replaced(store: Store) -> None:
    store.save_job(row())
    store.save_job(row(state="running"))
    assert store.job("j1") == row(state="running")
    assert store.job("j2") is None


def test_jobs_by_vehicle_and_state(store: Store) -> None:
    store.save_job(row("a", at=2.0))
    store.save_job(row("b", at=1.0, vehicle="v2"))
    store.save_job(row("c", at=3.0, state="review"))
    assert [j.id for j in store.jobs()] == ["b", "a", "c"]
    assert [j.id for j in store.jobs(vehicle_id="v1")] == ["a", "c"]
    assert [j.id for j in store.jobs(states={"review", "failed"})] == ["c"]
    assert store.jobs(states=set()) == ()


def test_a_job_without_a_vehicle_is_of_none(store: Store) -> None:
    none = JobRow("j1", None, "gap", "queued", 1.0, 1.0, {})
    store.save_job(none)
    store.save_job(row("j2"))
    assert store.job("j1") == none
    assert [j.id for j in store.jobs(vehicle_id="v1")] == ["j2"]


def test_a_document_is_kept_replaced_and_forgotten_with_its_job(store: Store) -> None:
    store.save_job(row(), event=("state", {}))
    store.save_job(row("j2"), event=("state", {}))
    for job_id, body in (("j1", b"old"), ("j1", b"\x00new"), ("j2", b"other")):
        store.save_document(job_id, JobDocument("report.html", "text/html", body))
    assert store.document("j1", "report.html") == JobDocument("report.html", "text/html", b"\x00new")
    assert store.document("j1", "report.json") is None
    store.delete_job("j1")
    assert (store.job("j1"), store.document("j1", "report.html"), store.events("j1")) == (None, None, ())
    assert store.document("j2", "report.html") == JobDocument("report.html", "text/html", b"other")
    assert [event.job_id for event in store.events()] == ["j2"]
    store.delete_job("j1")
    with pytest.raises(StoreError):
        store.save_document("j1", JobDocument("report.html", "text/html", b""))


def test_unknown_state_is_refused_by_the_schema(store: Store) -> None:
    with pytest.raises(StoreError, match=r"(?i)check"):
        store.save_job(row(state="dreaming"))
    assert store.job("j1") is None


def test_a_number_that_is_not_finite_is_refused(store: Store) -> None:
    with pytest.raises(ValueError, match="JSON"):
        store.save_job(JobRow("j1", "v", "gyro", "queued", 0.0, 0.0, {"x": float("nan")}))
    assert store.jobs() == ()


def test_numbers_survive_exactly(store: Store) -> None:
    body = {"third": 1 / 3, "denormal": 5e-324, "id": 8_388_609, "float32": 0.10000000149011612}
    store.save_job(JobRow("j1", "v", "gyro", "queued", 0.0, 0.0, body))
    found = store.job("j1")
    assert found is not None
    assert found.body == body


def test_events_have_a_sequence_a_job_and_an_order_over_all(store: Store) -> None:
    store.save_job(row("a"), event=("state", {"state": "queued"}))
    store.save_job(row("b"), event=("state", {"state": "queued"}))
    for i in range(3):
        store.add_event("a", float(i), "progress", {"current": i})
    assert [e.sequence for e in store.events("a")] == [1, 2, 3, 4]
    assert [e.data["current"] for e in store.events("a", after=2)] == [1, 2]
    assert [(e.job_id, e.sequence) for e in store.events(after=1)] == [("b", 1), ("a", 2), ("a", 3), ("a", 4)]
    assert store.last_event_id() == 5
    assert len(store.events(limit=2)) == 2


def test_superseded_events_can_be_dropped_and_numbers_are_not_reused(store: Store) -> None:
    store.save_job(row("a"), event=("state", {}))
    for i in range(5):
        store.add_event("a", 0.0, "progress", {"current": i})
    store.drop_events("a", "progress", keep=1)
    assert [e.sequence for e in store.events("a")] == [1, 6]
    assert store.add_event("a", 0.0, "state", {}).sequence == 7


def test_an_event_of_no_job_is_refused(store: Store) -> None:
    with pytest.raises(StoreError):
        store.add_event("nobody", 0.0, "state", {})


def test_snapshot_and_plan(store: Store) -> None:
    store.save_job(row())
    store.add_snapshot("j1", 1.0, SnapshotPurpose.BEFORE_WRITE, DIGEST, {"A": 1})
    newer = store.add_snapshot("j1", 2.0, SnapshotPurpose.BEFORE_WRITE, DIGEST, {"A": 2})
    assert store.snapshot("j1", SnapshotPurpose.BEFORE_WRITE) == newer
    assert store.snapshot("j1", SnapshotPurpose.COMPOSED_ON) is None
    store.add_plan("j1", DIGEST, 1.0, {"changes": []})
    store.add_plan("j1", DIGEST, 2.0, {"changes": []})
    assert store.plan("j1", DIGEST) == {"changes": []}
    assert store.plan("j1", "b" * 64) is None


def test_segment_is_open_until_it_is_closed(store: Store) -> None:
    store.save_job(row())
    segment = store.open_segment("j1", SegmentPurpose.CAPTURE, Path("x.tlog"), 100)
    assert (segment.end_byte, segment.sha256) == (None, None)
    closed = store.close_segment(segment.id, 200, DIGEST)
    assert store.segments("j1", SegmentPurpose.CAPTURE) == (closed,)
    assert store.segments("j1", SegmentPurpose.AFTER) == ()
    with pytest.raises(StoreError):
        store.close_segment(segment.id, 50, DIGEST)  # ends before it begins
    with pytest.raises(StoreError):
        store.close_segment(999, 200, DIGEST)


def test_signature_time_never_goes_back(store: Store) -> None:
    assert store.signing_timestamp("link/1/1") == 0
    store.save_signing_timestamp("link/1/1", 100)
    store.save_signing_timestamp("link/1/1", 50)
    assert store.signing_timestamp("link/1/1") == 100


def test_idempotency_key_belongs_to_one_request(store: Store) -> None:
    assert store.idempotency_key("k") is None
    store.claim_idempotency_key("k", DIGEST, "j1", 0.0)
    assert store.idempotency_key("k") == (DIGEST, "j1")
    with pytest.raises(StoreError):
        store.claim_idempotency_key("k", DIGEST, "j2", 1.0)


def test_links_recordings_audit(store: Store) -> None:
    store.save_link(LinkRow("l1", "udpin:0.0.0.0:1", 1.0))
    store.save_link(LinkRow("l1", "udpin:0.0.0.0:2", 2.0))
    assert store.links() == (LinkRow("l1", "udpin:0.0.0.0:2", 1.0),)
    store.delete_link("l1")
    store.delete_link("l1")
    assert store.links() == ()
    recording = RecordingRow("r1", 1.0, "a.csv", Path("r/r1"), 3, DIGEST, {})
    store.add_recording(recording)
    assert store.recording("r1") == recording
    assert store.recordings() == (recording,)
    store.add_audit(1.0, "key 7", "apply", "j1", {"plan": DIGEST})
    assert [(a.actor, a.action) for a in store.audit()] == [("key 7", "apply")]


def test_reopened_store_has_everything(open_store: Callable[[], Store]) -> None:
    store = open_store()
    store.save_job(row(), event=("state", {"state": "queued"}))
    store.close()
    again = open_store()
    assert again.job("j1") == row()
    assert len(again.events("j1")) == 1
    again.close()


def test_a_journal_and_an_audit_trail_cannot_be_rewritten(store: Store) -> None:
    store.save_job(row())
    store.add_journal("j1", 1.0, "send", {"name": "A"})
    store.add_audit(1.0, "key 7", "apply", "j1", {})
    for statement in ("UPDATE journal SET step = 'echo'", "UPDATE audit SET actor = 'x'", "DELETE FROM audit"):
        with pytest.raises(StoreError, match="append-only"):
            store._run(statement)
    assert store.journal("j1")[0].step == "send"
    assert store.check_audit().intact


def test_a_failed_write_leaves_nothing_and_the_next_one_works(store: Store) -> None:
    def broken(second: str) -> None:
        with store._write() as db:
            db.execute("INSERT INTO links (id, url, at) VALUES ('l1', 'u', 1.0)")
            db.execute(second)
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        broken("DELETE FROM recordings")
    with pytest.raises(StoreError):
        broken("INSERT INTO nowhere VALUES (1)")
    assert store.links() == ()
    store.save_link(LinkRow("l1", "udpin:0.0.0.0:1", 1.0))
    assert len(store.links()) == 1


def test_old_keys_are_dropped_by_age_and_number(store: Store) -> None:
    for i in range(6):
        store.claim_idempotency_key(f"k{i}", DIGEST, "j1", float(min(i, 4)))  # the last two are of one time
    store.drop_old_keys(1.0, most=100)
    assert [store.idempotency_key(f"k{i}") is not None for i in range(6)] == [False, True, True, True, True, True]
    store.drop_old_keys(0.0, most=1)
    assert [store.idempotency_key(f"k{i}") is not None for i in range(6)] == [False] * 5 + [True]


def test_an_audit_trail_that_lost_its_end_is_noticed(store: Store) -> None:
    for i in range(3):
        store.add_audit(float(i), "key 7", "apply", f"j{i}", {"n": i / 3})
    assert store.check_audit().intact
    with store._write() as db:
        if isinstance(store, SqliteStore):
            db.execute("DROP TRIGGER audit_is_kept")
        else:
            db.execute("DROP TRIGGER audit_is_kept ON audit")
        db.execute("DELETE FROM audit WHERE id = 3")
    assert store.check_audit().broken_at == 3
