"""UDP: datagrams from anybody to one port."""

from __future__ import annotations

import errno
import selectors
import socket
import sys

from mavcal.service.link.endpoint import Endpoint
from mavcal.service.link.transports import DRAIN, LARGEST, Chunk, Disconnected, Transport, open_error, resolve
from mavcal.service.link.types import Address

_RECEIVE_BUFFER = 4 << 20
_SO_RXQ_OVFL = 40  # linux/socket.h: each datagram brings the number dropped before it


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
        family, address = resolve(host, socket.SOCK_DGRAM, self._endpoint)
        opened = socket.socket(family, socket.SOCK_DGRAM)
        try:
            opened.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BUFFER)
            opened.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
            if sys.platform == "linux":
                opened.setsockopt(socket.SOL_SOCKET, _SO_RXQ_OVFL, 1)
            opened.bind(self._bind if self._target else address)
        except OSError as exc:
            opened.close()
            raise open_error(exc, self._endpoint) from exc
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
                data, ancillary, _, address = receive(LARGEST, 64)
            except (BlockingIOError, InterruptedError):
                break
            except OSError as exc:
                raise Disconnected(f"the socket failed: {exc.strerror}") from exc
            if only is None or address[0] == only:
                chunks.append(Chunk(data, address[:2], _dropped(ancillary) if ancillary else 0))
        return chunks

    def send(self, data: bytes, peer: Address | None) -> None:
        """Send one datagram; it is lost if the network does not take it now."""
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
