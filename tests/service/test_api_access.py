"""Failed logins, bodies that nobody reads, and the audit trail."""

from __future__ import annotations

import asyncio
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import structlog

from mavcal.service.api.security import FAILURES_AT_ONCE
from mavcal.service.app import create_app
from mavcal.service.jobs.core.codec import row_from_job
from mavcal.service.jobs.core.model import Job
from mavcal.service.jobs.core.states import JobState
from mavcal.service.store import SqliteStore
from tests.patience import scaled

from .api_bench import api, served, settings_in
from .test_api import bearer, keys

CSV = b"mag_x,mag_y,mag_z\n1,2,3\n4,5,7\n"


async def test_wrong_keys_are_throttled_and_logged_and_no_key_is_no_guess(tmp_path: Path) -> None:
    async with api(tmp_path, api_keys=keys()) as a:
        for _ in range(3 * FAILURES_AT_ONCE):
            await a.get("/jobs", 401)  # a panel that has not been given its key
        with structlog.testing.capture_logs() as logs:
            for i in range(FAILURES_AT_ONCE):
                await a.get("/jobs", 401, headers=bearer(f"guess {i}"))
            response = await a.client.get("/api/v1/jobs", headers=bearer("admin"))  # the right one is not looked at
            assert response.status_code == 429
            assert 0 < int(response.headers["retry-after"]) <= 6
            assert response.json()["type"].endswith("too-many-attempts")
            await a.get("/jobs", 429, headers=bearer("guess"))
        failed = [e for e in logs if e["event"] == "login failed"]
        assert len(failed) == FAILURES_AT_ONCE
        assert failed[0]["peer"] == "127.0.0.1"
        assert "guess" not in json.dumps(logs)
        assert sum(e["event"] == "logins throttled" for e in logs) == 1


async def test_the_body_is_not_read_before_the_key_is_checked(tmp_path: Path) -> None:
    async with served(tmp_path, api_keys=keys()) as a:
        port = a.client.base_url.port
        for path in ("/api/v1/recordings?name=a.csv", "/api/v1/links", "/api/v1/gaps", "/healthz"):
            for key in ("", "Authorization: Bearer wrong\r\n"):
                reader, writer = await asyncio.open_connection("127.0.0.1", port)
                head = f"POST {path} HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nContent-Length: {2**30}\r\n{key}\r\n"
                writer.write(head.encode())
                async with asyncio.timeout(scaled(20)):
                    answer = await reader.read()  # to the end: nothing was sent of the body, and the service hangs up
                assert answer.startswith(b"HTTP/1.1 401"), answer
                writer.close()
        assert not (tmp_path / "recordings").exists()


async def test_a_key_that_may_not_upload_is_refused_before_its_body_is_read(tmp_path: Path) -> None:
    async with served(tmp_path, api_keys=keys()) as a:
        port = a.client.base_url.port
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        head = f"POST /api/v1/recordings?name=a.csv HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\n"
        writer.write(f"{head}Content-Length: {2**30}\r\nAuthorization: Bearer read\r\n\r\n".encode())
        async with asyncio.timeout(scaled(20)):
            assert (await reader.read()).startswith(b"HTTP/1.1 403")
        writer.close()


def changes(tmp_path: Path) -> list[tuple[str, str]]:
    """Every operation that may change something, from the document; test_api_jobs looks at writes to a vehicle.

    Turning a simulated vehicle changes nothing real.
    """
    paths = create_app(settings_in(tmp_path)).openapi()["paths"]
    return sorted(
        (method.upper(), path)
        for path, methods in paths.items()
        for method in methods
        if method != "get" and not path.endswith(("/tickets", "/apply", "/revert", "/turns"))
    )


BODIES: dict[str, Any] = {
    "/api/v1/links": {"url": "tcp:127.0.0.1:1"},
    "/answers": {"value": "finish"},
    "/fits": {"method": "mag-sphere"},
    "/gaps": {"real": "r1"},
    "/recordings/{recording_id}/jobs": {"method": "mag-sphere", "vehicle_id": "v"},
    "/vehicles/{vehicle_id}/jobs": {"kind": "gyro"},
}


async def test_every_request_for_a_change_is_in_the_trail_with_who_asked(tmp_path: Path) -> None:
    async with api(tmp_path, api_keys=keys(), headers=bearer("admin")) as a:
        asked = changes(tmp_path)
        assert len(asked) >= 10
        for number, (method, path) in enumerate(asked, 1):
            filled = path.replace("{", "").replace("}", "")
            body = next((b for end, b in BODIES.items() if path.endswith(end)), {})
            if path.endswith("/recordings"):
                await a.call(method, filled, 201, params={"name": "a.csv"}, content=CSV)
            else:
                await a.call(method, filled, json=body)
            newest = (await a.get("/audit", params={"limit": 1000}))["rows"][-1]
            assert newest["id"] == number, (method, path)
            assert newest["actor"] == "admin key"
            assert newest["detail"]["request"] == f"{method} {filled}"
        rows = (await a.get("/audit"))["rows"]
        opened = next(r for r in rows if r["action"] == "open link")
        assert "tcp:127.0.0.1:1" in opened["detail"]["body"]
        assert next(r for r in rows if r["action"] == "cancel")["subject"] == "job_id"
        assert "4,5,7" not in json.dumps(rows)
        check = await a.get("/audit/check")
        assert check["intact"] is True
        assert check["head"] == rows[-1]["sha256"]
        assert check["rows"] == len(asked)


async def test_what_is_refused_or_only_read_is_not_in_the_trail(tmp_path: Path) -> None:
    async with api(tmp_path, api_keys=keys()) as a:
        await a.post("/links", {"url": "tcp:127.0.0.1:1"}, 401)
        await a.post("/links", {"url": "tcp:127.0.0.1:1"}, 403, headers=bearer("read"))
        await a.post("/links", {"url": "tcp:127.0.0.1:1"}, 403, headers={**bearer("admin"), "Origin": "http://x"})
        await a.get("/links", headers=bearer("read"))
        for key in ("read", "operate", "write-params"):
            await a.get("/audit", 403, headers=bearer(key))
        assert (await a.get("/audit", headers=bearer("admin")))["rows"] == []


async def test_the_trail_is_read_a_page_at_a_time(tmp_path: Path) -> None:
    async with api(tmp_path) as a:
        for i in range(5):
            await a.delete(f"/links/l{i}", 404)
        seen, after = [], 0
        while after is not None:
            page = await a.get("/audit", params={"after": after, "limit": 2})
            seen += [r["subject"] for r in page["rows"]]
            after = page["next"]
        assert seen == [f"l{i}" for i in range(5)]
        await a.get("/audit", 422, params={"limit": 0})


async def test_odd_requests_are_kept_as_text(tmp_path: Path) -> None:
    async with api(tmp_path) as a:
        await a.call("DELETE", "/api/v1/links/%ff%00%ed%a0%80", 404)
        await a.post_text("/links", {"url": float("nan"), "x": "\ud800" * 5000}, 422)
        rows = (await a.get("/audit"))["rows"]
        assert all(len(json.dumps(r)) < 20_000 for r in rows)
        assert (await a.get("/audit/check"))["intact"] is True


async def test_a_full_disk_keeps_changes_from_being_made_but_not_from_being_ended(tmp_path: Path) -> None:
    async with api(tmp_path) as a:
        store = a.service.store
        assert isinstance(store, SqliteStore)
        store._db.execute(f"PRAGMA max_page_count = {store._db.execute('PRAGMA page_count').fetchone()[0]}")
        status = 0
        for i in range(200):  # what is left of the last page is used up first
            status = (await a.client.post("/api/v1/links", json={"url": f"bad:{i}" + "x" * 900})).status_code
            if status == 507:
                break
        assert status == 507
        await a.delete("/links/none", 404)


def test_the_command_line_checks_the_trail(tmp_path: Path) -> None:
    store = SqliteStore(tmp_path)
    store.add_audit(1.0, "a", "apply", "j1", {})
    command = [sys.executable, "-m", "mavcal", "audit", "--json", "--data-dir", str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, check=True, env={**os.environ})  # while it is owned
    assert json.loads(done.stdout)["intact"] is True
    store._db.executescript("DROP TRIGGER audit_is_append_only; UPDATE audit SET actor = 'b'")
    store.close()
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert json.loads(done.stdout)["broken_at"] == 1


@pytest.mark.parametrize("ticket", ["", "guess"])
async def test_guessed_tickets_are_throttled_too(tmp_path: Path, ticket: str) -> None:
    async with api(tmp_path, api_keys=keys()) as a:
        for _ in range(FAILURES_AT_ONCE):
            await a.get("/jobs", 401, params={"ticket": ticket})
        await a.get("/jobs", 429, params={"ticket": ticket})


async def test_jobs_are_listed_a_page_at_a_time(tmp_path: Path) -> None:
    store = SqliteStore(tmp_path)
    for i in range(5):
        job = Job(f"j{i}", "v 1" if i else "other", "gyro", {}, JobState.FAILED, float(i), float(i))
        store.save_job(row_from_job(job))
    store.close()
    async with api(tmp_path) as a:
        assert [j["id"] for j in await a.get("/jobs")] == [f"j{i}" for i in range(5)]
        for order, expected in (("oldest", ["j1", "j2", "j3", "j4"]), ("newest", ["j4", "j3", "j2", "j1"])):
            url, seen = f"/api/v1/jobs?vehicle_id=v%201&limit=3&order={order}", []
            while url:
                response = await a.client.get(url)
                seen += [j["id"] for j in response.json()]
                url = str(response.url.join(response.links["next"]["url"])) if "next" in response.links else ""
            assert seen == expected
        assert [j["id"] for j in await a.get("/jobs", params={"state": "failed", "limit": 2})] == ["j0", "j1"]
        assert await a.get("/jobs", params={"state": "review"}) == []
        await a.get("/jobs", 422, params={"state": "done"})
        await a.get("/jobs", 404, params={"after": "nothing"})
        await a.get("/jobs", 422, params={"limit": 0})
