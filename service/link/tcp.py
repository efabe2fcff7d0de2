"""TCP: one connection that we open, or a port that others connect to."""

from __future__ import annotations

import selectors
import socket

from mavcal.service.link.endpoint import Endpoint
from mavcal.service.link.transports import LARGEST, Chunk, Disconnected, Transport, open_error, resolve
from mavcal.service.link.types import Address

CONNECT_S = 3.0
_MAX_UNSENT = 1 << 20
_MAX_CLIENTS = 8


class _Stream:
    """One connected TCP socket with what could not be sent yet."""

    def __init__(self, opened: socket.socket, selector: selectors.BaseSelector) -> None:
        opened.settimeout(0)
        opened.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        opened.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        self._socket = opened
        self._selector = selector
        self._unsent = b""
        peer = opened.getpeername()
        self.peer: Address = (peer[0], peer[1])
        selector.register(opened, selectors.EVENT_READ)

    def receive(self) -> bytes:
        if self._unsent:
            self._flush()
        try:
            data = self._socket.recv(LARGEST)
        except (BlockingIOError, InterruptedError):
            return b""
        except OSError as exc:
            raise Disconnected(f"the connection broke: {exc.strerror}") from exc
        if not data:
            raise Disconnected("the other side closed the connection")
        return data

    def send(self, data: bytes) -> None:
        self._unsent += data
        self._flush()

    def _flush(self) -> None:
        try:
            sent = self._socket.send(self._unsent)
        except (BlockingIOError, InterruptedError):
            sent = 0
        except OSError as exc:
            raise Disconnected(f"the connection broke: {exc.strerror}") from exc
        self._unsent = self._unsent[sent:]
        if len(self._unsent) > _MAX_UNSENT:
            raise Disconnected("the other side takes no data any more")
        events = selectors.EVENT_READ | (selectors.EVENT_WRITE if self._unsent else 0)
        self._selector.modify(self._socket, events)

    def close(self) -> None:
        if self._socket.fileno() >= 0:
            self._selector.unregister(self._socket)
        self._socket.close()


class TcpTransport(Transport):
    """A TCP connection that we open."""

    def __init__(self, endpoint: Endpoint) -> None:
        self._endpoint = endpoint
        self._stream: _Stream | None = None

    def open(self, selector: selectors.BaseSelector) -> None:
        """Connect, for at most :data:`CONNECT_S`."""
        family, address = resolve((self._endpoint.host, self._endpoint.port), socket.SOCK_STREAM, self._endpoint)
        opened = socket.socket(family, socket.SOCK_STREAM)
        opened.settimeout(CONNECT_S)
        try:
            opened.connect(address)
            self._stream = _Stream(opened, selector)
        except OSError as exc:
            opened.close()
            raise open_error(exc, self._endpoint) from exc

    def receive(self) -> list[Chunk]:
        """Read what is there."""
        if self._stream is None:
            return []
        data = self._stream.receive()
        return [Chunk(data, self._stream.peer)] if data else []

    def send(self, data: bytes, peer: Address | None) -> None:
        """Send; what does not fit into the socket now goes later, in order."""
        if self._stream is not None:
            self._stream.send(data)

    def default_peer(self) -> Address | None:
        """The peer that is connected."""
        return self._stream.peer if self._stream else None

    def close(self) -> None:
        """Close the connection."""
        if self._stream is not None:
            self._stream.close()
            self._stream = None


class TcpServerTransport(Transport):
    """A TCP port that others connect to."""

    connected_when_open = False

    def __init__(self, endpoint: Endpoint) -> None:
        self._endpoint = endpoint
        self._listening: socket.socket | None = None
        self._selector: selectors.BaseSelector | None = None
        self._clients: dict[Address, _Stream] = {}

    def open(self, selector: selectors.BaseSelector) -> None:
        """Listen."""
        family, address = resolve((self._endpoint.host, self._endpoint.port), socket.SOCK_STREAM, self._endpoint)
        opened = socket.socket(family, socket.SOCK_STREAM)
        try:
            opened.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            opened.bind(address)
            opened.listen(_MAX_CLIENTS)
        except OSError as exc:
            opened.close()
            raise open_error(exc, self._endpoint) from exc
        opened.settimeout(0)
        self._listening, self._selector = opened, selector
        selector.register(opened, selectors.EVENT_READ)

    @property
    def local_port(self) -> int:
        """The port that is bound."""
        assert self._listening is not None
        return int(self._listening.getsockname()[1])

    def receive(self) -> list[Chunk]:
        """Accept who is waiting; read from everybody; forget who has gone."""
        self._accept()
        chunks = []
        for peer, stream in list(self._clients.items()):
            try:
                data = stream.receive()
            except Disconnected:
                self._clients.pop(peer).close()
                continue
            if data:
                chunks.append(Chunk(data, peer))
        return chunks

    def _accept(self) -> None:
        assert self._listening is not None
        assert self._selector is not None
        try:
            opened, _ = self._listening.accept()
        except OSError:  # nobody is waiting, or has given up meanwhile
            return
        if len(self._clients) >= _MAX_CLIENTS:
            opened.close()
            return
        stream = _Stream(opened, self._selector)
        self._clients[stream.peer] = stream

    def send(self, data: bytes, peer: Address | None) -> None:
        """Send to one client, or to all."""
        for address in [peer] if peer else list(self._clients):
            stream = self._clients.get(address)
            try:
                if stream is not None:
                    stream.send(data)
            except Disconnected:
                self._clients.pop(address).close()

    def close(self) -> None:
        """Close everything."""
        for stream in self._clients.values():
            stream.close()
        self._clients.clear()
        if self._listening is not None:
            self._listening.close()
            self._listening = None
