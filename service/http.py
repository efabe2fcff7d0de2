"""The HTTP server of the service: uvicorn, with a limit for connections that never finish a request.

uvicorn waits forever for the head of a request, and takes one of any size. Here it has a limit of time and one of size.
Only so many connections may be without a complete head at a time; a further one displaces the one that has waited
longest.
"""

from __future__ import annotations

import asyncio
from typing import Any

import uvicorn
from starlette.types import ASGIApp
from uvicorn.protocols.http.httptools_impl import STATUS_LINE, HttpToolsProtocol

from mavcal.service.settings import LimitSettings


class Waiting:
    """The connections of one server that have no whole request head yet, the oldest first."""

    def __init__(self, limits: LimitSettings) -> None:
        self._seconds = limits.head_s
        self._most = limits.heads
        self._timers: dict[asyncio.Transport, asyncio.TimerHandle] = {}

    def begins(self, transport: asyncio.Transport) -> None:
        """Wait for a head on this connection, if that is not so already."""
        if transport in self._timers:
            return
        if len(self._timers) >= self._most:
            self._give_up(next(iter(self._timers)))
        self._timers[transport] = asyncio.get_running_loop().call_later(self._seconds, self._give_up, transport)

    def has(self, transport: asyncio.Transport) -> bool:
        """Whether that connection has no whole head yet."""
        return transport in self._timers

    def ends(self, transport: asyncio.Transport) -> None:
        """Stop waiting for a head: it has arrived, or the connection is closed."""
        timer = self._timers.pop(transport, None)
        if timer is not None:
            timer.cancel()

    def _give_up(self, transport: asyncio.Transport) -> None:
        self.ends(transport)
        transport.abort()


def _protocol(waiting: Waiting, most: int) -> type[HttpToolsProtocol]:
    """The protocol class of connections whose request head has at most `most` bytes."""

    class Protocol(HttpToolsProtocol):
        _head = 0
        """Bytes of the head that were understood."""
        _came = 0
        """Bytes that came while the head was waited for."""

        def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
            super().connection_made(transport)
            waiting.begins(transport)

        def data_received(self, data: bytes) -> None:
            if self.transport.is_closing():
                return
            self._came = self._came + len(data) if waiting.has(self.transport) else 0
            super().data_received(data)
            if waiting.has(self.transport) and self._came > most and not self.transport.is_closing():
                self.send_400_response("")  # a name or a value that does not end
            between = self.cycle is None or self.cycle.response_complete
            if between and not self.transport.is_closing():  # from here on uvicorn's limit for idle connections is off
                waiting.begins(self.transport)

        def on_url(self, url: bytes) -> None:
            self._grows(url)
            super().on_url(url)

        def on_header(self, name: bytes, value: bytes) -> None:
            self._grows(name, value)
            super().on_header(name, value)

        def _grows(self, *parts: bytes) -> None:
            self._head += sum(len(part) for part in parts)
            if self._head > most:
                raise ValueError("the head of the request is too large")  # the parser stops, and uvicorn answers

        def send_400_response(self, msg: str) -> None:
            if max(self._head, self._came) <= most:
                super().send_400_response(msg)
                return
            self.transport.write(
                STATUS_LINE[431] + b"content-length: 0\r\nconnection: close\r\n\r\n",
            )
            self.transport.close()

        def on_headers_complete(self) -> None:
            waiting.ends(self.transport)
            self._head = self._came = 0
            super().on_headers_complete()

        def connection_lost(self, exc: Exception | None) -> None:
            waiting.ends(self.transport)
            super().connection_lost(exc)

    return Protocol


def server_config(app: ASGIApp, limits: LimitSettings, **options: Any) -> uvicorn.Config:
    """How the application is served; `options` are uvicorn's."""
    return uvicorn.Config(
        app,
        http=_protocol(Waiting(limits), limits.head_bytes),
        ws="none",
        log_config=None,
        access_log=False,
        timeout_graceful_shutdown=1,
        **options,
    )
