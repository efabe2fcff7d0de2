"""Gap diagnoses over HTTP: asked for, waited for, read; and everything that can be wrong with the asking."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path
from typing import Any
from urllib.parse import urljoin

import pytest

from mavcal.service.children import Limits
from mavcal.service.gaps import MOST_WAITING, Gaps, GapState
from tests.patience import scaled
from tests.service.gap_tables import write_table

from .api_bench import Api, api


async def upload(a: Api, path: Path) -> str:
    content = await asyncio.to_thread(path.read_bytes)
    made = await a.call("POST", "/api/v1/recordings", 201, params={"name": path.name}, content=content)
    return str(made["id"])


def own_gaps(a: Api, folder: Path, limits: Limits) -> Gaps:
    return Gaps(a.service.recordings, folder, children=a.service.children, limits=limits)


async def ended(a: Api, gap_id: str) -> Any:
    async with asyncio.timeout(scaled(60)):
        while (found := await a.get(f"/gaps/{gap_id}"))["state"] not in {"done", "failed"}:  # noqa: ASYNC110 - over HTTP
            await asyncio.sleep(0.1)
    return found


async def test_a_gap_is_diagnosed_and_its_page_served(tmp_path):
    table = write_table(tmp_path / "real.csv", seconds=10.0)
    async with api(tmp_path / "data") as a:
        real = await upload(a, table)
        response = await a.client.post("/api/v1/gaps", json={"real": real})
        assert response.status_code == 202
        where = urljoin(str(response.url), response.headers["location"])
        started = response.json()
        await a.get(f"/gaps/{started['id']}/report.html", 409)
        found = await ended(a, started["id"])
        assert found == await a.call("GET", where, 200)
        assert found["state"] == "done"
        assert found["report"]["schema"] == "gap/1"
        assert [e["id"] for e in found["report"]["effects"]] == ["accel_bias"]
        page = await a.client.get(f"/{found['page']}")
        assert page.headers["content-type"].startswith("text/html")
        assert "Sim-to-real gap of real.csv" in page.text
    async with api(tmp_path / "data") as a:  # after a restart it is still there
        assert [g["state"] for g in await a.get("/gaps")] == ["done"]
        assert (await a.get(f"/gaps/{started['id']}"))["report"] == found["report"]


async def test_what_cannot_be_compared_fails_with_its_reason(tmp_path):
    (tmp_path / "still.csv").write_text(
        "t,accel_x,accel_y,accel_z\n" + "".join(f"{i / 50},0,0,-9.8\n" for i in range(99))
    )
    async with api(tmp_path / "data") as a:
        real = await upload(a, tmp_path / "still.csv")
        found = await ended(a, (await a.post("/gaps", {"real": real}, 202))["id"])
        assert (found["state"], found["report"], found["page"]) == ("failed", None, None)
        assert "ref_" in found["error"]
        assert str(tmp_path) not in found["error"]
        said = await a.get(f"/gaps/{found['id']}/report.html", 409)
        assert said["type"].endswith("gap-unfinished")


@pytest.mark.parametrize(
    ("body", "status"),
    [
        ({}, 422),
        ({"real": "0" * 16}, 404),
        ({"real": 7}, 422),
        ({"real": "x", "extra": 1}, 422),
        ({"real": "x", "nominal": ["y"] * 9}, 422),
        ({"real": "../../etc/passwd"}, 404),
    ],
)
async def test_wrong_requests_are_problems(tmp_path, body, status):
    async with api(tmp_path) as a:
        await a.post("/gaps", body, status)
        assert await a.get("/gaps") == []


@pytest.mark.parametrize("gap_id", ["0" * 16, "x", "..%2F..%2Fsecret", "a" * 5000])
async def test_an_unknown_id_is_not_found(tmp_path, gap_id):
    async with api(tmp_path) as a:
        await a.get(f"/gaps/{gap_id}", 404)
        await a.get(f"/gaps/{gap_id}/report.html", 404)


async def test_too_many_are_refused_and_stopping_ends_them(tmp_path):
    table = write_table(tmp_path / "real.csv", seconds=10.0)
    async with api(tmp_path / "data") as a:
        real = await upload(a, table)
        for _ in range(MOST_WAITING):
            await a.post("/gaps", {"real": real}, 202)
        said = await a.post("/gaps", {"real": real}, 429)
        assert said["type"].endswith("gaps-busy")
    async with api(tmp_path / "data") as a:
        states = {g["state"] for g in await a.get("/gaps")}
        assert states <= {"failed", "done"}
        assert any("stopped" in (g["error"] or "") for g in await a.get("/gaps"))


async def test_a_diagnosis_that_takes_too_long_is_ended(tmp_path):
    table = write_table(tmp_path / "real.csv")
    async with api(tmp_path / "data") as a:
        real = await upload(a, table)
        gaps = own_gaps(a, tmp_path / "own", Limits(2**30, 60.0, 0.05))
        row = gaps.start(real, None, ())
        async with asyncio.timeout(scaled(20)):
            while gaps.get(row.id).state in {GapState.QUEUED, GapState.RUNNING}:  # noqa: ASYNC110 - as a client would
                await asyncio.sleep(0.05)
        assert "longer than 0.05 s" in (gaps.get(row.id).error or "")


async def test_what_a_crash_left_running_is_failed(tmp_path):
    async with api(tmp_path) as a:
        folder = tmp_path / "own"
        folder.mkdir()
        left = {"id": "a" * 16, "created_at": 1.0, "real": "r", "sim": None, "nominal": [], "state": "running"}
        (folder / f"{'a' * 16}.json").write_text(json.dumps({**left, "error": None}))
        assert own_gaps(a, folder, Limits(2**30, 1.0, 1.0)).get("a" * 16).state is GapState.FAILED


@pytest.mark.parametrize("content", [b"", b"[", b"{}", b"null", b"[]", b"\xff", b'{"id": 1}', b"[" * 100_000])
async def test_a_damaged_record_stops_nothing_and_is_shown_as_failed(tmp_path, content):
    async with api(tmp_path) as a:
        folder = a.service.settings.data_dir / "gaps"
    (folder / f"{'a' * 16}.json").write_bytes(content)
    done = {"id": "b" * 16, "created_at": 1.0, "real": "r", "sim": None, "nominal": [], "state": "done", "error": None}
    (folder / f"{'b' * 16}.json").write_text(json.dumps(done))
    (folder / f"{'b' * 16}.report").write_bytes(content[:1])
    async with api(tmp_path) as a:
        states = {g["id"]: g["state"] for g in await a.get("/gaps")}
        assert states["a" * 16] == "failed"
        assert "damaged" in (await a.get(f"/gaps/{'a' * 16}"))["error"]
        found = await a.get(f"/gaps/{'b' * 16}")
        assert (found["state"], found["report"]) == ("failed", None)
        await a.get(f"/gaps/{'b' * 16}/report.html", 409)
