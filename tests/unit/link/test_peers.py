from __future__ import annotations

from mavcal.service.link import LinkEventKind, OwnIdentity
from mavcal.service.link.peers import PeerTable

A, B, C = ("10.0.0.1", 14550), ("10.0.0.2", 14550), ("10.0.0.3", 14550)


def table() -> PeerTable:
    return PeerTable(OwnIdentity())


def test_answers_go_where_a_component_was_last_heard() -> None:
    peers = table()
    assert peers.address(1, 1) is None
    peers.see(1, 1, A, 0.0)
    peers.see(2, 1, B, 0.0)
    assert (peers.address(1, 1), peers.address(2, 1)) == (A, B)
    peers.see(1, 1, C, 10.0)
    assert peers.address(1, 1) == C
    assert peers.address(1, 154) == C  # a component never heard shares the way of its system
    assert peers.address(3, 1) is None


def test_a_move_is_told_once_with_both_addresses() -> None:
    peers = table()
    assert peers.see(1, 1, A, 0.0) is None
    event = peers.see(1, 1, B, 1.0)
    assert event is not None
    assert (event.kind, event.addresses) == (LinkEventKind.PEER_CHANGED, (A, B))
    assert peers.see(1, 1, B, 2.0) is None


def test_two_addresses_that_take_turns_are_two_vehicles_and_told_every_few_seconds() -> None:
    peers = table()
    peers.see(1, 1, A, 0.0)
    kinds = []
    for k in range(1, 121):
        event = peers.see(1, 1, (A, B)[k % 2], k * 0.1)
        kinds += [event.kind] if event else []
    assert kinds[:2] == [LinkEventKind.PEER_CHANGED, LinkEventKind.DUPLICATE_SYSTEM]
    assert 2 <= kinds.count(LinkEventKind.DUPLICATE_SYSTEM) <= 4
    assert len(kinds) < 6


def test_a_move_there_and_back_after_a_while_is_no_second_vehicle() -> None:
    peers = table()
    kinds = [e.kind for e in (peers.see(1, 1, x, t) for x, t in ((A, 0.0), (B, 60.0), (A, 120.0))) if e]
    assert kinds == [LinkEventKind.PEER_CHANGED] * 2


def test_broadcasts_go_to_who_was_heard_lately() -> None:
    peers = table()
    peers.see(1, 1, A, 0.0)
    peers.see(2, 1, B, 25.0)
    assert set(peers.recent(26.0)) == {A, B}
    assert peers.recent(31.0) == (B,)


def test_a_crowd_of_addresses_does_not_grow_without_end() -> None:
    peers = table()
    for k in range(5000):
        peers.see(1, 1, ("10.0.0.9", k), k * 0.1)
        peers.see(k % 250 + 1, k % 7, ("10.0.1.9", k), k * 0.1)
    assert len(peers.recent(500.0)) <= 700


def test_our_own_ids_are_told_at_most_every_few_seconds() -> None:
    peers = table()
    events = [peers.own_ids(A, 0.1 * k) for k in range(60)]
    assert sum(event is not None for event in events) == 2


def test_addresses_are_bounded_and_the_newest_are_kept() -> None:
    peers = table()
    for i in range(5000):
        peers.see(1 + i % 200, 1, (f"10.0.{i >> 8}.{i & 255}", 14550), i * 1e-3)
    kept = peers.recent(5.0)
    assert len(kept) == 64
    assert kept[-1] == (f"10.0.{4999 >> 8}.{4999 & 255}", 14550)
