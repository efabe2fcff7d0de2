"""How the client asks, what it makes of answers and problems, and how a stream goes on where it broke."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable, Iterator
from typing import Any

import httpx
import pytest

from mavcal.client import ApiProblem, AsyncClient, Client, UnexpectedAnswer, Unreachable, transport
from mavcal.client.problems import PROBLEMS, JobUnknown, VehicleArmed
from mavcal.client.requests import PlanOptions, ReadingOptions

Answering = Callable[[httpx.Request], httpx.Response]
LINK = {"id": "l1", "url": "udpin:0.0.0.0:14550", "state": "up", "reason": "", "signing_key": None, "vehicles": []}
LINK = {**LINK, "crc_errors": 0}
HEALTHY = httpx.Response(200, json={"status": "ok"})


def client(answering: Answering, **options: Any) -> Client:
    return Client("http://service/prefix", transport=httpx.MockTransport(answering), **options)


def problem(code: str, status: int = 409) -> httpx.Response:
    return httpx.Response(status, json={"code": code, "detail": "because", "title": "No", "request_id": "r1"})


def test_an_answer_is_a_model_and_a_new_field_is_passed_over():
    asked: list[httpx.Request] = []

    def answering(request: httpx.Request) -> httpx.Response:
        asked.append(request)
        return httpx.Response(200, json=[LINK | {"new": 1}])

    (link,) = client(answering, key="secret").list_links()
    assert (link.id, link.state) == ("l1", "up")
    assert str(asked[0].url) == "http://service/prefix/api/v1/links"
    assert asked[0].headers["authorization"] == "Bearer secret"


def test_only_what_was_given_is_sent():
    asked: list[httpx.Request] = []

    def answering(request: httpx.Request) -> httpx.Response:
        asked.append(request)
        return problem("job-unknown", 404)

    with client(answering) as c:
        with pytest.raises(JobUnknown):
            c.renew_plan("a/b", plan_options=PlanOptions(keep_gyro_at_boot=True))
        with pytest.raises(JobUnknown):
            c.renew_plan("j")
        with pytest.raises(JobUnknown):
            c.apply_plan("j", plan_sha256="0" * 64, reboot=False, idempotency_key="once")
        with pytest.raises(JobUnknown):
            c.upload_recording(b"1,2\n", name="a b.csv", reading=ReadingOptions(rate=50.0))
        with pytest.raises(JobUnknown):
            c.list_parameters("v", refresh=True)
    plan, plain, accept, upload, parameters = asked
    assert plan.url.raw_path == b"/prefix/api/v1/jobs/a%2Fb/plan"
    assert json.loads(plan.content) == {"plan_options": {"keep_gyro_at_boot": True}}
    assert json.loads(plain.content) == {}
    assert json.loads(accept.content) == {"plan_sha256": "0" * 64, "reboot": False}
    assert accept.headers["idempotency-key"] == "once"
    assert upload.content == b"1,2\n"
    assert json.loads(upload.url.params["reading"]) == {"rate": 50.0}
    assert upload.url.params["name"] == "a b.csv"
    assert parameters.url.params["refresh"] == "true"


def test_a_problem_is_an_exception_of_its_own():
    with pytest.raises(VehicleArmed, match="409: because") as caught:
        client(lambda _: problem("vehicle-armed")).get_job("j")
    assert (caught.value.code, caught.value.status, caught.value.request_id) == ("vehicle-armed", 409, "r1")
    assert set(PROBLEMS.values()) <= set(ApiProblem.__subclasses__())


@pytest.mark.parametrize("content", [b"<html>", b"[]", b"", b"\xff"])
def test_an_error_of_somebody_else_is_a_problem_all_the_same(content):
    with pytest.raises(ApiProblem) as caught:
        client(lambda _: httpx.Response(502, content=content)).get_job("j")
    assert (type(caught.value), caught.value.status) == (ApiProblem, 502)


def test_an_answer_of_another_form_is_told():
    with pytest.raises(UnexpectedAnswer):
        client(lambda _: httpx.Response(200, json={"id": 1})).get_job("j")


def test_a_service_that_is_not_there_is_told():
    def refusing(request: httpx.Request) -> httpx.Response:
        raise httpx.ConnectError("refused", request=request)

    with client(refusing, patience_s=0.0) as c:
        with pytest.raises(Unreachable, match="refused"):
            c.list_links()
        with pytest.raises(Unreachable):
            next(c.follow_job("j"))
        with pytest.raises(Unreachable):
            c.wait_ready(0.0)
    with pytest.raises(Unreachable, match="closed"):
        c.list_links()


def test_what_is_not_ready_is_an_answer():
    answer = httpx.Response(503, json={"status": "not ready", "reason": "disk full"})
    assert client(lambda _: answer).get_readiness().reason == "disk full"


# --- streams


def event(sequence: int, kind: str = "warning", data: Any = None) -> bytes:
    body = {
        "job_id": "j",
        "sequence": sequence,
        "at": 1.5,
        "kind": kind,
        "data": data or {"text": f"number {sequence}"},
    }
    return f"event: job\nid: {sequence}\ndata: {json.dumps(body)}\n\n".encode()


class Broken(httpx.SyncByteStream, httpx.AsyncByteStream):
    """A body whose connection breaks at its end."""

    def __init__(self, *pieces: bytes) -> None:
        self._pieces = pieces

    def __iter__(self) -> Iterator[bytes]:
        yield from self._pieces
        raise httpx.ReadError("reset")

    async def __aiter__(self):
        for piece in self:
            yield piece


@pytest.fixture(autouse=True)
def at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(transport, "AGAIN_S", 0.0)


def breaking(asked: list[str | None]) -> Answering:
    """First two messages and a break, then an end in mid-message, then the rest."""
    bodies = [
        Broken(event(1), event(2)[:20], event(2)[20:]),
        httpx.ByteStream(event(3) + event(4)[:30]),
        httpx.ByteStream(event(4) + event(5)),
    ]

    def answering(request: httpx.Request) -> httpx.Response:
        asked.append(request.headers.get("last-event-id"))
        return httpx.Response(200, stream=bodies[len(asked) - 1])

    return answering


def test_a_stream_goes_on_where_it_broke():
    asked: list[str | None] = []
    stream = client(breaking(asked)).follow_job("j")
    assert [next(stream).data.sequence for _ in range(5)] == [1, 2, 3, 4, 5]
    assert asked == [None, "2", "3"]


async def test_an_asynchronous_stream_goes_on_where_it_broke():
    asked: list[str | None] = []
    async with AsyncClient("http://service", transport=httpx.MockTransport(breaking(asked))) as c:
        stream = c.follow_job("j", last_event_id=0)
        async with asyncio.timeout(10):
            assert [(await anext(stream)).data.sequence for _ in range(5)] == [1, 2, 3, 4, 5]
    assert asked == ["0", "2", "3"]


def test_a_stream_without_ids_ends_when_its_link_does():
    answer = httpx.Response(200, stream=httpx.ByteStream(b": ping\n\n"))
    assert list(client(lambda _: answer).follow_vehicle("v")) == []


def test_a_refused_stream_is_a_problem():
    with pytest.raises(JobUnknown):
        next(client(lambda _: problem("job-unknown", 404)).follow_job("j"))


def test_an_event_of_a_kind_that_a_newer_service_adds_is_passed_over():
    answer = httpx.Response(200, stream=httpx.ByteStream(event(1, "marvel") + event(2)))
    assert next(client(lambda _: answer).follow_job("j")).data.sequence == 2


def test_a_message_of_another_form_is_told():
    answer = httpx.Response(200, stream=httpx.ByteStream(event(1, "state", {"state": "lost", "outcome": None})))
    with pytest.raises(UnexpectedAnswer):
        next(client(lambda _: answer).follow_job("j"))


async def test_the_asynchronous_client_says_the_same():
    def answering(request: httpx.Request) -> httpx.Response:
        return HEALTHY if request.url.path == "/healthz" else problem("vehicle-armed")

    async with AsyncClient("http://service", transport=httpx.MockTransport(answering)) as c:
        await c.wait_ready()
        with pytest.raises(VehicleArmed):
            await c.apply_plan("j", plan_sha256="0" * 64)
    with pytest.raises(Unreachable):
        await c.list_links()
