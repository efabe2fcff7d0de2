"""Addresses of the host, problems, links, keys, origins, prefixes and the documents that describe them."""

from __future__ import annotations

import asyncio
import json
import os
import re
import socket
from pathlib import Path
from urllib.parse import urljoin

import pytest
import structlog

from mavcal.service.api.security import digest
from mavcal.service.app import create_app
from mavcal.service.errors import AuthError
from mavcal.service.logs import configure_logging
from mavcal.service.settings import ApiKey

from .api_bench import api, served, settings_in

ROOT = Path(__file__).resolve().parents[2]
SCOPES = ("read", "operate", "write-params", "admin")


@pytest.fixture(autouse=True)
def plain_log():
    """Logging as it was: the tests of one module must not show in another."""
    configure_logging(as_json=False)
    yield
    structlog.reset_defaults()


def keys() -> tuple[ApiKey, ...]:
    """One key for each scope; its text is the scope."""
    return tuple(ApiKey(name=f"{s} key", sha256=digest(s), scopes=frozenset({s})) for s in SCOPES)


def bearer(key: str) -> dict[str, str]:
    return {"Authorization": f"Bearer {key}"}


# --- the host


async def test_the_host_finds_and_watches_the_service(tmp_path):
    async with api(tmp_path) as a:
        assert await a.call("GET", "/healthz", 200) == {"status": "ok"}
        assert await a.call("GET", "/readyz", 200) == {"status": "ready"}
        assert (await a.call("GET", "/info", 200))["name"] == "mavcal"
        found = await a.call("GET", "/register_service", 200)
        assert found["works_in_relative_paths"] is True
        assert not any(str(v).startswith(("/", "http")) for v in found.values())
        metrics = await a.call("GET", "/metrics", 200)
        assert "mavcal_frames_received" in metrics
        await a.post("/links", {"url": "tcp:127.0.0.1:1"}, 201)
        assert 'mavcal_links{state="down"} 1.0' in await a.call("GET", "/metrics", 200)


async def test_a_full_disk_is_not_ready(tmp_path, monkeypatch):
    monkeypatch.setattr("mavcal.service.core.LEAST_FREE_BYTES", 2**62)
    async with api(tmp_path) as a:
        answer = await a.call("GET", "/readyz", 503)
        assert "free some space" in answer["reason"]


async def test_the_page_and_its_files_are_there(tmp_path):
    async with api(tmp_path) as a:
        page = await a.call("GET", "/", 200)
        for name in ("style/base.css", "main.js"):
            assert f'"panel/{name}"' in page
            await a.call("GET", f"/panel/{name}", 200)
        for path in ("/panel/../pyproject.toml", "/panel/%2e%2e/pyproject.toml", "/panel/..%2fpyproject.toml"):
            await a.call("GET", path, 404)


async def test_every_answer_carries_a_policy_that_runs_no_script_of_others(tmp_path):
    async with api(tmp_path) as a:
        for path in ("/", "/docs", "/panel/main.js", "/problems/not-found", "/nothing", "/api/v1/jobs", "/redoc"):
            headers = (await a.client.get(path)).headers
            policy = dict(part.strip().partition(" ")[::2] for part in headers["content-security-policy"].split(";"))
            assert policy["default-src"] == "'self'", path
            assert "script-src" not in policy
            assert policy["frame-ancestors"] == "'self'"
            assert "unsafe" not in headers["content-security-policy"]
            assert headers["x-content-type-options"] == "nosniff"
        await a.call("GET", "/redoc", 404)


async def test_nobody_shows_the_panel_in_a_frame_if_the_settings_say_so(tmp_path):
    for ancestors, said in (((), "'none'"), (("https://gcs.local",), "https://gcs.local")):
        async with api(tmp_path, frame_ancestors=ancestors) as a:
            headers = (await a.client.get("/")).headers
            assert headers["content-security-policy"].endswith(f"frame-ancestors {said}")


async def test_the_documentation_comes_from_this_service_alone(tmp_path):
    async with api(tmp_path) as a:
        page = await a.call("GET", "/docs", 200)
        parts = re.findall(r'(?:src|href)="([^"]+)"', page)
        assert len(parts) == 4
        for part in parts:
            if part != "data:,":
                assert not part.startswith(("/", "http"))
                response = await a.client.get(f"/{part}")
                assert response.status_code == 200
                assert len(response.content) > 100
        assert "<script>" not in page
        assert "openapi.json" in await a.call("GET", "/panel/docs.js", 200)


# --- problems


PROBLEMS = (
    ("GET", "/nothing", 404),
    ("GET", "/api/v1/jobs/x", 404),
    ("GET", "/api/v1/jobs/x/plan", 404),
    ("GET", "/api/v1/jobs/x/events", 404),
    ("GET", "/api/v1/jobs/x/export.param", 404),
    ("DELETE", "/api/v1/jobs/x", 404),
    ("POST", "/api/v1/jobs/x/plan", 404),
    ("POST", "/api/v1/jobs/x/refit", 404),
    ("POST", "/api/v1/jobs/x/revert", 404),
    ("GET", "/api/v1/vehicles/x", 404),
    ("GET", "/api/v1/vehicles/x/parameters", 404),
    ("GET", "/api/v1/vehicles/x/stream", 404),
    ("GET", "/api/v1/vehicles/x/samples", 404),
    ("GET", "/api/v1/vehicles/x/sensors", 404),
    ("GET", "/api/v1/jobs/x/review", 404),
    ("GET", "/api/v1/jobs/x/picture.svg", 404),
    ("GET", "/api/v1/links/x", 404),
    ("DELETE", "/api/v1/links/x", 404),
    ("GET", "/api/v1/recordings/x", 404),
    ("PUT", "/api/v1/links", 405),
    ("POST", "/healthz", 405),
)


async def test_every_problem_has_a_page_that_explains_it(tmp_path):
    async with api(tmp_path) as a:
        for method, path, status in PROBLEMS:
            problem = await a.call(method, path, status)
            page = urljoin(str(a.client.base_url.join(path)), problem["type"])
            assert "/api/" not in page
            assert len(await a.call("GET", page, 200)) > 20


async def test_a_method_that_is_not_there_names_those_that_are(tmp_path):
    async with api(tmp_path) as a:
        assert (await a.client.put("/api/v1/links")).headers["allow"]


async def test_a_defect_is_answered_without_its_trace_which_the_log_has(tmp_path, monkeypatch, capsys):
    configure_logging(as_json=False)  # again, to the captured stream
    async with api(tmp_path) as a:

        def broken() -> None:
            raise RuntimeError(f"secret in {tmp_path}")

        with monkeypatch.context() as patched:
            patched.setattr(a.service.links, "all", broken)
            response = await a.client.get("/api/v1/links")
    assert response.status_code == 500
    problem = response.json()
    assert "secret" not in response.text
    assert problem["request_id"] == response.headers["x-request-id"]
    logged = capsys.readouterr().err
    assert problem["request_id"] in logged
    assert "RuntimeError: secret" in logged
    assert "data_dir=" not in logged  # the values of local variables are not in it: they may be keys


async def test_the_place_of_the_data_is_not_told(tmp_path):
    folder = tmp_path / "data"
    async with api(folder) as a:
        for file in (folder / "tlogs").iterdir() if (folder / "tlogs").exists() else ():
            file.unlink()
        (folder / "tlogs").rmdir() if (folder / "tlogs").exists() else None
        (folder / "tlogs").write_text("not a folder")
        response = await a.client.post("/api/v1/links", json={"url": "tcp:127.0.0.1:1"})
    assert response.status_code == 500
    assert str(tmp_path) not in response.text
    assert "data directory" in response.json()["detail"]


async def test_a_request_too_large_is_refused_before_it_is_kept(tmp_path):
    async with api(tmp_path) as a:
        await a.call("POST", "/api/v1/links", 413, json={"url": "x" * 2**20})


# --- links


async def test_a_link_is_opened_listed_found_and_closed(tmp_path):
    async with api(tmp_path) as a:
        url = "udpin:127.0.0.1:0"
        response = await a.client.post("/api/v1/links", json={"url": url})
        assert response.status_code == 201
        link = response.json()
        where = urljoin("http://127.0.0.1/api/v1/links", response.headers["location"])
        assert (await a.call("GET", where, 200))["id"] == link["id"]
        assert link["state"] == "connecting"
        assert (await a.post("/links", {"url": url}, 201))["id"] == link["id"]  # open already: as it is
        assert [x["url"] for x in await a.get("/links")] == [url]
        await a.delete(f"/links/{link['id']}", 204)
        assert await a.get("/links") == []
        await a.delete(f"/links/{link['id']}", 404)


async def test_links_are_open_again_after_a_restart_unless_they_were_closed(tmp_path):
    async with api(tmp_path) as a:
        await a.post("/links", {"url": "tcp:127.0.0.1:1"}, 201)
        closed = await a.post("/links", {"url": "tcp:127.0.0.1:2"}, 201)
        await a.delete(f"/links/{closed['id']}", 204)
    async with api(tmp_path) as a:
        assert [x["url"] for x in await a.get("/links")] == ["tcp:127.0.0.1:1"]


async def test_two_endpoints_never_share_a_name(tmp_path):
    async with api(tmp_path, links={"allowed": ["loopback", "/dev/not/here", "/dev/not-here"]}) as a:
        urls = ["serial:/dev/not/here:57600", "serial:/dev/not-here:57600", "tcp:127.0.0.1:1", "tcp:[::1]:1"]
        opened = [await a.post("/links", {"url": url}, 201) for url in urls]
        assert len({x["id"] for x in opened}) == len(urls)
        for link in opened:
            assert (await a.get(f"/links/{link['id']}"))["url"] == link["url"]


HOPELESS = (
    "",
    "ftp:127.0.0.1:1",
    "udpin",
    "tcp:127.0.0.1:99999",
    "udpout:127.0.0.1:99?local_port=nan",
    "udpout:127.0.0.1:99?local_port=1e9",
    "file:x\0y",
    "file:" + "x" * 5000,
    "sim:betaflight",
    "sim:ardupilot?colour=red",
)


REFUSED = (
    "udpin:no.such.host.invalid:5000",
    "tcp:" + "a" * 300 + ":80",
    "tcp:8.8.8.8:80",
    "serial:/dev/zero:57600",
    "sim:ardupilot?params=/etc/passwd",
    "file:/dev/zero",
    "file:/etc/passwd",
    "file:/no/such/file.tlog",
    f"file:{os.path.relpath(__file__)}",  # relative: no answer may name a place that the request did not
    "file:x?speed=nan",
)


async def test_an_endpoint_that_may_not_be_opened_is_403_and_tells_of_no_file(tmp_path):
    async with api(tmp_path) as a:
        told = set()
        for url in REFUSED:
            problem = await a.post_text("/links", {"url": url}, 403)
            assert problem["type"].endswith("endpoint-refused"), problem
            if url.startswith("file:"):
                told.add(problem["detail"])
        assert len(told) == 1
        assert await a.get("/links") == []


async def test_a_recording_of_this_service_may_be_replayed(tmp_path):
    async with api(tmp_path) as a:
        folder = a.service.settings.data_dir / "tlogs"
        folder.mkdir(exist_ok=True)
        (folder / "a.tlog").write_bytes(b"none")
        problem = await a.post("/links", {"url": f"file:{folder / 'a.tlog'}"}, 422)
        assert "no MAVLink frame" in problem["detail"]


async def test_an_endpoint_that_cannot_work_is_422(tmp_path):
    async with api(tmp_path) as a:
        for url in HOPELESS:
            problem = await a.post_text("/links", {"url": url}, 422)
            assert problem["type"].endswith("endpoint-unknown"), problem
        assert await a.get("/links") == []


async def test_a_busy_port_is_409_with_the_remedy(tmp_path):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        async with api(tmp_path) as a:
            url = f"udpin:127.0.0.1:{taken.getsockname()[1]}"
            problem = await a.post("/links", {"url": url}, 409)
            assert "port-busy" in problem["type"]
            assert await a.get("/links") == []


async def test_events_tell_of_links_and_answer_at_once(tmp_path):
    async with served(tmp_path) as a:
        await a.post("/links", {"url": "tcp:127.0.0.1:1"}, 201)
        ((_, name, data),) = await a.events("/events", 1)
        assert (name, data["state"]) == ("link", "down")


# --- keys and origins


WRITES = ("/api/v1/jobs/x/apply", "/api/v1/jobs/x/revert")
OPERATIONS = ("/api/v1/links", "/api/v1/vehicles/x/jobs", "/api/v1/jobs/x/answers", "/api/v1/recordings?name=a.csv")


async def test_without_a_key_nothing_is_told(tmp_path):
    app = create_app(settings_in(tmp_path, api_keys=keys()))
    paths = [(m, r.path) for r in app.routes for m in getattr(r, "methods", None) or () if hasattr(r, "dependant")]
    spec = app.openapi()["paths"]
    open_to_all = {("GET", p) for p in ("/healthz", "/readyz", "/register_service", "/problems/{code}", "/", "/docs")}
    asked = {(m.upper(), p) for p, ms in spec.items() for m in ms} | set(paths)
    assert len(asked) > 25
    async with api(tmp_path, api_keys=keys()) as a:
        for method, path in sorted(asked):
            if (method, path) not in open_to_all:
                problem = await a.call(method, path.replace("{", "").replace("}", ""), 401)
                assert problem["type"].endswith("authentication-required")


@pytest.mark.parametrize("key", SCOPES)
async def test_a_key_does_what_its_scope_says_and_no_more(tmp_path, key):
    async with api(tmp_path, api_keys=keys(), headers=bearer(key)) as a:
        assert (await a.client.get("/api/v1/jobs")).status_code == (200 if key in {"read", "admin"} else 403)
        for path in OPERATIONS:
            status = (await a.client.post(path)).status_code
            assert (status == 403) == (key not in {"operate", "admin"}), (path, status)
        for path in WRITES:
            status = (await a.client.post(path, json={"plan_sha256": "0" * 64})).status_code
            assert (status == 403) == (key not in {"write-params", "admin"}), (path, status)


@pytest.mark.parametrize("value", ["Bearer wrong", "Bearer ", "Basic read", "read", ""])
async def test_a_wrong_key_is_401(tmp_path, value):
    async with api(tmp_path, api_keys=keys(), headers={"Authorization": value}) as a:
        await a.get("/jobs", 401)


async def test_a_ticket_opens_one_stream_and_nothing_else(tmp_path):
    async with served(tmp_path, api_keys=keys()) as a:
        await a.call("POST", "/api/v1/tickets", 401)
        await a.post("/links", {"url": "tcp:127.0.0.1:1"}, 201, headers=bearer("admin"))
        ticket = (await a.call("POST", "/api/v1/tickets", 201, headers=bearer("admin")))["ticket"]
        await a.call("POST", f"/api/v1/links?ticket={ticket}", 401, json={"url": "tcp:127.0.0.1:2"})
        ((_, name, _),) = await a.events(f"/events?ticket={ticket}", 1)
        assert name == "link"
        await a.call("GET", f"/api/v1/events?ticket={ticket}", 401)


async def test_without_keys_a_ticket_is_empty(tmp_path):
    async with api(tmp_path) as a:
        assert (await a.call("POST", "/api/v1/tickets", 201))["ticket"] == ""


@pytest.mark.parametrize(
    "headers",
    [
        {"Host": "evil.example"},
        {"Origin": "https://evil.example"},
        {"Origin": "http://127.0.0.1:8766"},
        {"Origin": "null"},
        {"Sec-Fetch-Site": "cross-site"},
        {"Sec-Fetch-Site": "same-site"},
    ],
)
async def test_a_page_from_elsewhere_changes_nothing(tmp_path, headers):
    async with api(tmp_path) as a:
        await a.call("POST", "/api/v1/links", 403, json={"url": "tcp:127.0.0.1:1"}, headers=headers)
        upload = {"params": {"name": "a.csv"}, "content": b"mag_x,mag_y,mag_z\n1,2,3\n4,5,7\n"}
        await a.call("POST", "/api/v1/recordings", 403, headers=headers, **upload)
        assert await a.get("/recordings") == []
        assert await a.get("/links") == []


async def test_a_name_that_was_allowed_is_answered(tmp_path):
    async with api(tmp_path, allowed_hosts=("blueos.local",)) as a:
        await a.call("GET", "/healthz", 200, headers={"Host": "blueos.local:8080"})
        await a.call("GET", "/healthz", 403, headers={"Host": "other.local:8080"})


def test_beyond_loopback_without_keys_there_is_no_service(tmp_path):
    with pytest.raises(AuthError, match="mavcal config key"):
        create_app(settings_in(tmp_path, host="0.0.0.0"))


# --- behind a prefix, and the document


async def test_it_works_behind_a_path_prefix_it_does_not_know(tmp_path):
    async with served(tmp_path, prefix="/extension/mavcal") as a:
        root = str(a.client.base_url)
        page = (await a.client.get("/")).text
        assert 'href="/' not in page
        assert 'src="/' not in page
        opened = await a.client.post("/api/v1/links", json={"url": "tcp:127.0.0.1:1"})
        where = urljoin(str(opened.url), opened.headers["location"])
        assert where.startswith(root)
        assert (await a.client.get(where)).json()["url"] == "tcp:127.0.0.1:1"
        missing = await a.client.get("/api/v1/jobs/x/plan")
        explained = urljoin(str(missing.url), missing.json()["type"])
        assert (await a.client.get(explained)).status_code == 200
        docs = (await a.client.get("/docs")).text
        assert 'href="/' not in docs
        assert 'src="/' not in docs
        servers = (await a.client.get("/openapi.json")).json()["servers"]
        assert urljoin(urljoin(root, "openapi.json"), servers[0]["url"]) == root
        assert (await a.client.get("/panel")).status_code in {200, 404}  # never a redirect to an absolute address


def test_the_document_in_the_repository_is_that_of_the_code(tmp_path):
    kept = (ROOT / "docs" / "openapi.json").read_text()
    made = json.dumps(create_app(settings_in(tmp_path)).openapi(), indent=1, ensure_ascii=False)
    assert kept == f"{made}\n", "run scripts/openapi"


async def test_one_process_owns_a_data_directory(tmp_path):
    async with api(tmp_path) as a:
        with pytest.raises(Exception, match="--data-dir"):
            async with api(tmp_path):
                pass
        await a.call("GET", "/healthz", 200)
        await asyncio.sleep(0)
