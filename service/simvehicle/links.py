"""Ports of the simulated vehicle: UDP in both directions, a TCP server for one client at a time, a pseudo-terminal.

Every link is non-blocking and polled; what cannot be sent now is dropped, as a flight controller's port does.
"""

from __future__ import annotations

import os
import socket
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import suppress

from mavcal.service.simvehicle.errors import ConfigurationError
from mavcal.service.simvehicle.wire import Received, Splitter, split_datagram

DATAGRAM = 65535
BURST = 256  # datagrams read in one poll
TCP_BACKLOG = 8
MAX_UNSENT = 1 << 20  # bytes that wait for a slow TCP client before frames are dropped

Address = tuple[str, int]


def parse_address(text: str) -> Address:
    """HOST:PORT. Raises ConfigurationError otherwise."""
    host, _, port = text.rpartition(":")
    if not host or not port.isdigit() or int(port) > 65535:
        raise ConfigurationError(f"address {text!r} must be HOST:PORT")
    return host, int(port)


def bound_socket(kind: socket.SocketKind, address: Address) -> socket.socket:
    """A non-blocking bound socket. Raises ConfigurationError if the port is taken or the host unknown."""
    sock = socket.socket(socket.AF_INET, kind)
    try:
        if kind is socket.SOCK_STREAM:
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        else:
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
        sock.bind(address)
    except OSError as error:
        sock.close()
        raise ConfigurationError(f"cannot listen on {address[0]}:{address[1]}: {error.strerror or error}") from error
    sock.setblocking(False)  # noqa: FBT003
    return sock


class SimEndpoint(ABC):
    """One transport: `url` is what a ground station connects to."""

    url: str

    @abstractmethod
    def sockets(self) -> list[socket.socket | int]:
        """Sockets on which to wait for frames."""

    @abstractmethod
    def poll(self) -> Iterator[bytes]:
        """Everything that has arrived, without waiting: a datagram, or a piece of a stream."""

    @abstractmethod
    def messages(self, data: bytes) -> Iterator[Received]:
        """The intact messages in what `poll` gave."""

    @abstractmethod
    def send(self, frame: bytes) -> None:
        """Send one frame to the present peer, if there is one."""

    @abstractmethod
    def close(self) -> None:
        """Release the sockets."""

    def vehicle_rebooted(self) -> None:  # noqa: B027 - most links do not notice
        """The vehicle restarts: TCP drops its client."""

    def disconnect(self) -> None:  # noqa: B027 - only a stream can be cut
        """End the connection of whoever is connected; it may connect again."""

    def move(self) -> None:  # noqa: B027 - only a sender has an address of its own
        """Go on from another local address, as a peer behind a new network does."""


class UdpEndpoint(SimEndpoint):
    """Common part of both directions of UDP."""

    _socket: socket.socket

    def sockets(self) -> list[socket.socket | int]:
        """See SimEndpoint."""
        return [self._socket]

    def messages(self, data: bytes) -> Iterator[Received]:
        """See SimEndpoint."""
        return iter(split_datagram(data))

    def close(self) -> None:
        """See SimEndpoint."""
        self._socket.close()


class UdpOut(UdpEndpoint):
    """Sends to a fixed ground station from a port of its own."""

    def __init__(self, target: str) -> None:
        self._target = parse_address(target)
        self._socket = bound_socket(socket.SOCK_DGRAM, ("0.0.0.0", 0))  # noqa: S104 - answers come from any route
        self.url = f"udpin:{target}"

    def poll(self) -> Iterator[bytes]:
        """See SimEndpoint."""
        for data, _ in _datagrams(self._socket):
            yield data

    def send(self, frame: bytes) -> None:
        """See SimEndpoint."""
        _send_datagram(self._socket, frame, self._target)

    def move(self) -> None:
        """See SimEndpoint."""
        self._socket.close()
        self._socket = bound_socket(socket.SOCK_DGRAM, ("0.0.0.0", 0))  # noqa: S104


class UdpIn(UdpEndpoint):
    """Listens, and answers the ground station that spoke: the first one for ever (PX4), or the latest (ArduPilot)."""

    def __init__(self, address: str, *, first_for_ever: bool) -> None:
        self._socket = bound_socket(socket.SOCK_DGRAM, parse_address(address))
        host, port = self._socket.getsockname()
        self.url = f"udpout:{host}:{port}"
        self._first_for_ever = first_for_ever
        self._peer: Address | None = None

    def poll(self) -> Iterator[bytes]:
        """See SimEndpoint."""
        for data, sender in _datagrams(self._socket):
            if self._peer is None or not self._first_for_ever:
                self._peer = sender
            yield data

    def send(self, frame: bytes) -> None:
        """See SimEndpoint."""
        if self._peer is not None:
            _send_datagram(self._socket, frame, self._peer)


class TcpServer(SimEndpoint):
    """Serves one client at a time: others connect and get nothing until it leaves."""

    def __init__(self, address: str) -> None:
        self._listener = bound_socket(socket.SOCK_STREAM, parse_address(address))
        self._listener.listen(TCP_BACKLOG)
        self._address: Address = self._listener.getsockname()
        self.url = f"tcp:{self._address[0]}:{self._address[1]}"
        self._client: socket.socket | None = None
        self._unsent = bytearray()
        self._splitter = Splitter()

    def sockets(self) -> list[socket.socket | int]:
        """See SimEndpoint."""
        return [self._listener if self._client is None else self._client]

    def poll(self) -> Iterator[bytes]:
        """See SimEndpoint."""
        if self._client is None:
            self._accept()
        client = self._client
        if client is None:
            return
        try:
            data = client.recv(DATAGRAM)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if data:
            yield data
        else:
            self._drop()

    def _accept(self) -> None:
        try:
            self._client, _ = self._listener.accept()
        except (BlockingIOError, OSError):
            return
        self._client.setblocking(False)  # noqa: FBT003
        self._client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._splitter = Splitter()

    def messages(self, data: bytes) -> Iterator[Received]:
        """See SimEndpoint."""
        return self._splitter.feed(data)

    def send(self, frame: bytes) -> None:
        """See SimEndpoint."""
        if self._client is None or len(self._unsent) > MAX_UNSENT:
            return
        self._unsent += frame
        try:
            sent = self._client.send(self._unsent)
        except BlockingIOError:
            return
        except OSError:
            self._drop()
            return
        del self._unsent[:sent]

    def disconnect(self) -> None:
        """See SimEndpoint."""
        self._drop()

    def _drop(self) -> None:
        if self._client is not None:
            self._client.close()
        self._client = None
        self._unsent.clear()

    def vehicle_rebooted(self) -> None:
        """See SimEndpoint."""
        self._drop()

    def close(self) -> None:
        """See SimEndpoint."""
        self._drop()
        self._listener.close()


class SerialPort(SimEndpoint):
    """The far end of a serial line: a pseudo-terminal whose other end a ground station opens as a device."""

    def __init__(self) -> None:
        import tty

        self._ours, self._theirs = os.openpty()  # held open: without a reader our end would report an error
        tty.setraw(self._theirs)
        os.set_blocking(self._ours, False)
        self.url = f"serial:{os.ttyname(self._theirs)}:921600"
        self._splitter = Splitter()

    def sockets(self) -> list[socket.socket | int]:
        """See SimEndpoint."""
        return [self._ours]

    def poll(self) -> Iterator[bytes]:
        """See SimEndpoint."""
        with suppress(OSError):
            yield os.read(self._ours, DATAGRAM)

    def messages(self, data: bytes) -> Iterator[Received]:
        """See SimEndpoint."""
        return self._splitter.feed(data)

    def send(self, frame: bytes) -> None:
        """See SimEndpoint."""
        with suppress(OSError):  # nobody reads, and the line is full
            os.write(self._ours, frame)

    def close(self) -> None:
        """See SimEndpoint."""
        os.close(self._ours)
        os.close(self._theirs)


def _datagrams(sock: socket.socket) -> Iterator[tuple[bytes, Address]]:
    for _ in range(BURST):
        try:
            data, sender = sock.recvfrom(DATAGRAM)
        except (BlockingIOError, OSError):
            # On some systems a datagram refused earlier is reported here: it says nothing about the next one.
            return
        yield data, sender


def _send_datagram(sock: socket.socket, frame: bytes, target: Address) -> None:
    try:
        sock.sendto(frame, target)
    except OSError:
        # Nobody listens, or the buffer is full: the datagram is lost.
        return
