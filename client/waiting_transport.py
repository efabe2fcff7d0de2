"""How a service is asked: one request at a time, and streams that go on where they broke."""

# Written by scripts/generate-client from client/transport.py. Do not edit.

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator
from types import TracebackType, UnionType
from typing import Any, Self, TypeVar

import httpx

from mavcal.client.errors import Unreachable
from mavcal.client.exchange import (
    AGAIN_S,
    LIMITS,
    Query,
    options,
    problem_of,
    read_answer,
    read_message,
    request_of,
    stream_of,
    unreachable,
)
from mavcal.client.sse import EventParser

T = TypeVar("T")


class Transport:
    """Asks the service at `url`, such as ``http://127.0.0.1:8765`` or with the path prefix of a proxy.

    Parameters
    ----------
    url
        The root of the service.
    key
        An API key; None: the service runs without keys.
    timeout_s
        How long an answer may take.
    patience_s
        How long a stream that broke is asked for again before it counts as lost.
    transport
        In place of a connection over the network (tests).
    """

    def __init__(
        self,
        url: str,
        *,
        key: str | None = None,
        timeout_s: float = 30.0,
        patience_s: float = 30.0,
        transport: httpx.BaseTransport | None = None,
    ) -> None:
        over = transport or httpx.HTTPTransport(limits=LIMITS, trust_env=False)
        self._http = httpx.Client(base_url=url, transport=over, **options(key, timeout_s))
        self._patience_s = patience_s

    def __enter__(self) -> Self:
        """The client, closed at the end of the block."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close it."""
        self.close()

    def close(self) -> None:
        """Close every connection."""
        self._http.close()

    def wait_ready(self, timeout_s: float = 20.0) -> None:
        """Wait until the service answers. Raises Unreachable."""
        until = time.monotonic() + timeout_s
        while True:
            try:
                self._text("GET", "/healthz")
            except Unreachable:
                if time.monotonic() > until:
                    raise
                time.sleep(0.05)
            else:
                return

    def _ask(
        self,
        method: str,
        path: str,
        answer: type[T],
        *,
        query: Query | None = None,
        header: Query | None = None,
        body: Query | None = None,
        content: bytes | Iterable[bytes] | None = None,
        also: tuple[int, ...] = (),
    ) -> T:
        response = self._sent(method, path, also, **request_of(query, header, body, content))
        return read_answer(answer, response.content)

    def _text(self, method: str, path: str, *, query: Query | None = None, also: tuple[int, ...] = ()) -> str:
        response = self._sent(method, path, also, **request_of(query, None, None, None))
        return response.text

    def _sent(self, method: str, path: str, also: tuple[int, ...], **request: Any) -> httpx.Response:
        if self._http.is_closed:
            raise Unreachable("the client is closed")
        try:
            response = self._http.request(method, path, **request)
        except httpx.TransportError as error:
            raise unreachable(error) from error
        if response.is_error and response.status_code not in also:
            raise problem_of(response.status_code, response.content)
        return response

    def _follow(
        self,
        path: str,
        message: type[T] | UnionType,
        *,
        query: Query | None = None,
        last_event_id: int | None = None,
        resume: bool = False,
    ) -> Iterator[T]:
        """Messages, for ever if the stream can be resumed; after what was heard last, if it broke."""
        last: int | str | None = last_event_id
        heard = time.monotonic()
        while True:
            try:
                for found in self._stream(path, query, last):
                    last, heard = found.get("id", last), time.monotonic()
                    if (told := read_message(message, found)) is not None:
                        yield told
                    heard = time.monotonic()
            except httpx.TransportError as error:
                if not resume or time.monotonic() - heard > self._patience_s:
                    raise unreachable(error) from error
            else:
                if not resume:
                    return
            time.sleep(AGAIN_S)

    def _stream(self, path: str, query: Query | None, last: int | str | None) -> Iterator[dict[str, Any]]:
        parser = EventParser()
        with self._http.stream("GET", path, **stream_of(query, last)) as response:
            if response.is_error:
                raise problem_of(response.status_code, response.read())
            for piece in response.iter_bytes():
                yield from parser.feed(piece)
