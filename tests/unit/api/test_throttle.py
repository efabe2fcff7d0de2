from __future__ import annotations

from mavcal.service.api.throttle import AT_ONCE, EVERY_S, MOST_PEERS, Throttle
from tests.clock import ManualClock


def test_a_peer_fails_a_few_times_and_then_once_in_a_while():
    clock = ManualClock(1000.0)
    throttle = Throttle(clock)
    for _ in range(AT_ONCE):
        assert throttle.wait_s("10.0.0.1") == 0.0
        throttle.failed("10.0.0.1")
    assert 0.0 < throttle.wait_s("10.0.0.1") <= EVERY_S
    assert throttle.wait_s("10.0.0.2") == 0.0
    clock.advance(EVERY_S)
    assert throttle.wait_s("10.0.0.1") == 0.0
    throttle.failed("10.0.0.1")
    assert throttle.wait_s("10.0.0.1") > 0.0
    clock.advance(AT_ONCE * EVERY_S)
    for _ in range(AT_ONCE):
        assert throttle.wait_s("10.0.0.1") == 0.0
        throttle.failed("10.0.0.1")


def test_hosts_with_a_network_of_addresses_count_as_one():
    throttle = Throttle(ManualClock())
    for i in range(AT_ONCE):
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
