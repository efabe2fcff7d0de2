"""Campaigns over HTTP: through simulated vehicles, and through uploads."""

from __future__ import annotations

import csv
import io
import json
from pathlib import Path

import pytest

from mavcal.calib.preflight.check import CheckId
from mavcal.service.settings import ApiKey
from mavcal.service.simvehicle import SimulatedVehicle

from .api_bench import Api, Json, api, served
from .gap_tables import write_table
from .jobs_bench import SPEED, eventually, stored, zero_gyro_offsets

QUICKLY = {"uncertainty": 0.02}


def at_rest(seed: int) -> SimulatedVehicle:
    return SimulatedVehicle("ardupilot", speed=SPEED, seed=seed, config={"thermal": False})


async def heard(a: Api, count: int) -> list[Json]:
    await eventually(lambda: sum(v.writable().ok for v in a.service.vehicles.all()) >= count)
    found: list[Json] = await a.get("/vehicles")
    return found


async def upload(a: Api, content: bytes, name: str) -> str:
    made = await a.call("POST", "/api/v1/recordings", 201, params={"name": name}, content=content)
    return str(made["id"])


def rest(n: int, rows: int = 400) -> bytes:
    lines = "".join(f"{k / 50},0.01,0.02,0.0{k % (n + 5)}\n" for k in range(rows))
    return f"t,gyro_x,gyro_y,gyro_z\n{lines}".encode()


@pytest.mark.long
async def test_vehicles_are_checked_and_calibrated_as_one_job_each(tmp_path: Path) -> None:
    with at_rest(41) as one, at_rest(42) as two, at_rest(43) as armed:
        async with served(tmp_path, connect=(one.url, two.url, armed.url)) as a:
            ids = [v["id"] for v in await heard(a, 3)]
            urls = {link["id"]: link["url"] for link in await a.get("/links")}
            of = {urls[v["link"]]: v["id"] for v in await a.get("/vehicles")}
            armed.call("arm")
            await eventually(lambda: any(v.state.armed for v in a.service.vehicles.all()))
            for sim in (one, two):
                zero_gyro_offsets(sim)
            before = stored(one), stored(two)

            job = await a.post("/campaigns/preflight", {"vehicles": "all"}, 202)
            done = await a.until(job["id"], "succeeded", seconds=60)
            assert done["outcome"]["text"].startswith("3 vehicles: ")
            items = await a.get(f"/jobs/{job['id']}/items")
            assert [i["subject"] for i in items] == ids
            by_id = {i["subject"]: i for i in items}
            assert (by_id[of[armed.url]]["outcome"], by_id[of[armed.url]]["code"]) == ("skipped", "vehicle-armed")
            for sim in (one, two):
                item = by_id[of[sim.url]]
                assert item["outcome"] in {"done", "warned", "refused"}
                assert {c["id"] for c in item["preflight"]["checks"]} == {c.value for c in CheckId}
                assert item["text"] == item["preflight"]["summary"]

            body = {"vehicles": [of[one.url], of[two.url], "nobody"], "kind": "gyro", "options": QUICKLY}
            job = await a.post("/campaigns/calibrate", body, 202)
            await a.until(job["id"], "succeeded", seconds=60)
            items = await a.get(f"/jobs/{job['id']}/items")
            assert [(i["outcome"], i["job_state"]) for i in items] == [
                ("review", "review"),
                ("review", "review"),
                ("skipped", None),
            ]
            assert (stored(one), stored(two)) == before  # nothing is written without apply
            await a.delete(f"/jobs/{items[0]['job_id']}", 200)
            assert (await a.get(f"/jobs/{job['id']}/items"))[0]["job_state"] == "cancelled"
            await a.delete(f"/jobs/{items[1]['job_id']}", 200)

            job = await a.post("/campaigns/calibrate", body | {"apply": True}, 202)
            await a.until(job["id"], "succeeded", seconds=90)
            items = await a.get(f"/jobs/{job['id']}/items")
            assert [i["outcome"] for i in items] == ["done", "done", "skipped"]
            for sim, was, item in zip((one, two), before, items, strict=False):
                plan = await a.get(f"/jobs/{item['job_id']}/plan")
                assert plan["changes"]
                held = stored(sim)
                assert {c["name"]: c["new"] for c in plan["changes"]} == {
                    c["name"]: held[c["name"]] for c in plan["changes"]
                }
                assert held != was
            rows = [row for row in a.service.store.audit() if row.action == "apply"]
            assert {row.subject for row in rows} == {i["job_id"] for i in items if i["job_id"]}


@pytest.mark.long
async def test_uploads_are_fitted_paged_filtered_and_told(tmp_path: Path) -> None:
    async with served(tmp_path) as a:
        ids = [await upload(a, rest(n), f"{'=' if n == 1 else ''}rest{n}.csv") for n in range(4)]
        short = await upload(a, rest(0, rows=2), "short.csv")
        for where, body in (
            ("/campaigns/fit", {"recordings": [*ids, "none"], "method": "gyro-rest"}),
            ("/campaigns/gap", {"recordings": ids, "sim": "none"}),
        ):
            await a.post(where, body, 404)
        for wrong in ({"recordings": ids, "method": "none"}, {"recordings": [], "method": "gyro-rest"}):
            await a.post("/campaigns/fit", wrong, 422)
        assert await a.get("/jobs") == []

        job = await a.post("/campaigns/fit", {"recordings": "all", "method": "gyro-rest", "at_once": 1}, 202)
        assert (job["kind"], job["vehicle_id"]) == ("campaign", None)
        done = await a.until(job["id"], "succeeded")
        where = f"/jobs/{job['id']}/items"
        items = await a.get(where)
        assert [i["subject"] for i in items] == [*ids, short]
        assert [i["outcome"] for i in items[:4]] == ["done"] * 4
        assert items[4]["outcome"] in {"refused", "failed"}
        assert items[4]["text"]
        assert done["outcome"]["text"] == f"5 logs: 4 done, 1 {items[4]['outcome']}."
        (alone,) = (await a.post(f"/recordings/{ids[0]}/fits", {"method": "gyro-rest"}, 200))["fits"]
        assert items[0]["fits"] == [alone]

        page = await a.client.get(f"/api/v1{where}", params={"limit": 2})
        assert [i["number"] for i in page.json()] == [1, 2]
        found = page.links["next"]["url"]
        assert found == "items?after=2&limit=2"
        page = await a.client.get(f"/api/v1/jobs/{job['id']}/{found}")
        assert [i["number"] for i in page.json()] == [3, 4]
        odd = await a.get(where, params={"outcome": ["refused", "failed"]})
        assert [i["number"] for i in odd] == [5]
        await a.get(where, 422, params={"outcome": "splendid"})
        table = list(csv.DictReader(io.StringIO(await a.get(f"{where}.csv"), newline="")))
        assert [row["outcome"] for row in table] == [i["outcome"] for i in items]
        assert table[1]["name"] == "'=rest1.csv"

        # Three states, five items, and at least one word of progress.
        events = await a.events(f"/jobs/{job['id']}/events", 9, 0)
        told = [data for _, _, data in events if data["kind"] == "item"]
        assert told[0]["data"]["subject"] == ids[0]
        assert any(data["kind"] == "progress" and data["data"]["unit"] == "items" for _, _, data in events)
        other = (await a.get("/jobs", params={"kind": "fit"}))[0]
        assert await a.get(f"/jobs/{other['id']}/items") == []  # it is no campaign
        await a.get("/jobs/none/items", 404)


@pytest.mark.long
async def test_gaps_of_uploads_have_their_reports(tmp_path: Path) -> None:
    table = write_table(tmp_path / "real.csv", seconds=20.0).read_bytes()
    async with served(tmp_path / "data") as a:
        real = await upload(a, table, "real.csv")
        job = await a.post("/campaigns/gap", {"recordings": [real]}, 202)
        await a.until(job["id"], "succeeded", seconds=120)
        (item,) = await a.get(f"/jobs/{job['id']}/items")
        names = [d["name"] for d in item["documents"]]
        assert names == ["item-1-report.json", "item-1-report.html"]
        report = json.dumps(await a.call("GET", f"/{item['documents'][0]['href']}", 200))
        assert item["code"] in report
        assert "<html" in await a.call("GET", f"/{item['documents'][1]['href']}", 200)


async def test_to_write_takes_the_scope_for_it(tmp_path: Path) -> None:
    from mavcal.service.api.security import digest

    keys = tuple(
        ApiKey(name=name, sha256=digest(name), scopes=frozenset(scopes))  # type: ignore[arg-type]
        for name, scopes in (("reader", {"read"}), ("operator", {"read", "operate"}))
    )
    body = {"vehicles": ["v"], "kind": "gyro"}
    async with api(tmp_path, headers={"Authorization": "Bearer operator"}, api_keys=keys) as a:
        assert "write-params" in (await a.post("/campaigns/calibrate", body | {"apply": True}, 403))["detail"]
        job = await a.post("/campaigns/calibrate", body, 202)
        await a.until(job["id"], "succeeded")
    async with api(tmp_path, headers={"Authorization": "Bearer reader"}, api_keys=keys) as a:
        await a.post("/campaigns/calibrate", body, 403)
        assert [i["outcome"] for i in await a.get(f"/jobs/{job['id']}/items")] == ["skipped"]
