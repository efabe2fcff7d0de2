"""Who a request is from, and what a key lets it do."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
from starlette.requests import Request

from mavcal.service.api.security import (
    COOKIE,
    FAILURE_EVERY_S,
    FAILURES_AT_ONCE,
    TICKET_S,
    RequestGuard,
    Scope,
    digest,
    require,
)
from mavcal.service.errors import AuthError, Forbidden, TooManyAttempts
from mavcal.service.settings import ApiKey, Settings
from mavcal.service.store import SqliteStore
from tests.clock import ManualClock

READER = ApiKey(name="tower", sha256=digest("read me"), scopes=frozenset({"read"}))
WORKER = ApiKey(name="bench", sha256=digest("work"), scopes=frozenset({"read", "operate"}))
ADMIN = ApiKey(name="owner", sha256=digest("all"), scopes=frozenset({"admin"}))
KEYS = (READER, WORKER, ADMIN)


class Desk:
    """A guard with its clock, and requests to it."""

    def __init__(self, *keys: ApiKey) -> None:
        self.clock = ManualClock(100.0)
        self.guard = RequestGuard(Settings(api_keys=keys), clock=self.clock)
        self.store = SqliteStore(None)

    def request(
        self, method: str = "GET", *, query: str = "", peer: str | None = "10.0.0.1", body: bytes = b"", **headers: str
    ) -> Request:
        async def receive() -> dict[str, object]:
            return {"type": "http.request", "body": body, "more_body": False}

        app = SimpleNamespace(state=SimpleNamespace(guard=self.guard, service=SimpleNamespace(store=self.store)))
        scope = {
            "type": "http",
            "method": method,
            "path": "/api/v1/links/l1",
            "query_string": query.encode(),
            "headers": [(name.encode(), value.encode()) for name, value in headers.items()],
            "client": None if peer is None else (peer, 50_000),
            "app": app,
            "route": SimpleNamespace(name="close_link", operation_id="closeLink"),
            "path_params": {"link_id": "l1"},
        }
        return Request(scope, receive)

    def given(self, key: str, **how: str) -> ApiKey | None:
        return self.guard.authenticate(self.request(authorization=f"Bearer {key}", **how))


@pytest.fixture
def desk():
    made = Desk(*KEYS)
    yield made
    made.store.close()


def test_without_keys_everybody_is_let_in_and_nobody_is_named():
    desk = Desk()
    assert desk.guard.open
    assert desk.guard.authenticate(desk.request()) is None
    assert desk.given("whatever") is None
    desk.store.close()


@pytest.mark.parametrize(("key", "owner"), [("read me", READER), ("work", WORKER), ("all", ADMIN)])
def test_a_key_is_known_from_the_header_and_from_the_cookie(desk, key, owner):
    assert not desk.guard.open
    assert desk.given(key) is owner
    assert desk.guard.authenticate(desk.request(authorization=f"bearer {key}")) is owner
    assert desk.guard.authenticate(desk.request(cookie=f'other=1; {COOKIE}="{key}"')) is owner


@pytest.mark.parametrize("headers", [{}, {"authorization": "Bearer "}, {"authorization": "Basic d29yaw=="}])
def test_no_key_at_all_is_told_how_to_send_one_and_is_no_failed_try(desk, headers):
    for _ in range(2 * FAILURES_AT_ONCE):
        with pytest.raises(AuthError, match="an API key is needed: send it as `Authorization: Bearer"):
            desk.guard.authenticate(desk.request(**headers))
    assert desk.given("work") is WORKER


@pytest.mark.parametrize("key", ["wor", "work ", "WORK", WORKER.sha256, "ключ"])
def test_only_the_key_itself_is_the_key(desk, key):
    with pytest.raises(AuthError, match="not known"):
        desk.guard._owner(key)


def test_a_header_is_believed_before_a_cookie(desk):
    """A page that names its key is not served under an old one."""
    request = desk.request(authorization="Bearer read me", cookie=f"{COOKIE}=work")
    assert desk.guard.authenticate(request) is READER


def test_too_many_wrong_keys_of_one_peer_have_to_wait_and_those_of_another_do_not(desk):
    for _ in range(FAILURES_AT_ONCE):
        with pytest.raises(AuthError) as refused:
            desk.given("wrong")
        assert not isinstance(refused.value, TooManyAttempts)
    with pytest.raises(TooManyAttempts, match=r"from 10\.0\.0\.1: wait 6 s, then") as throttled:
        desk.given("work")  # even a right one: else guesses could go on
    assert throttled.value.wait_s == pytest.approx(FAILURE_EVERY_S)
    assert desk.given("work", peer="10.0.0.2") is WORKER
    desk.clock.advance(FAILURE_EVERY_S / 2)
    with pytest.raises(TooManyAttempts, match="wait 3 s"):
        desk.given("work")
    desk.clock.advance(FAILURE_EVERY_S / 2)
    assert desk.given("work") is WORKER


def test_peers_without_an_address_count_as_one(desk):
    for _ in range(FAILURES_AT_ONCE):
        with pytest.raises(AuthError):
            desk.given("wrong", peer=None)
    with pytest.raises(TooManyAttempts, match="from unknown"):
        desk.given("work", peer=None)


def test_a_request_is_looked_at_once(desk):
    """A ticket is good once, while several parts of a request ask who sent it."""
    ticket = desk.guard.ticket(READER)
    request = desk.request(query=f"ticket={ticket}")
    assert desk.guard.authenticate(request) is READER
    assert desk.guard.authenticate(request) is READER
    with pytest.raises(AuthError, match="used or older than 30 s"):
        desk.guard.authenticate(desk.request(query=f"ticket={ticket}"))


def test_a_ticket_opens_streams_and_changes_nothing(desk):
    ticket = desk.guard.ticket(ADMIN)
    with pytest.raises(AuthError, match="an API key is needed"):
        desk.guard.authenticate(desk.request("POST", query=f"ticket={ticket}"))
    assert desk.guard.authenticate(desk.request("GET", query=f"ticket={ticket}")) is ADMIN


def test_a_ticket_is_good_up_to_its_last_second(desk):
    early, late = desk.guard.ticket(READER), desk.guard.ticket(READER)
    desk.clock.advance(TICKET_S)
    assert desk.guard.authenticate(desk.request(query=f"ticket={early}")) is READER
    desk.clock.advance(0.01)
    with pytest.raises(AuthError):
        desk.guard.authenticate(desk.request(query=f"ticket={late}"))


def test_guessed_tickets_are_throttled_like_keys(desk):
    for n in range(FAILURES_AT_ONCE):
        with pytest.raises(AuthError):
            desk.guard.authenticate(desk.request(query=f"ticket=guess{n}"))
    with pytest.raises(TooManyAttempts):
        desk.guard.authenticate(desk.request(query=f"ticket={desk.guard.ticket(READER)}"))


def test_tickets_that_nobody_redeemed_are_forgotten(desk):
    for _ in range(50):
        desk.guard.ticket(READER)
        desk.clock.advance(TICKET_S / 2)
    assert len(desk.guard._tickets) <= 3


@pytest.mark.parametrize(
    ("key", "scope", "allowed"),
    [
        ("read me", Scope.READ, True),
        ("read me", Scope.OPERATE, False),
        ("read me", Scope.WRITE_PARAMS, False),
        ("work", Scope.OPERATE, True),
        ("work", Scope.WRITE_PARAMS, False),
        ("work", Scope.ADMIN, False),
        ("all", Scope.READ, True),  # an administrator may do everything
        ("all", Scope.WRITE_PARAMS, True),
        ("all", Scope.ADMIN, True),
    ],
)
async def test_a_key_may_do_what_its_scopes_say(desk, key, scope, allowed):
    request = desk.request(authorization=f"Bearer {key}")
    if allowed:
        await require(scope)(request)
    else:
        with pytest.raises(Forbidden, match=f"lacks the scope {scope.value!r}"):
            await require(scope)(request)


@pytest.mark.parametrize(
    ("method", "scope", "noted", "kept"),
    [
        ("POST", Scope.OPERATE, True, True),
        ("DELETE", Scope.ADMIN, True, True),
        ("POST", Scope.OPERATE, False, False),  # of a simulation
        ("GET", Scope.ADMIN, True, False),  # changes nothing
        ("POST", Scope.WRITE_PARAMS, True, False),  # the job engine notes it, whoever asks
        ("POST", Scope.READ, True, False),
    ],
)
async def test_what_asks_for_a_change_is_in_the_audit_trail_with_who_asked(desk, method, scope, noted, kept):
    request = desk.request(method, query="force=1", body=b'{"x": 1}', authorization="Bearer all")
    await require(scope, noted=noted)(request)
    rows = desk.store.audit()
    assert len(rows) == kept
    if kept:
        (row,) = rows
        assert (row.actor, row.action, row.subject) == ("owner", "close link", "l1")
        assert row.detail["request"] == f"{method} /api/v1/links/l1"
        assert (row.detail["query"], row.detail["body"]) == ({"force": "1"}, '{"x": 1}')


async def test_what_is_refused_is_not_in_the_audit_trail(desk):
    with pytest.raises(Forbidden):
        await require(Scope.ADMIN)(desk.request("POST", authorization="Bearer work"))
    assert desk.store.audit() == ()
