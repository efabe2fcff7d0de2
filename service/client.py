"""A small HTTP client of the service, for the demo, the fault campaign and scripts: standard library only."""

from __future__ import annotations

import http.client
import json
import time
from collections.abc import Iterator, Mapping
from typing import Any
from urllib.parse import urlsplit

Json = dict[str, Any]


class ApiError(Exception):
    """The service answered with a problem document."""

    def __init__(self, status: int, problem: Mapping[str, Any]) -> None:
        super().__init__(f"{status}: {problem.get('detail') or problem.get('title') or 'no detail'}")
        self.status = status
        self.problem = dict(problem)


class ServiceClient:
    """Talks to ``http://host:port`` (with a path prefix if there is one); every call opens its own connection."""

    def __init__(self, url: str, *, key: str | None = None, timeout_s: float = 30.0) -> None:
        parts = urlsplit(url)
        self._host = parts.hostname or "127.0.0.1"
        self._port = parts.port or 80
        self._prefix = parts.path.rstrip("/") + "/api/v1"
        self._timeout_s = timeout_s
        self._headers = {"Authorization": f"Bearer {key}"} if key else {}

    def get(self, path: str) -> Any:
        """The decoded answer to GET `path` (below ``/api/v1``)."""
        return self._call("GET", path, None, {})

    def post(self, path: str, body: Mapping[str, Any] | None = None, **headers: str) -> Any:
        """The decoded answer to POST `path`; header names are given with underscores."""
        return self._call("POST", path, dict(body or {}), {k.replace("_", "-"): v for k, v in headers.items()})

    def delete(self, path: str) -> Any:
        """The decoded answer to DELETE `path`."""
        return self._call("DELETE", path, None, {})

    def events(self, path: str, *, last_event_id: int | None = None) -> Iterator[tuple[int | None, str, Any]]:
        """Server-sent events of `path` as (id, event name, data), until the server ends the stream."""
        headers = {"Accept": "text/event-stream", **self._headers}
        if last_event_id is not None:
            headers["Last-Event-ID"] = str(last_event_id)
        connection = http.client.HTTPConnection(self._host, self._port, timeout=self._timeout_s)
        try:
            connection.request("GET", self._prefix + path, headers=headers)
            response = connection.getresponse()
            if response.status != 200:
                raise ApiError(response.status, _decoded(response.read()))
            yield from _parsed(response)
        finally:
            connection.close()

    def wait_ready(self, timeout_s: float = 20.0) -> None:
        """Wait until the service answers.

        Raises
        ------
        TimeoutError
            If it does not within `timeout_s`.
        """
        until = time.monotonic() + timeout_s
        while time.monotonic() < until:
            try:
                self.get("/vehicles")
            except (OSError, http.client.HTTPException):
                time.sleep(0.05)
            else:
                return
        raise TimeoutError(f"no answer from {self._host}:{self._port} within {timeout_s:g} s")

    def _call(self, method: str, path: str, body: Json | None, headers: dict[str, str]) -> Any:
        connection = http.client.HTTPConnection(self._host, self._port, timeout=self._timeout_s)
        try:
            payload = None if body is None else json.dumps(body)
            sent = {**self._headers, **headers, "Content-Type": "application/json"}
            connection.request(method, self._prefix + path, body=payload, headers=sent)
            response = connection.getresponse()
            answer = _decoded(response.read())
        finally:
            connection.close()
        if response.status >= 400:
            raise ApiError(response.status, answer if isinstance(answer, dict) else {"detail": str(answer)})
        return answer


def _decoded(raw: bytes) -> Any:
    try:
        return json.loads(raw) if raw else {}
    except ValueError:
        return {"detail": raw[:200].decode("utf-8", "replace")}


def _parsed(response: http.client.HTTPResponse) -> Iterator[tuple[int | None, str, Any]]:
    identifier: int | None = None
    name, lines = "message", list[str]()
    while raw := response.readline():
        line = raw.decode().rstrip("\r\n")
        field, _, value = line.partition(":")
        value = value.removeprefix(" ")
        if not line:
            if lines:
                yield identifier, name, json.loads("\n".join(lines))
            name, lines = "message", []
        elif field == "data":
            lines.append(value)
        elif field == "event":
            name = value
        elif field == "id" and value.isdigit():
            identifier = int(value)
