"""What of a request is kept in the audit trail, and what must not be."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
from starlette.requests import Request

from mavcal.service.api.security import LONGEST, note
from mavcal.service.errors import StoreError
from mavcal.service.store import SqliteStore


@pytest.fixture
def store():
    made = SqliteStore(None)
    yield made
    made.close()


def request(
    store: SqliteStore, path: str = "/api/v1/links", *, method: str = "POST", body: bytes = b"{}", subject: str = "l1"
) -> Request:
    async def receive() -> dict[str, object]:
        return {"type": "http.request", "body": body, "more_body": False}

    scope = {
        "type": "http",
        "method": method,
        "path": path,
        "query_string": b"",
        "headers": [],
        "app": SimpleNamespace(state=SimpleNamespace(service=SimpleNamespace(store=store))),
        "route": SimpleNamespace(name="open_link"),
        "path_params": {"link_id": subject} if subject else {},
        "request_id": "r7",
    }
    return Request(scope, receive)


async def test_a_request_is_kept_with_its_number_and_body(store):
    await note(request(store, body=b'{"url": "sim:px4"}'), "owner")
    (row,) = store.audit()
    assert (row.actor, row.action, row.subject) == ("owner", "open link", "l1")
    assert row.detail["request_id"] == "r7"
    assert row.detail["body"] == '{"url": "sim:px4"}'
    assert store.check_audit().intact


@pytest.mark.parametrize("path", ["/api/v1/recordings", "/api/v1/signing-keys"])
async def test_neither_files_nor_secrets_are_kept(store, path):
    await note(request(store, path, body=b"5ec7e7" * 100), "owner")
    (row,) = store.audit()
    assert row.detail["request"] == f"POST {path}"
    assert "5ec7e7" not in repr(row)


async def test_what_is_kept_has_an_end(store):
    await note(request(store, "/" + "p" * 5000, body=b"b" * 5000, subject="s" * 5000), "owner")
    (row,) = store.audit()
    assert (row.subject, row.detail["body"]) == ("s" * LONGEST, "b" * LONGEST)
    assert row.detail["request"] == "POST /" + "p" * (LONGEST - 1)


@pytest.mark.parametrize("body", [b"\xff\xfe", b"\xed\xa0\x80"])
async def test_what_is_no_text_is_kept_as_well_as_it_can_be(store, body):
    await note(request(store, body=body, subject="\ud800"), "owner")
    (row,) = store.audit()
    assert row.subject == "?"
    assert set(row.detail["body"]) == {"\ufffd"}


async def test_a_request_without_a_subject_has_none(store):
    await note(request(store, subject=""), "owner")
    assert store.audit()[0].subject == ""


@pytest.mark.parametrize("method", ["POST", "PUT", "PATCH"])
async def test_what_cannot_be_kept_is_not_done(store, monkeypatch, method):
    def refuse(*_: object) -> None:
        raise StoreError("the disk is full")

    monkeypatch.setattr(store, "add_audit", refuse)
    with pytest.raises(StoreError, match="the disk is full"):
        await note(request(store, method=method), "owner")
    await note(request(store, method="DELETE"), "owner")  # a job can be ended on a full disk
