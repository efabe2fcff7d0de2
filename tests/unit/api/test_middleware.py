from __future__ import annotations

import asyncio
import json
from types import SimpleNamespace

import pytest
from starlette.exceptions import HTTPException

from mavcal.service.api import middleware
from mavcal.service.api.middleware import LARGEST_REQUEST_BYTES, LEAST_BYTES_PER_S, Envelope
from mavcal.service.errors import AuthError, Forbidden, TooManyAttempts
from mavcal.service.settings import LimitSettings, Settings
from tests.clock import ManualClock


class Guard:
    """A guard that admits every request unless it has an error to raise; it notes whose key was checked."""

    def __init__(self):
        self.foreign = self.unknown = None
        self.asked = []

    def check_origin(self, method, headers, scheme):
        if self.foreign is not None:
            raise self.foreign

    def authenticate(self, request):
        self.asked.append(request.method)
        if self.unknown is not None:
            raise self.unknown


async def fine(_scope, _receive, send):
    await send({"type": "http.response.start", "status": 200, "headers": []})
    await send({"type": "http.response.body", "body": b"ok"})


class Asked:
    """The answers of an envelope around `app`."""

    def __init__(self, app, **settings):
        self.guard, self.ending = Guard(), asyncio.Event()
        self.envelope = Envelope(app, Settings(**settings), self.guard, self.ending)

    async def __call__(self, path="/api/v1/jobs", method="GET", receive=None, headers=()):
        sent = []

        async def send(message):
            sent.append(message)

        async def nothing():
            return {"type": "http.request", "body": b""}

        scope = {
            "type": "http", "method": method, "path": path, "scheme": "http", "query_string": b"", "root_path": "",
            "headers": [(name.encode(), value.encode()) for name, value in headers],
        }  # fmt: skip
        await self.envelope(scope, receive or nothing, send)
        start, body = sent
        return SimpleNamespace(
            status=start["status"],
            headers={name.decode(): value.decode() for name, value in start["headers"]},
            body=body["body"],
        )


async def test_every_answer_has_an_id_of_its_own_and_the_headers_of_security():
    asked = Asked(fine)
    first, second = await asked(), await asked()
    assert first.headers["x-request-id"] != second.headers["x-request-id"]
    assert first.headers["x-content-type-options"] == "nosniff"
    assert first.headers["referrer-policy"] == "same-origin"
    assert first.headers["cross-origin-resource-policy"] == "same-origin"


async def test_a_report_runs_nothing_and_the_panel_loads_from_here_alone():
    asked = Asked(fine, frame_ancestors=("https://boat.local",))
    panel = (await asked("/")).headers["content-security-policy"]
    report = (await asked("/api/v1/gaps/j/report.html")).headers["content-security-policy"]
    assert panel.startswith("default-src 'self';")
    assert "unsafe-inline" not in panel
    assert "sandbox" in report
    assert "default-src 'none'" in report
    for policy in (panel, report):
        assert policy.endswith("frame-ancestors https://boat.local")


async def test_without_an_ancestor_nobody_may_show_it_in_a_frame():
    policy = (await Asked(fine, frame_ancestors=())()).headers["content-security-policy"]
    assert policy.endswith("frame-ancestors 'none'")


async def test_what_is_no_request_passes_through():
    seen = []

    async def app(scope, _receive, _send):
        seen.append(scope["type"])

    await Asked(app).envelope({"type": "lifespan"}, None, None)
    assert seen == ["lifespan"]


@pytest.mark.parametrize(
    ("method", "error", "status", "header"),
    [
        ("GET", Forbidden("not from there"), 403, {}),
        ("POST", AuthError("a key is needed"), 401, {"www-authenticate": "Bearer"}),
        ("POST", TooManyAttempts("wait", wait_s=2.1), 429, {"retry-after": "3"}),
    ],
)
async def test_who_may_not_ask_is_refused_before_the_body_is_read(method, error, status, header):
    async def never():
        raise AssertionError

    asked = Asked(fine)
    setattr(asked.guard, "foreign" if status == 403 else "unknown", error)
    answer = await asked(method=method, receive=never)
    problem = json.loads(answer.body)
    assert (answer.status, problem["code"], problem["detail"]) == (status, error.code, str(error))
    assert problem["request_id"] == answer.headers["x-request-id"]
    assert header.items() <= answer.headers.items()
    assert answer.headers["content-type"] == "application/problem+json"


async def test_only_a_change_needs_its_key_before_the_body():
    asked = Asked(fine)
    for method in ("GET", "HEAD", "OPTIONS", "POST", "DELETE"):
        await asked(method=method)
    assert asked.guard.asked == ["POST", "DELETE"]


@pytest.mark.parametrize(
    ("headers", "closes"),
    [
        ([], False),
        ([("content-length", "0")], False),
        ([("content-length", "7")], True),
        ([("transfer-encoding", "chunked")], True),
    ],
)
async def test_a_refusal_ends_the_connection_where_a_body_was_not_read(headers, closes):
    asked = Asked(fine)
    asked.guard.foreign = Forbidden("no")
    assert ((await asked(headers=headers)).headers.get("connection") == "close") is closes


async def test_a_defect_is_told_by_its_id_alone():
    async def broken(*_):
        raise ZeroDivisionError("the password is 7")

    answer = await Asked(broken)()
    problem = json.loads(answer.body)
    assert (answer.status, problem["code"]) == (500, "internal-error")
    assert problem["request_id"] == answer.headers["x-request-id"]
    assert "password" not in answer.body.decode()


async def test_a_defect_in_the_middle_of_an_answer_breaks_it_off():
    async def broken(_scope, _receive, send):
        await send({"type": "http.response.start", "status": 200, "headers": []})
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        await Asked(broken)()


@pytest.mark.parametrize("path", ["/api/v1/events", "/api/v1/vehicles/v/stream", "/api/v1/vehicles/v/samples"])
async def test_streams_have_a_limit_and_free_their_places(path):
    asked = Asked(fine, limits=LimitSettings(streams=2))
    held, release = asyncio.Event(), asyncio.Event()
    open_now = 0

    async def streams(scope, receive, send):
        nonlocal open_now
        open_now += 1
        if open_now == 2:
            held.set()
        await release.wait()
        await fine(scope, receive, send)

    asked.envelope._app = streams
    running = [asyncio.ensure_future(asked(path)) for _ in range(2)]
    await held.wait()
    full = await asked(path)
    assert (full.status, full.headers["retry-after"]) == (503, "5")
    assert json.loads(full.body)["code"] == "too-many-streams"
    release.set()
    assert [answer.status for answer in await asyncio.gather(*running)] == [200, 200]
    assert (await asked(path)).status == 200


async def test_only_reading_a_stream_takes_a_place():
    async def broken(*_):
        raise ZeroDivisionError

    asked = Asked(broken, limits=LimitSettings(streams=1))
    for path, method in (("/api/v1/events", "POST"), ("/api/v1/jobs", "GET"), ("/api/v1/events", "GET")):
        assert (await asked(path, method)).status == 500
    asked.envelope._app = fine
    assert (await asked("/api/v1/events")).status == 200  # the one that broke has left its place


async def test_a_stream_sees_its_reader_go_when_the_service_ends():
    seen = []

    async def stream(scope, receive, send):
        seen.append((await receive())["type"])
        await fine(scope, receive, send)

    asked = Asked(stream)

    async def silent():
        await asyncio.Event().wait()

    running = asyncio.ensure_future(asked("/api/v1/events", receive=silent))
    await asyncio.sleep(0)
    asked.ending.set()
    await running
    await asked("/api/v1/events")  # what was said already goes before the end
    assert seen == ["http.disconnect", "http.request"]


def body(*chunks):
    """A body that comes in these pieces."""
    left = list(chunks)

    async def receive():
        piece = left.pop(0)
        return {"type": "http.request", "body": piece, "more_body": bool(left)}

    return receive


TOO_LARGE = 413, {"Connection": "close"}


async def refused(path, *chunks):
    """The refusal of a body to this address as status and headers; None: it was read."""
    receive, more = middleware._limited({"path": path}, body(*chunks)), True
    try:
        while more:
            more = (await receive())["more_body"]
    except HTTPException as error:
        return error.status_code, error.headers
    return None


async def test_a_request_is_as_large_as_the_limit_and_an_upload_larger():
    half = b"x" * (LARGEST_REQUEST_BYTES // 2)
    assert await refused("/api/v1/jobs", half, half) is None
    assert await refused("/api/v1/jobs", half, half, b"x") == TOO_LARGE
    assert await refused("/api/v1/recordings", half, half, b"x") is None
    assert await refused("/api/v1/recordings/r/fits", half, half, b"x") == TOO_LARGE


async def test_the_limits_hold_for_what_the_application_reads():
    async def reads(scope, receive, send):
        while (await receive())["more_body"]:
            pass
        await fine(scope, receive, send)

    asked, large = Asked(reads), b"x" * LARGEST_REQUEST_BYTES
    assert (await asked(method="POST", receive=body(large))).status == 200
    assert (await asked(method="POST", receive=body(large, b"x"))).status == 500  # no handler of problems is around it


@pytest.fixture
def clock(monkeypatch):
    made = ManualClock(100.0)
    monkeypatch.setattr(middleware, "time", SimpleNamespace(monotonic=made))
    return made


class Trickle:
    """A request body whose pieces arrive when the test gives them."""

    def __init__(self):
        self.pieces = asyncio.Queue()

    async def __call__(self):
        return await self.pieces.get()

    def give(self, size, *, more=True):
        self.pieces.put_nowait({"type": "http.request", "body": b"x" * size, "more_body": more})


WINDOW_S = 20.0
ENOUGH = int(LEAST_BYTES_PER_S * WINDOW_S)


async def test_a_body_that_trickles_is_refused_after_its_window(clock):
    trickle = Trickle()
    steady = middleware._steady(trickle, WINDOW_S)
    trickle.give(ENOUGH - 1)
    assert len((await steady())["body"]) == ENOUGH - 1
    clock.advance(WINDOW_S + 1.0)
    with pytest.raises(HTTPException) as raised:
        await steady()
    assert (raised.value.status_code, raised.value.headers) == (408, {"Connection": "close"})


async def test_a_body_that_came_fast_enough_has_another_window(clock):
    trickle = Trickle()
    steady = middleware._steady(trickle, WINDOW_S)
    trickle.give(ENOUGH)
    await steady()
    clock.advance(WINDOW_S + 1.0)
    waiting = asyncio.ensure_future(steady())
    for _ in range(5):
        await asyncio.sleep(0)
    assert not waiting.done()
    trickle.give(1)
    assert len((await waiting)["body"]) == 1
    clock.advance(WINDOW_S + 1.0)  # and what came in the first one does not count in the second
    with pytest.raises(HTTPException):
        await steady()


async def test_after_the_body_the_end_of_the_connection_is_waited_for_without_a_limit(clock):
    trickle = Trickle()
    steady = middleware._steady(trickle, WINDOW_S)
    trickle.give(0, more=False)
    await steady()
    clock.advance(100.0 * WINDOW_S)
    waiting = asyncio.ensure_future(steady())
    for _ in range(5):
        await asyncio.sleep(0)
    trickle.pieces.put_nowait({"type": "http.disconnect"})
    assert (await waiting)["type"] == "http.disconnect"
