"""Ways for bytes to come and go. They live in the reader thread of one link and nowhere else.

A transport opens itself, registers its sockets with the thread's selector and hands out what arrived; it never
blocks longer than a connection attempt. Whatever ends it is a :class:`Disconnected` with the reason.
"""

from __future__ import annotations

import errno
import os
import selectors
import socket
import sys
from abc import ABC, abstractmethod
from typing import NamedTuple

from service.errors import EndpointError, LinkDown, PortBusy
from service.link.endpoint import Endpoint
from service.link.types import Address

DRAIN = 256
"""Datagrams taken at once before they are handed on."""
CONNECT_S = 3.0
_RECEIVE_BUFFER = 4 << 20
_LARGEST = 65536
_SO_RXQ_OVFL = 40  # linux/socket.h: each datagram brings the number dropped before it
_MAX_UNSENT = 1 << 20
_MAX_CLIENTS = 8


class Disconnected(Exception):  # noqa: N818 - a message between a transport and its reader, never an error to report
    """The other side has gone; the text says how that was noticed."""


class Chunk(NamedTuple):
    """Bytes of one peer: a whole datagram, or a piece of a stream.

    `dropped` counts the datagrams that the socket had to drop so far, 0 if that is unknown.
    """

    data: bytes
    peer: Address
    dropped: int = 0


class Transport(ABC):
    """What the reader thread drives."""

    datagrams = False
    """True: every chunk stands alone, and its frames never continue in the next."""
    lossless = True
    """True: the other side waits if we do, so that nothing need be dropped here."""
    connected_when_open = True
    """False: being open says nothing; the link is up once somebody was heard."""
    ends = False
    """True: once it is over there is nothing to reconnect to."""
    answers = True
    """False: nobody is there who could answer."""

    @abstractmethod
    def open(self, selector: selectors.BaseSelector) -> None:
        """Open and register. Raises EndpointError, PortBusy (for good) or LinkDown (worth another try)."""

    @abstractmethod
    def receive(self) -> list[Chunk]:
        """Everything that has arrived, at most :data:`DRAIN` chunks. Raises Disconnected."""

    @abstractmethod
    def send(self, data: bytes, peer: Address | None) -> None:
        """Send to one peer, or to all if that is None. Raises Disconnected."""

    @abstractmethod
    def close(self) -> None:
        """Close whatever is open; may be called twice."""

    def wait(self) -> float | None:
        """Seconds until :meth:`receive` is worth a call without any socket being ready, or None."""
        return None

    def default_peer(self) -> Address | None:
        """The peer to send to when nobody was heard, or None if there is none."""
        return None


class UdpTransport(Transport):
    """UDP, waiting on a port (`target` None) or speaking first to one address."""

    datagrams, lossless, connected_when_open = True, False, False

    def __init__(self, endpoint: Endpoint, bind: tuple[str, int], target: tuple[str, int] | None) -> None:
        self._endpoint = endpoint
        self._bind = bind
        self._target = target
        self._peer: Address | None = None
        self._socket: socket.socket | None = None

    def open(self, selector: selectors.BaseSelector) -> None:
        """Bind; resolve the target."""
        host = self._target or self._bind
        family, address = _resolve(host, socket.SOCK_DGRAM, self._endpoint)
        opened = socket.socket(family, socket.SOCK_DGRAM)
        try:
            opened.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BUFFER)
            opened.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
            if sys.platform == "linux":
                opened.setsockopt(socket.SOL_SOCKET, _SO_RXQ_OVFL, 1)
            opened.bind(self._bind if self._target else address)
        except OSError as exc:
            opened.close()
            raise _open_error(exc, self._endpoint) from exc
        opened.settimeout(0)
        if self._target:
            self._peer = address
        self._socket = opened
        selector.register(opened, selectors.EVENT_READ)

    @property
    def local_port(self) -> int:
        """The port that is bound."""
        assert self._socket is not None
        return int(self._socket.getsockname()[1])

    def receive(self) -> list[Chunk]:
        """Take datagrams until there are none."""
        assert self._socket is not None
        chunks: list[Chunk] = []
        only = self._peer[0] if self._peer else None
        receive = self._socket.recvmsg
        for _ in range(DRAIN):
            try:
                data, ancillary, _, address = receive(_LARGEST, 64)
            except (BlockingIOError, InterruptedError):
                break
            except OSError as exc:
                raise Disconnected(f"the socket failed: {exc.strerror}") from exc
            if only is None or address[0] == only:
                chunks.append(Chunk(data, address[:2], _dropped(ancillary) if ancillary else 0))
        return chunks

    def send(self, data: bytes, peer: Address | None) -> None:
        """Send one datagram; one that the network does not take now is lost, as datagrams are."""
        target = peer or self._peer
        if self._socket is None or target is None:
            return
        try:
            self._socket.sendto(data, target)
        except OSError as exc:
            if exc.errno in (errno.EBADF, errno.ENOTSOCK):
                raise Disconnected(f"the socket failed: {exc.strerror}") from exc

    def default_peer(self) -> Address | None:
        """The configured target."""
        return self._peer

    def close(self) -> None:
        """Close the socket."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None


def _dropped(ancillary: list[tuple[int, int, bytes]]) -> int:
    for level, kind, data in ancillary:
        if level == socket.SOL_SOCKET and kind == _SO_RXQ_OVFL:
            return int.from_bytes(data[:4], sys.byteorder)
    return 0


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
            data = self._socket.recv(_LARGEST)
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
        family, address = _resolve((self._endpoint.host, self._endpoint.port), socket.SOCK_STREAM, self._endpoint)
        opened = socket.socket(family, socket.SOCK_STREAM)
        opened.settimeout(CONNECT_S)
        try:
            opened.connect(address)
            self._stream = _Stream(opened, selector)
        except OSError as exc:
            opened.close()
            raise _open_error(exc, self._endpoint) from exc

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
        """The one that is connected."""
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
        family, address = _resolve((self._endpoint.host, self._endpoint.port), socket.SOCK_STREAM, self._endpoint)
        opened = socket.socket(family, socket.SOCK_STREAM)
        try:
            opened.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            opened.bind(address)
            opened.listen(_MAX_CLIENTS)
        except OSError as exc:
            opened.close()
            raise _open_error(exc, self._endpoint) from exc
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


def _resolve(host_port: tuple[str, int], kind: int, endpoint: Endpoint) -> tuple[int, tuple[str, int]]:
    try:
        found = socket.getaddrinfo(*host_port, type=kind)
    except socket.gaierror as exc:
        raise EndpointError(f"{endpoint}: the host {host_port[0]!r} is not known. Check its name.") from exc
    except UnicodeError as exc:
        raise EndpointError(f"{endpoint}: {host_port[0]!r} is not a host name.") from exc
    family, _, _, _, address = min(found, key=lambda entry: entry[0] != socket.AF_INET)
    return family, (str(address[0]), int(address[1]))


def _open_error(exc: OSError, endpoint: Endpoint) -> EndpointError | PortBusy | LinkDown:
    """Tell what is wrong for good from what is worth another try."""
    if exc.errno == errno.EADDRINUSE:
        return PortBusy(
            f"{endpoint}: another program uses port {endpoint.port}. "
            "Stop it, or let it forward to another port and connect to that one."
        )
    if exc.errno == errno.EADDRNOTAVAIL:
        return EndpointError(f"{endpoint}: this machine has no address {endpoint.host}. To listen use 0.0.0.0.")
    if exc.errno in (errno.EACCES, errno.EPERM):
        return EndpointError(f"{endpoint}: not allowed. Use a port above 1023, or give this user the right.")
    reason = os.strerror(exc.errno) if exc.errno else str(exc) or "timed out"
    return LinkDown(f"{endpoint}: {reason}. Is the vehicle, or its simulator, running there?")
