"""Gap diagnoses over HTTP: asked for, waited for, read; and everything that can be wrong with the asking."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any
from urllib.parse import urljoin

import pytest

from mavcal.service.jobs.uploads import MOST_DIAGNOSES
from mavcal.service.settings import LimitSettings
from tests.patience import scaled
from tests.service.gap_tables import write_table

from .api_bench import Api, api, served


async def upload(a: Api, path: Path) -> str:
    content = await asyncio.to_thread(path.read_bytes)
    made = await a.call("POST", "/api/v1/recordings", 201, params={"name": path.name}, content=content)
    return str(made["id"])


async def ended(a: Api, gap_id: str) -> Any:
    async with asyncio.timeout(scaled(60)):
        while (found := await a.get(f"/gaps/{gap_id}"))["state"] not in {"succeeded", "failed"}:  # noqa: ASYNC110 - over HTTP
            await asyncio.sleep(0.1)
    return found


@pytest.mark.long
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
        assert found["state"] == "succeeded"
        assert found["report"]["schema"] == "gap/1"
        assert [e["id"] for e in found["report"]["effects"]] == ["accel_bias"]
        page = await a.client.get(f"/{found['page']}")
        assert page.headers["content-type"].startswith("text/html")
        assert "Sim-to-real gap of real.csv" in page.text
    async with api(tmp_path / "data") as a:  # after a restart it is still there
        assert [g["state"] for g in await a.get("/gaps")] == ["succeeded"]
        assert (await a.get(f"/gaps/{started['id']}"))["report"] == found["report"]


@pytest.mark.long
async def test_what_cannot_be_compared_is_an_answer_with_its_reason(tmp_path):
    (tmp_path / "still.csv").write_text(
        "t,accel_x,accel_y,accel_z\n" + "".join(f"{i / 50},0,0,-9.8\n" for i in range(99))
    )
    async with api(tmp_path / "data") as a:
        real = await upload(a, tmp_path / "still.csv")
        found = await ended(a, (await a.post("/gaps", {"real": real}, 202))["id"])
        assert found["state"] == "succeeded"
        assert (found["report"]["verdict"], found["report"]["tested"]) == ("not_testable", False)
        (gone,) = found["report"]["not_testable"]
        assert "ref_" in gone["need"]
        assert "ref_" in (await a.client.get(f"/{found['page']}")).text


@pytest.mark.long
async def test_two_files_that_are_one_fail_with_the_reason(tmp_path):
    (tmp_path / "still.csv").write_text(
        "t,accel_x,accel_y,accel_z\n" + "".join(f"{i / 50},0,0,-9.8\n" for i in range(99))
    )
    async with api(tmp_path / "data") as a:
        real = await upload(a, tmp_path / "still.csv")
        found = await ended(a, (await a.post("/gaps", {"real": real, "sim": real}, 202))["id"])
        assert (found["state"], found["report"], found["page"]) == ("failed", None, None)
        assert "given twice" in found["error"]
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


@pytest.mark.long
async def test_a_diagnosis_is_a_job_like_others(tmp_path):
    table = write_table(tmp_path / "real.csv", seconds=10.0)
    async with served(tmp_path / "data") as a:
        real = await upload(a, table)
        job = await a.get(f"/jobs/{(await a.post('/gaps', {'real': real}, 202))['id']}")
        assert (job["kind"], job["vehicle_id"], job["documents"]) == ("gap", None, [])
        assert [g["id"] for g in await a.get("/gaps")] == [job["id"]]
        job = await a.until(job["id"], "succeeded", seconds=60)
        assert [d["name"] for d in job["documents"]] == ["report.json", "report.html"]
        assert job["outcome"]["kind"] == "result"
        page = await a.client.get(f"/{job['documents'][1]['href']}")
        assert page.headers["content-type"].startswith("text/html")
        assert "script-src" not in page.headers["content-security-policy"]
        assert page.text == (await a.client.get(f"/api/v1/gaps/{job['id']}/report.html")).text
        report = await a.client.get(f"/{job['documents'][0]['href']}")
        assert report.json() == (await a.get(f"/gaps/{job['id']}"))["report"]
        await a.get(f"/jobs/{job['id']}/documents/other.txt", 404)
        await a.get(f"/jobs/{job['id']}/plan", 404)
        await a.call("DELETE", f"/api/v1/jobs/{job['id']}", 409)
        events = [data["data"].get("state") for _, _, data in await a.events(f"/jobs/{job['id']}/events", 2)]
        assert events == ["queued", "fitting"]


@pytest.mark.long
async def test_too_many_are_refused_and_a_stopped_service_begins_them_again(tmp_path):
    table = write_table(tmp_path / "real.csv", seconds=10.0)
    async with api(tmp_path / "data") as a:
        real = await upload(a, table)
        for _ in range(MOST_DIAGNOSES):
            await a.post("/gaps", {"real": real}, 202)
        said = await a.post("/gaps", {"real": real}, 429)
        assert said["type"].endswith("gaps-busy")
        for gap in (await a.get("/gaps"))[1:]:
            await a.call("DELETE", f"/api/v1/jobs/{gap['id']}", 200)
        assert [g["state"] for g in await a.get("/gaps")][1:] == ["cancelled"] * (MOST_DIAGNOSES - 1)
    async with api(tmp_path / "data") as a:
        first = (await a.get("/gaps"))[0]
        assert (await ended(a, first["id"]))["state"] == "succeeded"


@pytest.mark.long
async def test_a_diagnosis_that_takes_too_long_is_ended(tmp_path, monkeypatch):
    monkeypatch.setattr("mavcal.service.computations.DIAGNOSE", "tests.service.child_tasks:spin")
    table = write_table(tmp_path / "real.csv")
    async with api(tmp_path / "data", limits=LimitSettings(gap_s=1.05)) as a:
        real = await upload(a, table)
        found = await ended(a, (await a.post("/gaps", {"real": real}, 202))["id"])
        assert found["state"] == "failed"
        assert "1.05 s" in found["error"] or "processor" in found["error"]
