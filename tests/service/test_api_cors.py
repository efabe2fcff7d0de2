"""Pages of other sites: only those of the settings read an answer, and nothing else is loosened for them."""

from __future__ import annotations

from .api_bench import api
from .test_api import keys

GUEST = "https://gcs.example"
EVIL = "https://evil.example"
ASKED = {"Access-Control-Request-Method": "POST", "Access-Control-Request-Headers": "authorization,content-type"}
ALLOW = "access-control-allow-origin"


async def test_without_the_setting_no_page_of_another_site_reads_anything(tmp_path):
    async with api(tmp_path) as a:
        for origin in (GUEST, EVIL):
            answer = await a.client.get("/api/v1/vehicles", headers={"Origin": origin})
            assert ALLOW not in answer.headers
            preflight = await a.client.options("/api/v1/links", headers={"Origin": origin, **ASKED})
            assert ALLOW not in preflight.headers
            assert preflight.status_code == 405


async def test_a_page_of_a_guest_origin_reads_and_asks(tmp_path):
    async with api(tmp_path, cors_origins=(GUEST,)) as a:
        preflight = await a.client.options("/api/v1/links", headers={"Origin": GUEST, **ASKED})
        assert preflight.status_code == 200
        assert preflight.headers[ALLOW] == GUEST
        assert "access-control-allow-credentials" not in preflight.headers
        cross = {"Origin": GUEST, "Sec-Fetch-Site": "cross-site"}
        answer = await a.client.get("/api/v1/vehicles", headers=cross)
        assert (answer.status_code, answer.headers[ALLOW]) == (200, GUEST)
        refused = await a.client.post("/api/v1/links", json={"url": "nonsense"}, headers=cross)
        assert (refused.status_code, refused.headers[ALLOW]) == (422, GUEST)
        assert refused.json()["code"] == "endpoint-unknown"


async def test_another_origin_gains_nothing_by_it(tmp_path):
    async with api(tmp_path, cors_origins=(GUEST,)) as a:
        for origin in (EVIL, "null", "http://gcs.example", f"{GUEST}.evil.example"):
            preflight = await a.client.options("/api/v1/links", headers={"Origin": origin, **ASKED})
            assert preflight.status_code == 400
            assert ALLOW not in preflight.headers
            answer = await a.client.get("/api/v1/vehicles", headers={"Origin": origin})
            assert ALLOW not in answer.headers
            refused = await a.client.post("/api/v1/links", json={"url": "nonsense"}, headers={"Origin": origin})
            assert refused.status_code == 403


async def test_a_guest_needs_a_key_like_everybody(tmp_path):
    async with api(tmp_path, cors_origins=(GUEST,), api_keys=keys()) as a:
        refused = await a.client.get("/api/v1/vehicles", headers={"Origin": GUEST})
        assert (refused.status_code, refused.headers[ALLOW]) == (401, GUEST)
        key = {"Authorization": "Bearer admin"}
        assert (await a.client.get("/api/v1/vehicles", headers={"Origin": GUEST, **key})).status_code == 200
