"""The fleet over REST and on the command line: two simulated vehicles, each with a calibration of its own."""

from __future__ import annotations

import asyncio
import csv
import io
import json
import subprocess
import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from mavcal.service.api.security import digest
from mavcal.service.settings import ApiKey
from mavcal.service.simvehicle import SimulatedVehicle
from tests.patience import scaled

from .api_bench import Api, Json, api, served
from .jobs_bench import SPEED, zero_gyro_offsets

GYRO = {"kind": "gyro", "options": {"uncertainty": 0.02}}


ITS_OWN_HANDS_OFF = {"parameters": {"IMU_GYRO_CAL_EN": 0.0}}
"""A PX4 that leaves its gyroscopes as they were calibrated."""


@pytest.fixture
def sims() -> Iterator[tuple[SimulatedVehicle, SimulatedVehicle]]:
    with (
        SimulatedVehicle("ardupilot", speed=SPEED, seed=31, config={"thermal": False}) as one,
        SimulatedVehicle("px4", speed=SPEED, seed=32, config={"thermal": False, **ITS_OWN_HANDS_OFF}) as other,
    ):
        zero_gyro_offsets(one)
        yield one, other


async def vehicles(a: Api, count: int) -> list[Json]:
    """All of them in the order of their links, as soon as each is identified and may be written to."""
    found: list[Json] = []
    async with asyncio.timeout(scaled(30)):
        while len(found) < count:
            found = [v for v in await a.get("/vehicles") if v["uid"] and v["writable"]]
            await asyncio.sleep(0.05)
    return sorted(found, key=lambda v: str(v["link"]))


async def calibrated(a: Api, vehicle: Json) -> Json:
    job = await a.post(f"/vehicles/{vehicle['id']}/jobs", GYRO, 202)
    job = await a.until(job["id"], "review", seconds=60)
    body = {"plan_sha256": job["plan"]["sha256"], "prove_s": 0, "reboot": True}
    await a.post(f"/jobs/{job['id']}/apply", body, 202)
    return await a.until(job["id"], "succeeded", seconds=60)


async def unit_of(a: Api, vehicle: Json, condition: str = "sensors") -> Json:
    """Its row once what is waited for is in it."""
    async with asyncio.timeout(scaled(15)):
        while not (row := await a.get(f"/fleet/{vehicle['id']}"))[condition]:  # noqa: ASYNC110
            await asyncio.sleep(0.05)
    return dict(row)


def fleet(*arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "mavcal", "fleet", *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=scaled(120), check=False)


async def asked(*arguments: str) -> subprocess.CompletedProcess[str]:
    return await asyncio.to_thread(fleet, *arguments)


@pytest.mark.long
async def test_two_vehicles_with_a_calibration_each(
    tmp_path: Path, sims: tuple[SimulatedVehicle, SimulatedVehicle]
) -> None:
    async with served(tmp_path, connect=tuple(sim.url for sim in sims)) as a:
        found = await vehicles(a, 2)
        assert {row["unit"] for row in await a.get("/fleet")} == {v["id"] for v in found}
        assert [row["needs_recalibration"] for row in await a.get("/fleet")] == [True, True]
        jobs = [await calibrated(a, vehicle) for vehicle in found]
        for vehicle, job in zip(found, jobs, strict=True):
            row = await unit_of(a, vehicle)
            gyros = [s for s in row["sensors"] if s["sensor"] == "gyro"]
            assert gyros
            applied = {(c["sensor"], c["instance"]) for c in job["plan"]["changes"]} | {
                (g["sensor"], g["instance"]) for g in job["plan"]["agreements"]
            }
            for sensor in gyros:
                assert (sensor["sensor"], sensor["instance"]) in applied
                assert sensor["job_id"] == job["id"]
                assert sensor["device_id"]
                assert sensor["type"] in ("SITL", "simulated")
                assert sensor["age_days"] < 1.0
                assert sensor["drift"]["unit"] == "deg/s"
                assert sensor["drift"]["open"][0]["quantity"] == "time"
                offset = job["results"][sensor["instance"]]["model"]["offset"]
                assert sensor["bias"] == pytest.approx([57.29578 * x for x in offset], rel=1e-5)
            assert row["connected"]
            assert row["firmware"]
        await names_and_tags(a, found)
        await preflights(a, found)
        await lists(a, found)
        await command_line(a, tmp_path, found)
        await taken_back(a, found[0], jobs[0])


async def names_and_tags(a: Api, found: list[Json]) -> None:
    for vehicle, name, tag in zip(found, ("Heron", "Albatross"), ("boats", "planes"), strict=True):
        row = await a.call("PATCH", f"/api/v1/fleet/{vehicle['id']}", 200, json={"name": name, "tags": [tag]})
        assert (row["name"], row["tags"]) == (name, [tag])
    row = await a.call("PATCH", f"/api/v1/fleet/{found[0]['id']}", 200, json={"tags": ["boats", "lake", "boats"]})
    assert (row["name"], row["tags"]) == ("Heron", ["boats", "lake"])
    for bad in ({}, {"tags": ["a b"]}, {"tags": ["-x"]}, {"name": "x" * 81}, {"name": "a\nb"}, {"unit": "x"}):
        await a.call("PATCH", f"/api/v1/fleet/{found[0]['id']}", 422, json=bad)
    await a.call("PATCH", "/api/v1/fleet/uid-none", 404, json={"name": "x"})
    noted = [r for r in (await a.get("/audit"))["rows"] if r["action"] == "change"]
    assert noted[0]["subject"] == found[0]["id"]
    assert "Heron" in noted[0]["detail"]["body"]


async def preflights(a: Api, found: list[Json]) -> None:
    told = await a.post(f"/vehicles/{found[0]['id']}/preflight", {}, 200)
    row = await unit_of(a, found[0], "preflight")
    assert (row["preflight"]["verdict"], row["preflight"]["summary"]) == (told["verdict"], told["summary"])
    assert 0.0 <= row["preflight"]["age_s"] < 600.0
    passed = {c["id"] for c in told["checks"] if c["verdict"] == "pass"}
    assert not passed & {check["id"] for check in row["preflight"]["failed"]}
    history = await a.get(f"/fleet/{found[0]['id']}/history")
    rest = [r for r in history["records"] if r["source"] == "preflight"]
    assert {r["sensor"] for r in rest} == {"gyro", "accel"}
    assert all(9.0 < r["norm"] < 10.6 for r in rest if r["sensor"] == "accel")
    jobs = [r for r in history["records"] if r["source"] == "job" and r["sensor"] == "gyro"]
    by_place = {(r["instance"], r["device_id"]): r["bias"] for r in jobs}
    for one in (r for r in rest if r["sensor"] == "gyro"):  # raw under other offsets, and yet the same bias
        assert one["bias"] == pytest.approx(by_place[one["instance"], one["device_id"]], abs=0.05)
    assert history["unit"]["unit"] == found[0]["id"]


async def lists(a: Api, found: list[Json]) -> None:
    boat, plane = (v["id"] for v in found)

    async def of(**query: Any) -> list[str]:
        return [row["unit"] for row in await a.get("/fleet", params=query)]

    assert await of() == [plane, boat]
    assert await of(descending="true") == [boat, plane]
    assert await of(tag="boats") == [boat]
    assert await of(verdict="none") == [plane]
    assert await of(verdict=["pass", "warn", "fail", "unknown"]) == [boat]
    assert await of(sensor="gyro", min_age_days=0) == [plane, boat]
    assert await of(min_age_days=30) == [boat]  # its accelerometers were never calibrated
    assert await of(sensor="ICM-42688") == []
    assert await of(odd="true") == []
    await a.get("/fleet", 422, params={"order": "colour"})
    await a.get("/fleet", 404, params={"after": "uid-none"})
    first = await a.client.get("/api/v1/fleet", params={"limit": 1, "order": "age", "tag": "boats"})
    assert "Link" not in first.headers
    first = await a.client.get("/api/v1/fleet", params={"limit": 1, "min_age_days": 0})
    link = first.headers["Link"]
    assert link.endswith('; rel="next"')
    after = await a.client.get(str(first.url.join(link[1 : link.index(">")])))
    assert [row["unit"] for row in after.json()] == [boat]
    needing = await a.get("/fleet", params={"needs_recalibration": "true"})
    assert all(row["reasons"] and all(reason["text"] for reason in row["reasons"]) for row in needing)
    table = await a.client.get("/api/v1/fleet.csv", params={"tag": "boats"})
    assert table.headers["content-type"].startswith("text/csv")
    (row,) = csv.DictReader(io.StringIO(table.text))
    assert (row["unit"], row["name"], row["tags"], row["connected"]) == (boat, "Heron", "boats lake", "yes")


async def command_line(a: Api, folder: Path, found: list[Json]) -> None:
    """Beside the running service, and through it."""
    place, url = ("--data-dir", str(folder)), ("--url", str(a.client.base_url))
    boat = found[0]["id"]
    for where in (place, url):
        told = json.loads((await asked(*where, "--json")).stdout)
        assert [u["name"] for u in told["units"]] == ["Albatross", "Heron"]
        assert (await asked(*where, "--tag", "boats", "--csv")).stdout.startswith("unit,name,tags")
        shown = (await asked(*where, "--needs-recalibration")).stdout
        assert "Heron: No verified calibration of accelerometer 1" in shown
    refused = await asked(*place, "tag", boat, "--add", "x")
    assert refused.returncode == 2
    assert "--url" in refused.stderr
    done = await asked(*url, "tag", boat, "--add", "pond", "--remove", "lake")
    assert done.stdout.strip() == f"{boat}: Heron; tags: boats pond"
    done = await asked("name", boat, "Grey Heron", *url)
    assert done.stdout.startswith(f"{boat}: Grey Heron")
    assert (await asked(*url, "name", "uid-none", "x")).returncode == 1
    assert (await asked(*url, *place)).returncode == 2
    assert (await asked("--url", "http://127.0.0.1:1", "--json")).returncode == 1


async def taken_back(a: Api, vehicle: Json, job: Json) -> None:
    """A calibration that was taken back is none."""
    await a.vehicle()
    await a.post(f"/jobs/{job['id']}/revert", expect=202)
    async with asyncio.timeout(scaled(60)):
        while (await a.get(f"/jobs/{job['id']}"))["state"] != "reverted":  # noqa: ASYNC110
            await asyncio.sleep(0.05)
        while "job" in {r["source"] for r in (await a.get(f"/fleet/{vehicle['id']}/history"))["records"]}:  # noqa: ASYNC110
            await asyncio.sleep(0.05)
    row = await a.get(f"/fleet/{vehicle['id']}")
    assert row["tags"] == ["boats", "pond"]
    assert "never" in {reason["code"] for reason in row["reasons"]}


@pytest.mark.long
async def test_a_start_takes_up_what_was_left_out(
    tmp_path: Path, sims: tuple[SimulatedVehicle, SimulatedVehicle]
) -> None:
    """A store of before there was a fleet, or a crash between the end of a job and its record."""
    async with served(tmp_path, connect=(sims[0].url,)) as a:
        (vehicle,) = await vehicles(a, 1)
        job = await calibrated(a, vehicle)
        await unit_of(a, vehicle)
        await a.service.store.do(lambda: a.service.store.drop_sensor_records(job["id"]))
        assert (await a.get(f"/fleet/{vehicle['id']}"))["sensors"] == []
    async with api(tmp_path) as a:
        row = await unit_of(a, vehicle)
        assert {s["job_id"] for s in row["sensors"]} == {job["id"]}
        assert (row["connected"], row["silent"], row["autopilot"]) == (False, None, "ardupilot")
        assert row["firmware"]
    done = fleet("--data-dir", str(tmp_path), "tag", vehicle["id"], "--add", "lake", "--json")
    assert json.loads(done.stdout)["tags"] == ["lake"]
    assert fleet("--data-dir", str(tmp_path), "tag", vehicle["id"], "--add", "a b").returncode == 2
    assert fleet("--data-dir", str(tmp_path), "tag", "uid-none", "--add", "x").returncode == 1
    async with api(tmp_path) as a:
        newest = (await a.get("/audit"))["rows"][-1]
        assert (newest["actor"], newest["action"], newest["subject"]) == ("command line", "change unit", vehicle["id"])


# --- keys that are bound to tags


def bound(name: str, *scopes: Any, tags: frozenset[str] = frozenset()) -> ApiKey:
    return ApiKey(name=name, sha256=digest(name), scopes=frozenset(scopes), tags=tags)


KEYS = (
    bound("all", "admin"),
    bound("boats", "read", "operate", "write-params", tags=frozenset({"boats"})),
    bound("nothing", "read", tags=frozenset({"unused"})),
)
BODIES: dict[str, Any] = {
    "/apply": {"plan_sha256": "a" * 64},
    "/answers": {"value": "finish"},
    "/jobs": {"kind": "gyro", "method": "mag-sphere", "vehicle_id": "v"},
    "/{unit_id}": {"name": "x"},
    "/recordings/{recording_id}/fits": {"method": "mag-sphere"},
    "/links": {"url": "tcp:127.0.0.1:1"},
    "/gaps": {"real": "r1"},
    "/fits": {"method": "mag-sphere", "recording": "r1"},
}
ABSENT = {"vehicle_id": "uid-0", "unit_id": "uid-0", "job_id": "j0", "gap_id": "j0", "recording_id": "r0",
          "link_id": "l0", "name": "n", "form": "json", "code": "x"}  # fmt: skip


def key(name: str) -> dict[str, Any]:
    return {"headers": {"Authorization": f"Bearer {name}"}}


async def test_a_key_that_is_bound_to_tags_sees_and_touches_its_vehicles_alone(
    tmp_path: Path, sims: tuple[SimulatedVehicle, SimulatedVehicle]
) -> None:
    async with served(tmp_path, connect=tuple(sim.url for sim in sims), api_keys=KEYS) as a:
        a.client.headers["Authorization"] = "Bearer all"
        boat, plane = await vehicles(a, 2)
        await a.call("PATCH", f"/api/v1/fleet/{boat['id']}", 200, json={"tags": ["boats"]})
        await a.call("PATCH", f"/api/v1/fleet/{plane['id']}", 200, json={"tags": ["planes"]})
        ours = await a.post(f"/vehicles/{boat['id']}/jobs", GYRO, 202)
        theirs = await a.post(f"/vehicles/{plane['id']}/jobs", GYRO, 202)
        upload = await a.call(
            "POST", "/api/v1/recordings", 201, params={"name": "a.csv"}, content=b"mag_x,mag_y,mag_z\n1,2,3\n4,5,7\n"
        )
        fit = await a.post("/fits", {"method": "mag-sphere", "recording": upload["id"]}, 202)
        for job in (ours, theirs):
            await a.until(job["id"], "review", "succeeded", seconds=60)
        seen = {"vehicle_id": boat["id"], "unit_id": boat["id"], "job_id": ours["id"], "link_id": boat["link"]}
        hidden = {"vehicle_id": plane["id"], "unit_id": plane["id"], "job_id": theirs["id"], "gap_id": theirs["id"],
                  "recording_id": upload["id"], "link_id": plane["link"]}  # fmt: skip
        await addresses(a, seen, hidden)
        await a.get(f"/jobs/{fit['id']}", 404, **key("boats"))
        await a.get(f"/vehicles/{plane['link']}-1-1", 404, **key("boats"))  # its other name
        await by_list(a, boat, ours)
        await by_stream(a, boat, plane, ours, theirs)
        await refused(a, boat, upload)
        await a.call("PATCH", f"/api/v1/fleet/{boat['id']}", 200, json={"tags": []})
        await a.get(f"/vehicles/{boat['id']}", 404, **key("boats"))  # from the next request on
        assert await a.get("/vehicles", **key("boats")) == []


async def addresses(a: Api, seen: Json, hidden: Json) -> None:
    """Every address of the document that names something: what is hidden answers as what is not there."""
    paths = a.service and (await a.call("GET", "/openapi.json", 200))["paths"]
    tried = set()
    for path, methods in paths.items():
        kinds = [kind for kind in hidden if f"{{{kind}}}" in path]
        if not kinds or path.endswith(("/stream", "/events", "/samples")):
            continue
        body = next((b for end, b in BODIES.items() if path.endswith(end)), {})
        for method in methods:
            tried.add(kinds[0])
            what = {"json": body} if method in ("post", "patch") else {}
            bad = path.format(**{**ABSENT, **hidden})
            none = path.format(**ABSENT)
            if "signing" in path:  # keys for links belong to whoever runs the service
                continue
            answer = await a.call(method.upper(), bad, 404, **what, **key("boats"))
            absent = await a.call(method.upper(), none, 404, **what, **key("boats"))
            assert (answer["code"], answer["title"]) == (absent["code"], absent["title"]), path
            told = answer["detail"].replace(hidden[kinds[0]], "X")
            assert told == absent["detail"].replace(ABSENT[kinds[0]], "X"), path
            if (
                method == "get"
                and kinds[0] in seen
                and not any(word in path for word in ("documents", "export", "items.", "picture"))
            ):
                await a.call("GET", path.format(**{**ABSENT, **seen}), 200, **key("boats"))
    assert tried == set(hidden)
    for kind, path in (("vehicle_id", "/vehicles/{}/stream"), ("job_id", "/jobs/{}/events")):
        await a.get(path.format(hidden[kind]), 404, **key("boats"))


async def by_list(a: Api, boat: Json, ours: Json) -> None:
    assert [v["id"] for v in await a.get("/vehicles", **key("boats"))] == [boat["id"]]
    assert [j["id"] for j in await a.get("/jobs", **key("boats"))] == [ours["id"]]
    assert [link["id"] for link in await a.get("/links", **key("boats"))] == [boat["link"]]
    assert [row["unit"] for row in await a.get("/fleet", **key("boats"))] == [boat["id"]]
    table = await a.client.get("/api/v1/fleet.csv", **key("boats"))
    assert [row["unit"] for row in csv.DictReader(io.StringIO(table.text))] == [boat["id"]]
    for path in ("/recordings", "/gaps"):
        assert await a.get(path, **key("boats")) == []
    for path in ("/vehicles", "/jobs", "/links", "/fleet"):
        assert await a.get(path, **key("nothing")) == []
        assert len(await a.get(path)) >= 2


async def by_stream(a: Api, boat: Json, plane: Json, ours: Json, theirs: Json) -> None:
    events = await a.events("/events", 6, last_event_id=0)
    assert events
    headers = {"Authorization": "Bearer boats", "Last-Event-ID": "0"}
    here, elsewhere = (boat["id"], ours["id"], boat["link"]), (plane["id"], theirs["id"], plane["link"])
    text = ""

    async def read() -> None:
        nonlocal text
        async with a.client.stream("GET", "/api/v1/events", headers=headers) as response:
            assert response.status_code == 200
            async for line in response.aiter_lines():
                text += line

    reading = asyncio.create_task(read())
    async with asyncio.timeout(scaled(20)):
        while not all(f'"{name}"' in text for name in here):
            assert not reading.done()
            await asyncio.sleep(0.05)
    await asyncio.sleep(1.0)  # what else there is to hear
    reading.cancel()
    with suppress(asyncio.CancelledError):
        await reading
    assert not [name for name in elsewhere if f'"{name}"' in text]
    ticket = (await a.post("/tickets", expect=201, **key("boats")))["ticket"]
    response = await a.client.get(
        f"/api/v1/vehicles/{plane['id']}/stream?ticket={ticket}", headers={"Authorization": ""}
    )
    assert response.status_code == 404


async def refused(a: Api, boat: Json, upload: Json) -> None:
    """What has no vehicle, or concerns others too, is not for such a key."""
    await a.post("/links", {"url": "tcp:127.0.0.1:1"}, 403, **key("boats"))
    await a.call("DELETE", f"/api/v1/links/{boat['link']}", 403, **key("boats"))
    await a.post("/gaps", {"real": upload["id"]}, 403, **key("boats"))
    await a.post("/fits", {"recording": upload["id"], "method": "mag-sphere"}, 403, **key("boats"))
    await a.call("POST", "/api/v1/recordings", 403, params={"name": "a.csv"}, content=b"a", **key("boats"))
    await a.call("GET", "/metrics", 403, **key("boats"))
    await a.call("PATCH", f"/api/v1/fleet/{boat['id']}", 403, json={"tags": ["planes"]}, **key("boats"))
    row = await a.call("PATCH", f"/api/v1/fleet/{boat['id']}", 200, json={"name": "Heron"}, **key("boats"))
    assert (row["name"], row["tags"]) == ("Heron", ["boats"])
