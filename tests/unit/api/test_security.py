from __future__ import annotations

import pytest
from starlette.datastructures import Headers

from service.api.security import Guard, check_exposure, digest
from service.errors import AuthError, Forbidden
from service.settings import ApiKey, Settings

KEY = ApiKey(name="ground", sha256=digest("secret"), scopes=frozenset({"read"}))


def test_listening_beyond_loopback_without_keys_is_refused():
    with pytest.raises(AuthError, match="api_keys"):
        check_exposure(Settings(host="0.0.0.0"))
    check_exposure(Settings(host="0.0.0.0", api_keys=(KEY,)))
    check_exposure(Settings(host="127.0.0.1"))


@pytest.mark.parametrize("host", ["127.0.0.1:8765", "localhost", "[::1]:80"])
def test_loopback_names_are_let_in(host):
    Guard(Settings()).check_origin("POST", Headers({"host": host}))


@pytest.mark.parametrize("host", ["evil.example", "evil.example:8765", "", "[", "127.0.0.1.evil.example"])
def test_a_rebound_name_is_refused(host):
    with pytest.raises(Forbidden):
        Guard(Settings()).check_origin("GET", Headers({"host": host}))


@pytest.mark.parametrize(
    "extra",
    [{"origin": "https://evil.example"}, {"sec-fetch-site": "cross-site"}, {"origin": "null"}],
)
def test_another_sites_page_changes_nothing(extra):
    guard = Guard(Settings())
    with pytest.raises(Forbidden):
        guard.check_origin("POST", Headers({"host": "localhost:8765", **extra}))


def test_our_own_page_may_post():
    headers = Headers({"host": "localhost:8765", "origin": "http://localhost:8765", "sec-fetch-site": "same-origin"})
    Guard(Settings()).check_origin("POST", headers)


def test_a_ticket_works_once_and_not_for_long():
    now = [0.0]
    guard = Guard(Settings(api_keys=(KEY,)), clock=lambda: now[0])
    ticket = guard.ticket(KEY)
    assert guard._redeem(ticket) is KEY
    with pytest.raises(AuthError):
        guard._redeem(ticket)
    late = guard.ticket(KEY)
    now[0] = 31.0
    with pytest.raises(AuthError):
        guard._redeem(late)
