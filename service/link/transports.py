"""Transports: ways for bytes to come and go, in the reader thread of one link only.

A transport opens itself, registers its sockets with the thread's selector and hands out what arrived; it never
blocks longer than a connection attempt. Whatever ends it is a :class:`Disconnected` with the reason.
"""

from __future__ import annotations

import errno
import os
import selectors
import socket
from abc import ABC, abstractmethod
from typing import NamedTuple

from mavcal.service.errors import EndpointError, LinkDown, PortBusy
from mavcal.service.link.endpoint import Endpoint
from mavcal.service.link.types import Address

DRAIN = 256
"""Datagrams taken at once before they are handed on."""
LARGEST = 65536
"""Bytes taken by one call."""


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
    """A transport, driven by the reader thread."""

    datagrams = False
    """Whether every chunk is complete, so that no frame continues in the next."""
    lossless = True
    """Whether the other side waits if we do, so that nothing need be dropped here."""
    connected_when_open = True
    """Whether an open transport is connected; if not, the link is up once somebody was heard."""
    ends = False
    """Whether it ends for good, with nothing to reconnect to."""
    answers = True
    """Whether anybody can answer."""

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


def resolve(host_port: tuple[str, int], kind: int, endpoint: Endpoint) -> tuple[int, tuple[str, int]]:
    """Address family and address of a host, IPv4 first. Raises EndpointError if there is no such host."""
    try:
        found = socket.getaddrinfo(*host_port, type=kind)
    except socket.gaierror as exc:
        raise EndpointError(f"{endpoint}: the host {host_port[0]!r} is not known. Check its name.") from exc
    except UnicodeError as exc:
        raise EndpointError(f"{endpoint}: {host_port[0]!r} is not a host name.") from exc
    family, _, _, _, address = min(found, key=lambda entry: entry[0] != socket.AF_INET)
    return family, (str(address[0]), int(address[1]))


def open_error(exc: OSError, endpoint: Endpoint) -> EndpointError | PortBusy | LinkDown:
    """The error for an exception: permanent, or worth another try."""
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
