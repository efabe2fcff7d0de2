"""Links signed with keys of their own, against simulated vehicles that sign."""

from __future__ import annotations

import asyncio
import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from mavcal.service.signing_keys import FILE
from mavcal.service.simvehicle import SimulatedVehicle
from tests.patience import scaled

from .api_bench import Api, api
from .test_api import bearer, keys

BOAT, PLANE = "1a" * 32, "2b" * 32
ROOT = Path(__file__).resolve().parents[2]
pytestmark = pytest.mark.timeout(180)


def vehicle(key: str = "", autopilot: str = "ardupilot", system: int = 1) -> SimulatedVehicle:
    return SimulatedVehicle(
        autopilot, config={"thermal": False, "signing_key": key}, system_id=system, seed=30 + system
    )


async def soon(condition: Callable[[], bool], seconds: float = 20.0) -> None:
    async with asyncio.timeout(scaled(seconds)):
        while not condition():  # noqa: ASYNC110 - of another process
            await asyncio.sleep(0.05)


async def known(a: Api, link: str) -> dict[str, Any]:
    """The identified vehicle of a link."""
    async with asyncio.timeout(scaled(30)):
        while True:
            found = [v for v in await a.get("/vehicles") if v["link"] == link and v["uid"]]
            if found:
                return dict(found[0])
            await asyncio.sleep(0.05)


async def opened(a: Api, url: str, key: str | None = None) -> dict[str, Any]:
    return dict(await a.post("/links", {"url": url if key is None else f"{url}?signing={key}"}, 201))


async def test_two_links_are_signed_with_two_keys_and_neither_key_opens_the_other(tmp_path: Path) -> None:
    with vehicle(BOAT) as boat, vehicle(PLANE, system=2) as plane:
        async with api(tmp_path) as a:
            await a.post("/signing-keys", {"name": "boat", "key": BOAT}, 201)
            await a.post("/signing-keys", {"name": "plane", "key": PLANE}, 201)
            one, two = await opened(a, boat.url, "boat"), await opened(a, plane.url, "plane")
            assert (one["signing_key"], two["signing_key"]) == ("boat", "plane")
            assert (await known(a, one["id"]))["system"] == 1  # it answers only to what is signed with its key
            assert (await known(a, two["id"]))["system"] == 2
            streams = [f"{one['id']}?signing=boat", f"{two['id']}?signing=plane"]
            await soon(lambda: all(a.service.store.signing_timestamp(stream) > 0 for stream in streams))
            await a.delete(f"/links/{two['id']}", 204)
            wrong = await opened(a, plane.url, "boat")
            await asyncio.sleep(scaled(2.0))
            assert wrong["id"] == two["id"]
            assert [v for v in await a.get("/vehicles") if v["link"] == wrong["id"]] == []
            assert a.service.store.signing_timestamp(streams[1]) > 0
        async with api(tmp_path) as later:
            links = {link["id"]: link for link in await later.get("/links")}
            assert links[one["id"]]["signing_key"] == "boat"
            assert (await known(later, one["id"]))["system"] == 1


async def test_a_link_is_never_opened_unsigned_in_place_of_an_unknown_key(tmp_path: Path) -> None:
    with vehicle() as plain:
        async with api(tmp_path) as a:
            refused = await a.post("/links", {"url": f"{plain.url}?signing=boat"}, 404)
            assert refused["code"] == "signing-key-unknown"
            assert await a.get("/links") == []
            assert (await a.post("/links", {"url": f"{plain.url}?signing=none"}, 403))["code"] == "endpoint-refused"
            link = await opened(a, plain.url)
            await a.post("/signing-keys", {"name": "boat"}, 201)
            conflict = await a.post("/links", {"url": f"{plain.url}?signing=boat"}, 409)
            assert conflict["code"] == "link-open"
            assert (await a.get(f"/links/{link['id']}"))["signing_key"] is None


async def test_no_answer_and_no_row_of_the_audit_trail_has_a_key(tmp_path: Path) -> None:
    async with api(tmp_path) as a:
        made = await a.post("/signing-keys", {"name": "boat"}, 201)
        added = await a.post("/signing-keys", {"name": "plane", "key": PLANE}, 201)
        listed = await a.get("/signing-keys")
        await a.post("/signing-keys", {"name": "car", "key": "12" * 31}, 409)
        await a.delete("/signing-keys/plane", 204)
        await a.delete("/signing-keys/plane", 404)
        trail = await a.get("/audit")
        kept = json.loads((tmp_path / FILE).read_text())["keys"]
        assert list(kept) == ["boat"]
        told = json.dumps([made, added, listed, trail])
        assert not any(key in told for key in (PLANE, kept["boat"], "12" * 31))
        done = [(row["action"], row["subject"]) for row in trail["rows"] if row["action"].startswith("signing key")]
        assert done == [("signing key added", "boat"), ("signing key added", "plane"), ("signing key removed", "plane")]
        assert [key["fingerprint"] for key in listed] == [made["fingerprint"], added["fingerprint"]]


async def test_only_an_administrator_reaches_the_keys(tmp_path: Path) -> None:
    async with api(tmp_path, api_keys=keys()) as a:
        for holder in ("read", "operate"):
            await a.get("/signing-keys", 403, headers=bearer(holder))
            for path in ("/signing-keys", "/links/x/signing"):
                refused = await a.call("POST", f"/api/v1{path}", json={"name": "x"}, headers=bearer(holder))
                assert refused["code"] == "not-allowed"
        assert await a.get("/signing-keys", headers=bearer("admin")) == []


async def test_a_link_is_signed_once_the_vehicle_signs_and_stays_so(tmp_path: Path) -> None:
    with vehicle() as sim:
        async with api(tmp_path) as a:
            link = await opened(a, sim.url)
            await a.vehicle()
            await a.post("/signing-keys", {"name": "boat", "key": BOAT}, 201)
            signed = await a.post(f"/links/{link['id']}/signing", {"key": "boat"}, 200)
            assert signed["signing_key"] == "boat"
            assert signed["url"].endswith("?signing=boat")
            assert not (await a.vehicle())["silent"]
            assert (await a.post(f"/links/{link['id']}/signing", {"key": "boat"}, 409))["code"] == "link-open"
            assert (await a.delete("/signing-keys/boat", 409))["code"] == "signing-key-error"
            tlog = a.service.links.get(link["id"]).tlog.path
            told = [row["action"] for row in (await a.get("/audit"))["rows"]]
            assert "signing confirmed" in told
        assert bytes.fromhex(BOAT) not in tlog.read_bytes()  # SETUP_SIGNING carries the key
        async with api(tmp_path) as later:
            (again,) = await later.get("/links")
            assert (again["id"], again["signing_key"]) == (link["id"], "boat")
            assert (await known(later, link["id"]))["uid"]


async def test_a_vehicle_that_does_not_confirm_leaves_the_link_as_it_was(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("mavcal.service.link.link.OFFERS", 2)
    with vehicle(autopilot="px4") as sim:  # this one knows no SETUP_SIGNING
        async with api(tmp_path) as a:
            link = await opened(a, sim.url)
            await a.vehicle()
            await a.post("/signing-keys", {"name": "boat", "key": BOAT}, 201)
            refused = await a.post(f"/links/{link['id']}/signing", {"key": "boat"}, 503)
            assert refused["code"] == "signing-not-confirmed"
            assert (await a.get(f"/links/{link['id']}"))["signing_key"] is None
            assert not (await a.vehicle())["silent"]


async def test_an_armed_vehicle_and_an_empty_link_get_no_key(tmp_path: Path) -> None:
    with vehicle() as sim:
        async with api(tmp_path) as a:
            await a.post("/signing-keys", {"name": "boat", "key": BOAT}, 201)
            empty = await opened(a, "udpin:127.0.0.1:0")
            assert (await a.post(f"/links/{empty['id']}/signing", {"key": "boat"}, 409))["code"] == "signing-key-error"
            link = await opened(a, sim.url)
            found = await a.vehicle()
            sim.call("arm")
            async with asyncio.timeout(scaled(20)):
                while not (await a.get(f"/vehicles/{found['id']}"))["armed"]:  # noqa: ASYNC110
                    await asyncio.sleep(0.05)
            assert (await a.post(f"/links/{link['id']}/signing", {"key": "boat"}, 409))["code"] == "vehicle-armed"
            assert (await a.get(f"/links/{link['id']}"))["signing_key"] is None


def mavcal(*words: str, given: str = "") -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "mavcal", *words]
    return subprocess.run(command, cwd=ROOT, input=given, capture_output=True, text=True, check=False)


@pytest.mark.long
def test_the_command_line_keeps_lists_and_removes_keys_with_a_trace(tmp_path: Path) -> None:
    where = ("--data-dir", str(tmp_path), "--json")
    added = mavcal("config", "signing", "add", "boat", *where, given=f"{BOAT}\n")
    assert added.returncode == 0, added.stderr
    assert BOAT not in added.stdout + added.stderr
    made = json.loads(mavcal("config", "signing", "generate", "plane", *where).stdout)
    listed = json.loads(mavcal("config", "signing", "list", *where).stdout)["signing_keys"]
    assert [key["name"] for key in listed] == ["boat", "plane"]
    assert made["key"] not in json.dumps(listed)
    assert mavcal("config", "signing", "add", "boat", *where, given=f"{PLANE}\n").returncode == 2
    assert mavcal("config", "signing", "remove", "boat", *where).returncode == 0
    audited = json.loads(mavcal("audit", *where).stdout)
    assert (audited["intact"], audited["rows"]) == (True, 3)


async def test_the_command_line_leaves_keys_of_a_running_service_alone(tmp_path: Path) -> None:
    async with api(tmp_path):
        refused = await asyncio.to_thread(
            mavcal, "config", "signing", "generate", "boat", "--data-dir", str(tmp_path), "--json"
        )
        assert refused.returncode == 2
        assert json.loads(refused.stdout)["error"]["code"] == "data-dir-locked"
        assert not (tmp_path / FILE).exists()
