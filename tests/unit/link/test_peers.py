from __future__ import annotations

import pytest

from mavcal.service.link.peers import PeerTable
from mavcal.service.link.types import LinkEventKind, OwnIdentity

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


def test_an_address_is_recent_until_thirty_seconds_after_its_last_word() -> None:
    peers = table()
    peers.see(1, 1, A, 0.0)
    peers.see(2, 1, B, 1.0)
    peers.see(1, 1, A, 10.0)
    assert peers.recent(30.9) == (B, A)  # the one heard last comes last
    assert peers.recent(31.0) == (A,)
    assert peers.recent(39.9) == (A,)
    assert peers.recent(40.0) == ()
    assert peers.address(1, 1) == A  # an answer still goes where it was heard


def test_a_component_that_was_never_heard_shares_the_newest_way_of_its_system() -> None:
    peers = table()
    peers.see(7, 1, A, 0.0)
    peers.see(7, 154, B, 1.0)
    peers.see(8, 1, C, 2.0)
    assert peers.address(7, 200) == B
    assert peers.snapshot() == {(7, 1): A, (7, 154): B, (8, 1): C}


def test_what_is_told_names_who_and_where() -> None:
    peers = table()
    peers.see(3, 9, A, 0.0)
    moved = peers.see(3, 9, ("/dev/ttyACM0", 0), 10.0)
    assert moved is not None
    assert moved.text == "Vehicle 3/9 now speaks from /dev/ttyACM0; before it was 10.0.0.1:14550."
    twice = peers.see(3, 9, A, 11.0)
    assert twice is not None
    assert twice.addresses == (("/dev/ttyACM0", 0), A)
    assert twice.text.startswith("Two senders use system id 3: /dev/ttyACM0 and 10.0.0.1:14550 take turns.")
    assert twice.text.endswith("Give every vehicle its own system id; nothing is written until then.")
    own = PeerTable(OwnIdentity(system=77, component=191)).own_ids(A, 0.0)
    assert own is not None
    assert (own.kind, own.addresses) == (LinkEventKind.OWN_IDS_HEARD, (A,))
    assert "Somebody at 10.0.0.1:14550 speaks with our ids 77/191." in own.text


def test_components_of_one_vehicle_at_different_places_are_no_second_vehicle() -> None:
    """A companion computer and an autopilot share a system id by design."""
    peers = table()
    assert [peers.see(1, c, x, 0.1 * n) for n, (c, x) in enumerate([(1, A), (191, B)] * 10)] == [None] * 20


@pytest.mark.parametrize(("pause", "kind"), [(4.9, LinkEventKind.DUPLICATE_SYSTEM), (5.0, LinkEventKind.PEER_CHANGED)])
def test_a_return_within_five_seconds_is_a_second_vehicle(pause: float, kind: LinkEventKind) -> None:
    peers = table()
    peers.see(1, 1, A, 0.0)
    peers.see(1, 1, B, 100.0)  # A was left at 100 s
    event = peers.see(1, 1, A, 100.0 + pause)
    assert event is not None
    assert event.kind is kind
