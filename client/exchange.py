"""What goes over the wire: requests out of what was given, answers, problems and messages out of what came."""

from __future__ import annotations

import json
from collections.abc import Mapping
from types import UnionType
from typing import Any, TypeVar
from urllib.parse import quote

import httpx
from pydantic import BaseModel, TypeAdapter, ValidationError

from mavcal.client.errors import ApiProblem, UnexpectedAnswer, Unreachable
from mavcal.client.problems import PROBLEMS

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


def options(key: str | None, timeout_s: float) -> dict[str, Any]:
    """What holds for every request of a client."""
    headers = {"Authorization": f"Bearer {key}"} if key else {}
    return {"headers": headers, "timeout": timeout_s, "trust_env": False}


def request_of(query: Query | None, header: Query | None, body: Query | None, content: Any) -> dict[str, Any]:
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


def stream_of(query: Query | None, last_event_id: int | str | None) -> dict[str, Any]:
    """The request for a stream; `last_event_id`: the messages after it, None: from its beginning."""
    headers = {"Accept": "text/event-stream"}
    resumed = {} if last_event_id is None else {"Last-Event-ID": str(last_event_id)}
    return {**request_of(query, None, None, None), "headers": headers | resumed, "timeout": SILENCE_S}


def problem_of(status: int, content: bytes) -> ApiProblem:
    """The exception for an answer that says no."""
    try:
        document = json.loads(content)
    except ValueError:
        document = None
    if not isinstance(document, dict):
        document = {"detail": content[:200].decode("utf-8", "replace")}
    return PROBLEMS.get(str(document.get("code")), ApiProblem)(status, document)


def _adapter(shape: Any) -> TypeAdapter[Any]:
    """What reads answers of one shape; made at the first one: a program needs few of all shapes."""
    return _ADAPTERS.get(shape) or _ADAPTERS.setdefault(shape, TypeAdapter(shape))


_ADAPTERS: dict[Any, TypeAdapter[Any]] = {}


def read_answer(shape: type[T], content: bytes) -> T:
    """An answer of the service. Raises UnexpectedAnswer."""
    try:
        answer: T = _adapter(shape).validate_json(content)
    except ValidationError as error:
        raise UnexpectedAnswer(f"the answer is not as this version of the client knows it: {error}") from error
    return answer


def read_message(shape: type[T] | UnionType, message: Mapping[str, Any]) -> T | None:
    """The message; None: it is of a kind that a newer service has added, and is passed over."""
    try:
        read: T = _adapter(shape).validate_python(message)
    except ValidationError as error:
        if all(fault["type"] == "union_tag_invalid" for fault in error.errors()):
            return None
        raise UnexpectedAnswer(f"the message is not as this version of the client knows it: {error}") from error
    return read


def unreachable(error: Exception) -> Unreachable:
    """The exception for a request that got no answer."""
    return Unreachable(f"no answer from the service: {type(error).__name__}: {error}")
