"""Whatever is sent, the answer is a document and never a 500."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path
from typing import Any

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.examples import examples

from .api_bench import Api, api, kept_document

# Streams do not end; links open sockets and files of this machine: both have tests of their own.
CALLS = sorted(
    (method.upper(), path)
    for path, methods in kept_document()["paths"].items()
    for method in methods
    if not path.endswith(("/events", "/stream", "/samples")) and (method, path) != ("post", "/api/v1/links")
)

KINDS = st.sampled_from(["gyro", "mag-sphere", "finish", "0" * 64, "../x", "\ud800", "", "é", "a" * 300, "%2e%2e%2f"])
SEGMENT = st.one_of(KINDS, st.text(max_size=12))
VALUE = st.recursive(
    st.one_of(st.none(), st.booleans(), st.integers(), st.floats(), KINDS, st.text(max_size=8)),
    lambda inner: st.one_of(st.lists(inner, max_size=3), st.dictionaries(KINDS, inner, max_size=3)),
    max_leaves=6,
)
NAMES = st.sampled_from(["url", "kind", "options", "value", "plan_sha256", "reboot", "prove_s", "method", "extra"])
BODY = st.one_of(
    st.binary(max_size=40),
    VALUE.map(lambda v: json.dumps(v).encode()),
    st.dictionaries(NAMES, VALUE, max_size=4).map(lambda v: json.dumps(v).encode()),
    st.just(b"[" * 5000),
)
REQUEST = st.tuples(
    st.sampled_from(CALLS),
    SEGMENT,
    BODY,
    st.dictionaries(st.sampled_from(["name", "reading", "refresh", "vehicle_id", "ticket"]), SEGMENT, max_size=3),
    st.sampled_from(
        ["application/json"] * 4 + ["text/plain", "multipart/form-data", "application/json; charset=x", ""]
    ),
)


async def _ask(a: Api, requests: list[Any]) -> None:
    row = await a.call(
        "POST", "/api/v1/recordings", 201, params={"name": "a.csv"}, content=b"mag_x,mag_y,mag_z\n1,2,3\n4,5,7\n"
    )
    for (method, path), segment, body, query, kind in requests:
        first = row["id"] if "recording_id" in path and len(segment) % 2 else segment
        filled = path
        for name in ("vehicle_id", "job_id", "link_id", "recording_id", "form", "code"):
            filled = filled.replace(f"{{{name}}}", _quoted(first))
        params = {k: v.encode("utf-8", "replace").decode() for k, v in query.items()}
        await a.call(method, filled, content=body, params=params, headers={"Content-Type": kind})


def _quoted(segment: str) -> str:
    return "".join(f"%{b:02x}" for b in segment.encode("utf-8", "replace")) or "-"


def test_no_request_makes_the_service_fail(tmp_path: Path) -> None:
    """One service is asked everything: the start of another one costs more than all of its answers."""

    async def whole() -> None:
        async with api(tmp_path / "data") as a:
            loop = asyncio.get_running_loop()

            @settings(max_examples=examples(15), deadline=None, suppress_health_check=list(HealthCheck))
            @given(st.lists(REQUEST, min_size=10, max_size=25))
            def asked(requests: list[Any]) -> None:
                asyncio.run_coroutine_threadsafe(_ask(a, requests), loop).result()

            await asyncio.to_thread(asked)

    asyncio.run(whole())


def test_everything_that_is_documented_is_asked():
    assert len(CALLS) > 20
    assert {"GET", "POST", "PATCH", "DELETE"} == {method for method, _ in CALLS}
