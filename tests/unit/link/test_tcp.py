"""TCP on loopback: what is read, what waits, and what ends a connection."""

from __future__ import annotations

import selectors
import socket
import struct
from collections.abc import Callable, Iterator

import pytest

from mavcal.service.errors import EndpointError, LinkDown, PortBusy
from mavcal.service.link.endpoint import parse_endpoint
from mavcal.service.link.tcp import TcpServerTransport, TcpTransport
from mavcal.service.link.transports import Chunk, Disconnected, Transport
from tests.patience import patience, scaled


@pytest.fixture
def selector() -> Iterator[selectors.BaseSelector]:
    with selectors.DefaultSelector() as made:
        yield made


@pytest.fixture
def listening() -> Iterator[socket.socket]:
    with socket.create_server(("127.0.0.1", 0)) as opened:
        opened.settimeout(scaled(5))
        yield opened


@pytest.fixture
def served(selector: selectors.BaseSelector) -> Iterator[TcpServerTransport]:
    made = TcpServerTransport(parse_endpoint("tcpin:127.0.0.1:0"))
    made.open(selector)
    yield made
    made.close()


@pytest.fixture
def client(served: TcpServerTransport) -> Iterator[Callable[[], socket.socket]]:
    opened: list[socket.socket] = []

    def connect() -> socket.socket:
        made = socket.create_connection(("127.0.0.1", served.local_port), scaled(5))
        opened.append(made)
        return made

    yield connect
    for made in opened:
        made.close()


def connected(selector: selectors.BaseSelector, listening: socket.socket) -> tuple[TcpTransport, socket.socket]:
    transport = TcpTransport(parse_endpoint(f"tcp:127.0.0.1:{listening.getsockname()[1]}"))
    transport.open(selector)
    other, _ = listening.accept()
    return transport, other


def chunks(
    transport: Transport, selector: selectors.BaseSelector, enough: Callable[[list[Chunk]], bool] = bool
) -> list[Chunk]:
    """What a transport receives until it is enough, driven as the reader thread drives it."""
    found: list[Chunk] = []
    limit = patience(5)
    while not enough(found):
        assert not limit.over
        selector.select(0.05)
        found += transport.receive()
    return found


def joined(found: list[Chunk]) -> bytes:
    return b"".join(chunk.data for chunk in found)


def reset(connection: socket.socket) -> None:
    """End a connection as a crash does: without a farewell."""
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    connection.close()


def test_bytes_go_both_ways_and_name_the_peer(selector: selectors.BaseSelector, listening: socket.socket) -> None:
    transport, other = connected(selector, listening)
    with other:
        assert transport.default_peer() == listening.getsockname()
        assert transport.receive() == []  # nothing has come: it does not wait
        other.sendall(b"from there")
        assert chunks(transport, selector) == [Chunk(b"from there", listening.getsockname())]
        transport.send(b"from here", None)
        assert other.recv(100) == b"from here"
        transport.close()
    assert (transport.default_peer(), transport.receive(), len(selector.get_map())) == (None, [], 0)
    transport.send(b"nobody", None)
    transport.close()


@pytest.mark.parametrize(
    ("end", "why"), [(socket.socket.close, "the other side closed the connection"), (reset, "the connection broke")]
)
def test_the_end_of_a_connection_is_told_with_its_reason(
    selector: selectors.BaseSelector, listening: socket.socket, end: Callable[[socket.socket], None], why: str
) -> None:
    transport, other = connected(selector, listening)
    end(other)
    with pytest.raises(Disconnected, match=why):
        chunks(transport, selector)
    transport.close()


def test_what_the_socket_does_not_take_goes_later_and_in_order(
    selector: selectors.BaseSelector, listening: socket.socket
) -> None:
    listening.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    transport, other = connected(selector, listening)
    with other:
        other.settimeout(scaled(5))
        block = bytes(range(256)) * 256
        sent = 0
        while not any(key.events & selectors.EVENT_WRITE for key in selector.get_map().values()):
            transport.send(block, None)
            sent += len(block)
        got = bytearray()
        while len(got) < sent:
            got += other.recv(65536)
            transport.receive()  # the reader calls it because the socket became writable
        assert bytes(got) == block * (sent // len(block))
        assert all(key.events == selectors.EVENT_READ for key in selector.get_map().values())
        transport.close()


def test_a_peer_that_takes_nothing_is_given_up_before_memory_is(
    selector: selectors.BaseSelector, listening: socket.socket
) -> None:
    transport, other = connected(selector, listening)
    with other:
        waits: list[bool] = []

        def fill() -> None:
            while len(waits) < 1 << 10:
                transport.send(bytes(1 << 18), None)
                waits.append(any(key.events & selectors.EVENT_WRITE for key in selector.get_map().values()))

        with pytest.raises(Disconnected, match="takes no data any more"):
            fill()
        assert sum(waits) >= 2  # a short stall is borne
        transport.close()


def test_a_port_that_nobody_listens_on_is_worth_another_try(
    selector: selectors.BaseSelector, listening: socket.socket
) -> None:
    port = listening.getsockname()[1]
    listening.close()
    transport = TcpTransport(parse_endpoint(f"tcp:127.0.0.1:{port}"))
    with pytest.raises(LinkDown, match=rf"tcp:127\.0\.0\.1:{port}: Connection refused.*running there"):
        transport.open(selector)
    assert len(selector.get_map()) == 0


def test_whoever_connects_is_heard_and_answered(
    served: TcpServerTransport, selector: selectors.BaseSelector, client: Callable[[], socket.socket]
) -> None:
    assert not served.connected_when_open
    assert served.default_peer() is None
    one, two = client(), client()
    one.sendall(b"one")
    two.sendall(b"two")
    found = chunks(served, selector, lambda found: len(found) == 2)
    assert {c.peer: c.data for c in found} == {one.getsockname(): b"one", two.getsockname(): b"two"}
    served.send(b"all", None)
    served.send(b"+one", one.getsockname())
    served.send(b"gone", ("127.0.0.1", 1))  # who is not connected gets nothing, and that is no error
    served.close()
    assert [one.recv(100, socket.MSG_WAITALL), two.recv(100, socket.MSG_WAITALL)] == [b"all+one", b"all"]


@pytest.mark.parametrize("end", [socket.socket.close, reset])
def test_a_client_that_goes_leaves_the_others_alone(
    served: TcpServerTransport,
    selector: selectors.BaseSelector,
    client: Callable[[], socket.socket],
    end: Callable[[socket.socket], None],
) -> None:
    one, two = client(), client()
    one.sendall(b"1")
    two.sendall(b"2")
    chunks(served, selector, lambda found: len(found) == 2)
    assert len(selector.get_map()) == 3
    end(one)
    limit = patience(5)
    while len(selector.get_map()) > 2:
        assert not limit.over
        selector.select(0.05)
        assert served.receive() == []
    two.sendall(b"still here")
    assert joined(chunks(served, selector)) == b"still here"


def test_a_broken_client_is_noticed_by_sending_too(
    served: TcpServerTransport, selector: selectors.BaseSelector, client: Callable[[], socket.socket]
) -> None:
    one = client()
    one.sendall(b"1")
    chunks(served, selector)
    reset(one)
    limit = patience(5)
    while len(selector.get_map()) > 1:  # the listening socket stays
        assert not limit.over
        served.send(b"anybody?", None)


def test_the_ninth_client_is_sent_away(
    served: TcpServerTransport, selector: selectors.BaseSelector, client: Callable[[], socket.socket]
) -> None:
    clients = [client() for _ in range(8)]
    for number, one in enumerate(clients):
        one.sendall(bytes([number]))
    assert sorted(joined(chunks(served, selector, lambda found: len(found) == 8))) == list(range(8))
    ninth = client()
    selector.select(scaled(5))
    assert served.receive() == []
    assert ninth.recv(1) == b""
    clients[0].sendall(b"still")
    assert joined(chunks(served, selector)) == b"still"


def test_a_port_in_use_is_refused_with_the_remedy(selector: selectors.BaseSelector, listening: socket.socket) -> None:
    port = listening.getsockname()[1]
    with pytest.raises(PortBusy, match=rf"another program uses port {port}\. Stop it"):
        TcpServerTransport(parse_endpoint(f"tcpin:127.0.0.1:{port}")).open(selector)
    with pytest.raises(EndpointError, match=r"no address 192\.0\.2\.1\. To listen use 0\.0\.0\.0"):
        TcpServerTransport(parse_endpoint("tcpin:192.0.2.1:0")).open(selector)
    assert len(selector.get_map()) == 0


def test_a_closed_server_frees_its_port(selector: selectors.BaseSelector) -> None:
    served = TcpServerTransport(parse_endpoint("tcpin:127.0.0.1:0"))
    served.open(selector)
    port = served.local_port
    selector.unregister(next(iter(selector.get_map().values())).fileobj)
    served.close()
    served.close()
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.1", port), scaled(5))
