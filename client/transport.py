"""How a service is asked: requests, answers, problems, and streams that go on where they broke."""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import AsyncIterable, AsyncIterator, Iterable, Iterator, Mapping
from types import TracebackType
from typing import Any, Self, TypeVar
from urllib.parse import quote

import httpx
from pydantic import BaseModel, TypeAdapter, ValidationError

from mavcal.client.errors import ApiProblem, UnexpectedAnswer, Unreachable
from mavcal.client.problems import PROBLEMS
from mavcal.client.sse import EventParser

T = TypeVar("T")

AGAIN_S = 0.5
"""After which a stream that broke is asked for again."""
SILENCE_S = 60.0
"""A stream that brings nothing for so long is broken: the service sends a comment every 15 s."""
IDLE_S = 2.0
"""How long a connection is kept for the next request; the service closes it after 5 s."""
LIMITS = httpx.Limits(keepalive_expiry=IDLE_S)
Query = Mapping[str, Any]


def segment(value: object) -> str:
    """A value as one segment of a path."""
    return quote(str(value), safe="")


def _options(key: str | None, timeout_s: float) -> dict[str, Any]:
    headers = {"Authorization": f"Bearer {key}"} if key else {}
    return {"headers": headers, "timeout": timeout_s, "trust_env": False}


def _request(query: Query | None, header: Query | None, body: Query | None, content: Any) -> dict[str, Any]:
    """What was given goes on the wire; None was not given."""
    made: dict[str, Any] = {} if content is None else {"content": content}
    if query:
        made["params"] = {k: _flat(v) for k, v in query.items() if v is not None}
    headers = {k: str(v) for k, v in (header or {}).items() if v is not None}
    if body is not None:
        made["content"] = json.dumps({k: _plain(v) for k, v in body.items() if v is not None})
        headers["Content-Type"] = "application/json"
    return made | {"headers": headers}


def _plain(value: Any) -> Any:
    return value.model_dump(mode="json", exclude_unset=True) if isinstance(value, BaseModel) else value


def _flat(value: Any) -> Any:
    return value.model_dump_json(exclude_unset=True) if isinstance(value, BaseModel) else value


def _stream(query: Query | None, last_event_id: int | str | None) -> dict[str, Any]:
    headers = {"Accept": "text/event-stream"}
    resumed = {} if last_event_id is None else {"Last-Event-ID": str(last_event_id)}
    return {**_request(query, None, None, None), "headers": headers | resumed, "timeout": SILENCE_S}


def problem_of(status: int, content: bytes) -> ApiProblem:
    """The exception for an answer that says no."""
    try:
        document = json.loads(content)
    except ValueError:
        document = None
    if not isinstance(document, dict):
        document = {"detail": content[:200].decode("utf-8", "replace")}
    return PROBLEMS.get(str(document.get("code")), ApiProblem)(status, document)


def _read(adapter: TypeAdapter[T], content: bytes) -> T:
    try:
        return adapter.validate_json(content)
    except ValidationError as error:
        raise UnexpectedAnswer(f"the answer is not as this version of the client knows it: {error}") from error


def _message(adapter: TypeAdapter[T], message: Mapping[str, Any]) -> T | None:
    """The message; None: it is of a kind that a newer service has added, and is passed over."""
    try:
        return adapter.validate_python(message)
    except ValidationError as error:
        if all(fault["type"] == "union_tag_invalid" for fault in error.errors()):
            return None
        raise UnexpectedAnswer(f"the message is not as this version of the client knows it: {error}") from error


def _unreachable(error: Exception) -> Unreachable:
    return Unreachable(f"no answer from the service: {type(error).__name__}: {error}")


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
        self._http = httpx.Client(base_url=url, transport=over, **_options(key, timeout_s))
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
        answer: TypeAdapter[T],
        *,
        query: Query | None = None,
        header: Query | None = None,
        body: Query | None = None,
        content: bytes | Iterable[bytes] | None = None,
        also: tuple[int, ...] = (),
    ) -> T:
        response = self._sent(method, path, also, **_request(query, header, body, content))
        return _read(answer, response.content)

    def _text(self, method: str, path: str, *, query: Query | None = None, also: tuple[int, ...] = ()) -> str:
        return self._sent(method, path, also, **_request(query, None, None, None)).text

    def _sent(self, method: str, path: str, also: tuple[int, ...], **request: Any) -> httpx.Response:
        if self._http.is_closed:
            raise Unreachable("the client is closed")
        try:
            response = self._http.request(method, path, **request)
        except httpx.TransportError as error:
            raise _unreachable(error) from error
        if response.is_error and response.status_code not in also:
            raise problem_of(response.status_code, response.content)
        return response

    def _follow(
        self,
        path: str,
        message: TypeAdapter[T],
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
                    if (told := _message(message, found)) is not None:
                        yield told
                    heard = time.monotonic()
            except httpx.TransportError as error:
                if not resume or time.monotonic() - heard > self._patience_s:
                    raise _unreachable(error) from error
            else:
                if not resume:
                    return
            time.sleep(AGAIN_S)

    def _stream(self, path: str, query: Query | None, last: int | str | None) -> Iterator[dict[str, Any]]:
        parser = EventParser()
        with self._http.stream("GET", path, **_stream(query, last)) as response:
            if response.is_error:
                raise problem_of(response.status_code, response.read())
            for piece in response.iter_bytes():
                yield from parser.feed(piece)


class AsyncTransport:
    """As :class:`Transport`, for asyncio."""

    def __init__(
        self,
        url: str,
        *,
        key: str | None = None,
        timeout_s: float = 30.0,
        patience_s: float = 30.0,
        transport: httpx.AsyncBaseTransport | None = None,
    ) -> None:
        over = transport or httpx.AsyncHTTPTransport(limits=LIMITS, trust_env=False)
        self._http = httpx.AsyncClient(base_url=url, transport=over, **_options(key, timeout_s))
        self._patience_s = patience_s

    async def __aenter__(self) -> Self:
        """The client, closed at the end of the block."""
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close it."""
        await self.close()

    async def close(self) -> None:
        """Close every connection."""
        await self._http.aclose()

    async def wait_ready(self, timeout_s: float = 20.0) -> None:
        """Wait until the service answers. Raises Unreachable."""
        until = time.monotonic() + timeout_s
        while True:
            try:
                await self._text("GET", "/healthz")
            except Unreachable:
                if time.monotonic() > until:
                    raise
                await asyncio.sleep(0.05)
            else:
                return

    async def _ask(
        self,
        method: str,
        path: str,
        answer: TypeAdapter[T],
        *,
        query: Query | None = None,
        header: Query | None = None,
        body: Query | None = None,
        content: bytes | AsyncIterable[bytes] | None = None,
        also: tuple[int, ...] = (),
    ) -> T:
        response = await self._sent(method, path, also, **_request(query, header, body, content))
        return _read(answer, response.content)

    async def _text(self, method: str, path: str, *, query: Query | None = None, also: tuple[int, ...] = ()) -> str:
        return (await self._sent(method, path, also, **_request(query, None, None, None))).text

    async def _sent(self, method: str, path: str, also: tuple[int, ...], **request: Any) -> httpx.Response:
        if self._http.is_closed:
            raise Unreachable("the client is closed")
        try:
            response = await self._http.request(method, path, **request)
        except httpx.TransportError as error:
            raise _unreachable(error) from error
        if response.is_error and response.status_code not in also:
            raise problem_of(response.status_code, response.content)
        return response

    async def _follow(
        self,
        path: str,
        message: TypeAdapter[T],
        *,
        query: Query | None = None,
        last_event_id: int | None = None,
        resume: bool = False,
    ) -> AsyncIterator[T]:
        """As that of :class:`Transport`."""
        last: int | str | None = last_event_id
        heard = time.monotonic()
        while True:
            try:
                async for found in self._stream(path, query, last):
                    last, heard = found.get("id", last), time.monotonic()
                    if (told := _message(message, found)) is not None:
                        yield told
                    heard = time.monotonic()
            except httpx.TransportError as error:
                if not resume or time.monotonic() - heard > self._patience_s:
                    raise _unreachable(error) from error
            else:
                if not resume:
                    return
            await asyncio.sleep(AGAIN_S)

    async def _stream(self, path: str, query: Query | None, last: int | str | None) -> AsyncIterator[dict[str, Any]]:
        parser = EventParser()
        async with self._http.stream("GET", path, **_stream(query, last)) as response:
            if response.is_error:
                raise problem_of(response.status_code, await response.aread())
            async for piece in response.aiter_bytes():
                for found in parser.feed(piece):
                    yield found
