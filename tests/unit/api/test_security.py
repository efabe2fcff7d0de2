from __future__ import annotations

import pytest
from starlette.datastructures import Headers

from mavcal.service.api.security import FAILURE_EVERY_S, FAILURES_AT_ONCE, MOST_PEERS, RequestGuard, Throttle, digest
from mavcal.service.errors import AuthError, Forbidden
from mavcal.service.settings import ApiKey, Settings, check_exposure
from tests.clock import ManualClock

KEY = ApiKey(name="ground", sha256=digest("secret"), scopes=frozenset({"read"}))


def test_listening_beyond_loopback_without_keys_is_refused():
    with pytest.raises(AuthError, match="api_keys"):
        check_exposure(Settings(host="0.0.0.0"))
    check_exposure(Settings(host="0.0.0.0", api_keys=(KEY,)))
    check_exposure(Settings(host="127.0.0.1"))


@pytest.mark.parametrize("host", ["127.0.0.1:8765", "localhost", "[::1]:80"])
def test_loopback_names_are_let_in(host):
    RequestGuard(Settings()).check_origin("POST", Headers({"host": host}))


@pytest.mark.parametrize("host", ["evil.example", "evil.example:8765", "", "[", "127.0.0.1.evil.example"])
def test_a_rebound_name_is_refused(host):
    with pytest.raises(Forbidden):
        RequestGuard(Settings()).check_origin("GET", Headers({"host": host}))


LOCAL = "localhost:8765"


@pytest.mark.parametrize(
    "extra",
    [
        {"origin": "https://evil.example"},
        {"origin": "null"},
        {"origin": ""},
        {"origin": "http://localhost:8766"},  # another program on this machine
        {"origin": "http://localhost"},
        {"origin": "https://localhost:8765"},
        {"origin": "http://127.0.0.1:8765"},
        {"origin": "http://localhost:8765.evil.example"},
        {"origin": "http://localhost:x"},
        {"sec-fetch-site": "cross-site"},
        {"sec-fetch-site": "same-site"},  # another port of this host is the same site
        {"sec-fetch-site": ""},
        {"sec-fetch-site": "Same-Origin "},
        {"origin": "http://localhost:8765", "sec-fetch-site": "same-site"},
    ],
)
def test_a_page_of_another_origin_changes_nothing(extra):
    guard = RequestGuard(Settings())
    for method in ("POST", "DELETE", "PUT", "PATCH", "TRACE"):
        with pytest.raises(Forbidden):
            guard.check_origin(method, Headers({"host": LOCAL, **extra}))
    guard.check_origin("GET", Headers({"host": LOCAL, **extra}))


@pytest.mark.parametrize(
    ("scheme", "host", "origin"),
    [
        ("http", LOCAL, "http://localhost:8765"),
        ("http", LOCAL, "HTTP://LocalHost:8765"),
        ("http", "127.0.0.1", "http://127.0.0.1:80"),
        ("https", "localhost:443", "https://localhost"),
        ("http", "[::1]:8765", "http://[::1]:8765"),
    ],
)
def test_our_own_page_may_post(scheme, host, origin):
    headers = Headers({"host": host, "origin": origin, "sec-fetch-site": "same-origin"})
    RequestGuard(Settings()).check_origin("POST", headers, scheme)


def test_a_program_that_is_no_browser_may_post():
    RequestGuard(Settings()).check_origin("POST", Headers({"host": LOCAL}))
    RequestGuard(Settings()).check_origin("POST", Headers({"host": LOCAL, "sec-fetch-site": "none"}))


def test_the_origin_of_a_proxy_is_let_in_once_it_is_named():
    headers = Headers({"host": LOCAL, "origin": "https://boat.local", "sec-fetch-site": "same-origin"})
    with pytest.raises(Forbidden, match="allowed_origins"):
        RequestGuard(Settings()).check_origin("POST", headers)
    guard = RequestGuard(Settings(allowed_origins=("https://boat.local",)))
    guard.check_origin("POST", headers)
    with pytest.raises(Forbidden):
        guard.check_origin("POST", Headers({"host": LOCAL, "origin": "http://boat.local"}))


@pytest.mark.parametrize(
    "setting",
    [
        {"allowed_origins": ("boat.local",)},
        {"allowed_origins": ("https://boat.local/path",)},
        {"frame_ancestors": ("'self'; script-src *",)},
        {"frame_ancestors": ("a\nb",)},
    ],
)
def test_what_would_weaken_the_policy_is_no_setting(setting):
    with pytest.raises(ValueError, match="pattern"):
        Settings(**setting)


def test_a_ticket_works_once_and_not_for_long():
    now = [0.0]
    guard = RequestGuard(Settings(api_keys=(KEY,)), clock=lambda: now[0])
    ticket = guard.ticket(KEY)
    assert guard._redeem(ticket) is KEY
    with pytest.raises(AuthError):
        guard._redeem(ticket)
    late = guard.ticket(KEY)
    now[0] = 31.0
    with pytest.raises(AuthError):
        guard._redeem(late)


GUEST = "https://gcs.example"


def test_a_page_of_a_guest_origin_may_ask_from_its_own_site():
    guard = RequestGuard(Settings(cors_origins=(GUEST,)))
    guard.check_origin("POST", Headers({"host": LOCAL, "origin": GUEST, "sec-fetch-site": "cross-site"}))
    for origin in ("https://gcs.example.evil.example", "http://gcs.example", f"{GUEST}:8443", "null"):
        with pytest.raises(Forbidden):
            guard.check_origin("POST", Headers({"host": LOCAL, "origin": origin}))
    with pytest.raises(Forbidden):
        guard.check_origin("POST", Headers({"host": LOCAL, "sec-fetch-site": "cross-site"}))
    with pytest.raises(Forbidden):
        guard.check_origin("POST", Headers({"host": "evil.example", "origin": GUEST}))


@pytest.mark.parametrize(
    "origin", ["*", "null", "https://*.example", f"{GUEST}/", "gcs.example", "https://GCS.example"]
)
def test_a_guest_origin_is_an_exact_one(origin):
    with pytest.raises(ValueError, match="cors_origins"):
        Settings(cors_origins=(origin,))


def test_a_peer_fails_a_few_times_and_then_once_in_a_while():
    clock = ManualClock(1000.0)
    throttle = Throttle(clock)
    for _ in range(FAILURES_AT_ONCE):
        assert throttle.wait_s("10.0.0.1") == 0.0
        throttle.failed("10.0.0.1")
    assert 0.0 < throttle.wait_s("10.0.0.1") <= FAILURE_EVERY_S
    assert throttle.wait_s("10.0.0.2") == 0.0
    clock.advance(FAILURE_EVERY_S)
    assert throttle.wait_s("10.0.0.1") == 0.0
    throttle.failed("10.0.0.1")
    assert throttle.wait_s("10.0.0.1") > 0.0
    clock.advance(FAILURES_AT_ONCE * FAILURE_EVERY_S)
    for _ in range(FAILURES_AT_ONCE):
        assert throttle.wait_s("10.0.0.1") == 0.0
        throttle.failed("10.0.0.1")


def test_hosts_with_a_network_of_addresses_count_as_one():
    throttle = Throttle(ManualClock())
    for i in range(FAILURES_AT_ONCE):
        throttle.failed(f"2001:db8::{i:x}")
    assert throttle.wait_s("2001:db8::ffff") > 0.0
    assert throttle.wait_s("2001:db8:0:1::1") == 0.0


def test_memory_is_bounded_and_an_active_peer_is_not_forgotten():
    throttle = Throttle(ManualClock())
    for i in range(20 * MOST_PEERS):
        throttle.failed(f"10.{i >> 16}.{i >> 8 & 255}.{i & 255}")
        if i % (MOST_PEERS // 2) == 0:
            throttle.failed("192.168.0.1")
    assert len(throttle) == MOST_PEERS
    assert throttle.wait_s("192.168.0.1") > 0.0
