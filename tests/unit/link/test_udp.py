"""UDP on loopback: whose datagrams are taken, where answers go, and what the socket had to drop."""

from __future__ import annotations

import selectors
import socket
import sys
from collections.abc import Iterator

import pytest

from mavcal.service.errors import EndpointError, PortBusy
from mavcal.service.link.endpoint import parse_endpoint
from mavcal.service.link.transports import DRAIN, Chunk, Disconnected
from mavcal.service.link.udp import UdpTransport
from tests.patience import patience, scaled

HERE = ("127.0.0.1", 0)


@pytest.fixture
def selector() -> Iterator[selectors.BaseSelector]:
    with selectors.DefaultSelector() as made:
        yield made


@pytest.fixture
def peer() -> Iterator[socket.socket]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as opened:
        opened.bind(HERE)
        opened.settimeout(scaled(5))
        yield opened


@pytest.fixture
def waiting(selector: selectors.BaseSelector) -> Iterator[UdpTransport]:
    made = UdpTransport(parse_endpoint("udpin:127.0.0.1:0"), HERE, None)
    made.open(selector)
    yield made
    made.close()


def heard(transport: UdpTransport, selector: selectors.BaseSelector, count: int) -> list[Chunk]:
    found: list[Chunk] = []
    limit = patience(5)
    while len(found) < count:
        assert not limit.over
        selector.select(0.05)
        found += transport.receive()
    return found


def test_every_datagram_is_a_chunk_of_its_sender(
    waiting: UdpTransport, selector: selectors.BaseSelector, peer: socket.socket
) -> None:
    assert waiting.receive() == []  # it does not wait
    assert waiting.default_peer() is None
    for data in (b"one", b"", b"two"):
        peer.sendto(data, ("127.0.0.1", waiting.local_port))
    found = heard(waiting, selector, 3)
    assert [(chunk.data, chunk.peer) for chunk in found] == [(d, peer.getsockname()) for d in (b"one", b"", b"two")]


def test_answers_go_to_the_peer_that_is_named_and_to_nobody_else(waiting: UdpTransport, peer: socket.socket) -> None:
    waiting.send(b"to nobody", None)
    waiting.send(b"to the peer", peer.getsockname())
    assert peer.recvfrom(100) == (b"to the peer", ("127.0.0.1", waiting.local_port))


def test_who_speaks_first_has_a_target_and_hears_only_its_host(
    selector: selectors.BaseSelector, peer: socket.socket
) -> None:
    host, port = peer.getsockname()
    transport = UdpTransport(parse_endpoint(f"udpout:{host}:{port}"), ("0.0.0.0", 0), (host, port))
    transport.open(selector)
    try:
        assert transport.default_peer() == (host, port)
        transport.send(b"hello", None)
        data, ours = peer.recvfrom(100)
        assert (data, ours[1]) == (b"hello", transport.local_port)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
            stranger.bind(("127.0.0.2", 0))
            stranger.sendto(b"from elsewhere", ("127.0.0.1", transport.local_port))
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as second:  # another port of the same host is a vehicle
            second.bind(HERE)
            second.sendto(b"second", ("127.0.0.1", transport.local_port))
        peer.sendto(b"first", ("127.0.0.1", transport.local_port))
        assert [chunk.data for chunk in heard(transport, selector, 2)] == [b"second", b"first"]
    finally:
        transport.close()


def test_no_more_than_a_drain_is_taken_at_once(
    waiting: UdpTransport, selector: selectors.BaseSelector, peer: socket.socket
) -> None:
    """Else one busy sender would keep the reader from handing anything on."""
    for number in range(DRAIN + 5):
        peer.sendto(number.to_bytes(2, "big"), ("127.0.0.1", waiting.local_port))
    selector.select(scaled(5))
    first, rest = waiting.receive(), waiting.receive()
    assert (len(first), len(rest)) == (DRAIN, 5)
    assert [int.from_bytes(chunk.data, "big") for chunk in first + rest] == list(range(DRAIN + 5))


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux tells what a socket dropped")
def test_what_the_socket_dropped_is_told_with_the_next_datagram(
    waiting: UdpTransport, selector: selectors.BaseSelector, peer: socket.socket
) -> None:
    assert waiting._socket is not None
    waiting._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1)  # the kernel's least
    sent = 60
    for number in range(sent):
        peer.sendto(bytes([number]) * 500, ("127.0.0.1", waiting.local_port))
    taken = heard(waiting, selector, 1)
    taken += waiting.receive()
    assert len(taken) < sent
    peer.sendto(b"after", ("127.0.0.1", waiting.local_port))
    (after,) = heard(waiting, selector, 1)
    assert after.dropped == sent - len(taken)


def test_a_datagram_that_the_network_refuses_is_lost_and_no_more(waiting: UdpTransport, peer: socket.socket) -> None:
    waiting.send(bytes(70_000), peer.getsockname())  # larger than any datagram
    waiting.send(b"next", peer.getsockname())
    assert peer.recv(100) == b"next"


def test_a_socket_that_fails_ends_the_link(waiting: UdpTransport, peer: socket.socket) -> None:
    assert waiting._socket is not None
    waiting._socket.close()
    with pytest.raises(Disconnected, match="the socket failed: Bad file descriptor"):
        waiting.receive()
    with pytest.raises(Disconnected, match="the socket failed"):
        waiting.send(b"x", peer.getsockname())


def test_a_port_in_use_and_an_address_of_another_machine_are_refused_with_the_remedy(
    selector: selectors.BaseSelector, peer: socket.socket
) -> None:
    port = peer.getsockname()[1]
    taken = UdpTransport(parse_endpoint(f"udpin:127.0.0.1:{port}"), ("127.0.0.1", port), None)
    with pytest.raises(PortBusy, match=rf"another program uses port {port}\. Stop it, or let it forward"):
        taken.open(selector)
    away = UdpTransport(parse_endpoint("udpin:192.0.2.1:14550"), ("192.0.2.1", 14550), None)
    with pytest.raises(EndpointError, match=r"no address 192\.0\.2\.1\. To listen use 0\.0\.0\.0"):
        away.open(selector)
    assert len(selector.get_map()) == 0


def test_a_closed_one_sends_nothing_and_frees_its_port(waiting: UdpTransport, peer: socket.socket) -> None:
    port = waiting.local_port
    waiting.close()
    waiting.close()
    waiting.send(b"late", peer.getsockname())
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as again:
        again.bind(("127.0.0.1", port))
        again.sendto(b"first", peer.getsockname())
    assert peer.recv(100) == b"first"
