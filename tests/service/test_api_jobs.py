"""Jobs over REST: a simulated ArduPilot on a loopback socket, from the start of a calibration to its reversal."""

from __future__ import annotations

import asyncio
import csv
import io
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any
from urllib.parse import urljoin

import pytest
import structlog
from pydantic import TypeAdapter

from mavcal.service.api.models.events import JobEvent
from mavcal.service.api.security import digest
from mavcal.service.logs import configure_logging
from mavcal.service.settings import ApiKey
from mavcal.service.simvehicle import SimulatedVehicle
from tests.patience import scaled

from .api_bench import Api, Json, served
from .jobs_bench import GYRO_OFFSETS, SPEED, stored, zero_gyro_offsets

GYRO = {"kind": "gyro", "options": {"uncertainty": 0.02}}


@pytest.fixture(scope="module")
def sim() -> Iterator[SimulatedVehicle]:
    with SimulatedVehicle("ardupilot", speed=SPEED, seed=21, config={"thermal": False}) as vehicle:
        yield vehicle


@pytest.fixture(autouse=True)
def rested(sim: SimulatedVehicle) -> Iterator[None]:
    sim.call("clear_faults")
    sim.call("disarm")
    sim.call("still")
    zero_gyro_offsets(sim)
    configure_logging(as_json=False)
    yield
    structlog.reset_defaults()


@asynccontextmanager
async def bench(folder: Path, sim: SimulatedVehicle, **settings: Any) -> AsyncIterator[tuple[Api, Json]]:
    """The service connected to the simulated vehicle, which may be written to."""
    async with served(folder, connect=(sim.url,), **settings) as a:
        if "api_keys" in settings:
            a.client.headers["Authorization"] = "Bearer secret"
        yield a, await a.vehicle()


async def reviewed(a: Api, vehicle: Json) -> Json:
    job = await a.post(f"/vehicles/{vehicle['id']}/jobs", GYRO, 202)
    return await a.until(job["id"], "review")


JOB_EVENT: TypeAdapter[JobEvent] = TypeAdapter(JobEvent)


async def test_a_vehicle_its_parameters_and_its_stream(tmp_path, sim):
    async with bench(tmp_path, sim) as (a, vehicle):
        assert (vehicle["autopilot"], vehicle["armed"], vehicle["silent"]) == ("ardupilot", False, False)
        assert vehicle["evidence"]
        by_place = await a.get(f"/vehicles/{vehicle['link']}-1-1")  # the name before it was identified
        assert by_place["id"] == vehicle["id"]
        sim.call("fault", kind="foreign_write", name="INS_GYROFFS_Y", value=0.25)
        async with asyncio.timeout(scaled(10)):  # one is heard without having been asked for: it is not the whole list
            while not (await a.get("/vehicles"))[0]["parameters_known"]:  # noqa: ASYNC110
                await asyncio.sleep(0.05)
        listed = {p["name"]: p["value"] for p in await a.get(f"/vehicles/{vehicle['id']}/parameters")}
        held = stored(sim)
        differing = {n: (v, held[n]) for n, v in listed.items() if n in held and v != held[n]}
        assert not differing
        assert len(listed) > 100
        assert {n for n in listed if not n.startswith("STAT_")} <= held.keys()
        sim.call("fault", kind="foreign_write", name="INS_GYROFFS_X", value=0.125)
        again = await a.get(f"/vehicles/{vehicle['id']}/parameters?refresh=true")
        assert {p["name"]: p["value"] for p in again}["INS_GYROFFS_X"] == 0.125
        for _, name, state in await a.events(f"/vehicles/{vehicle['id']}/stream", 2):
            assert (name, state["id"]) == ("vehicle", vehicle["id"])
        (link,) = await a.get("/links")
        assert link["vehicles"] == [vehicle["id"]]
        assert await a.get("/links/" + link["id"]) | {"crc_errors": 0} == link | {"crc_errors": 0}


async def test_from_start_over_review_and_apply_to_proof_and_back(tmp_path, sim):
    owner = ApiKey(name="the ground crew", sha256=digest("secret"), scopes=frozenset({"admin"}))
    async with bench(tmp_path, sim, api_keys=(owner,)) as (a, vehicle):
        before = stored(sim)
        started = await a.client.post(f"/api/v1/vehicles/{vehicle['id']}/jobs", json=GYRO)
        assert started.status_code == 202
        where = urljoin(str(started.url), started.headers["location"])
        job = await a.until(started.json()["id"], "review")
        assert (await a.client.get(where)).json()["id"] == job["id"]
        assert [r["sensor"] for r in job["results"]] == ["gyro"] * 3
        plan = await a.get(f"/jobs/{job['id']}/plan")
        assert plan == job["plan"]
        sha = plan["sha256"]
        await apply_is_refused_in_the_ways_it_must_be(a, job["id"], sha)
        assert stored(sim) == before

        key = {"headers": {"Idempotency-Key": "once"}}
        body = {"plan_sha256": sha, "prove_s": 0}
        await a.post(f"/jobs/{job['id']}/apply", body, 202, **key)
        twice = await a.post(f"/jobs/{job['id']}/apply", body, 202, **key)
        assert twice["id"] == job["id"]
        other = await a.post(f"/jobs/{job['id']}/apply", body | {"reboot": True}, 409, **key)
        assert other["type"].endswith("idempotency-key-reused")
        await a.post(f"/jobs/{job['id']}/apply", body, 409, headers={"Idempotency-Key": "another"})
        done = await a.until(job["id"], "succeeded")
        verdicts = {p["name"]: p["verdict"] for p in done["verification"]["parameters"]}
        assert all(verdicts[name] == "proved" for name in GYRO_OFFSETS)
        after = stored(sim)
        assert {c["name"]: c["new"] for c in plan["changes"]} == {c["name"]: after[c["name"]] for c in plan["changes"]}
        await exports_say_the_same(a, done)
        await events_are_replayed(a, job["id"])

        await a.post(f"/jobs/{job['id']}/revert", {}, 202)
        await a.until(job["id"], "reverted")
        assert stored(sim) == before
        await a.post(f"/jobs/{job['id']}/revert", {}, 409)
        said = [(row.actor, row.action) for row in a.service.store.audit() if row.action in {"apply", "revert"}]
        assert said == [("the ground crew", "apply"), ("the ground crew", "revert")]
    async with bench(tmp_path, sim, api_keys=(owner,)) as (a, _):  # a restart forgets nothing
        kept = await a.get(f"/jobs/{job['id']}")
        assert (kept["state"], kept["plan"]) == ("reverted", plan)


async def apply_is_refused_in_the_ways_it_must_be(a: Api, job_id: str, sha: str) -> None:
    for body, status in [
        ({}, 422),
        ({"plan_sha256": sha[:-1]}, 422),
        ({"plan_sha256": sha.upper()}, 422),
        ({"plan_sha256": None}, 422),
        ({"plan_sha256": sha, "force": True}, 422),
        ({"plan_sha256": sha, "prove_s": -1}, 422),
        ({"plan_sha256": sha, "prove_s": "NaN"}, 422),
        ({"plan_sha256": "0" * 64}, 409),
    ]:
        problem = await a.post(f"/jobs/{job_id}/apply", body, status)
        assert status != 409 or problem["title"] == "Plan again"
    await a.call("POST", f"/api/v1/jobs/{job_id}/apply", 422)
    await a.post(f"/jobs/{job_id}/apply", {"plan_sha256": sha}, 422, headers={"Idempotency-Key": "x" * 201})
    await a.post(f"/jobs/{job_id}/revert", {}, 409)
    await a.post(f"/jobs/{job_id}/refit", {}, 409)
    assert (await a.get(f"/jobs/{job_id}"))["state"] == "review"


async def exports_say_the_same(a: Api, job: Json) -> None:
    expected = {c["name"]: c["new"] for c in job["plan"]["changes"]}
    for form in ("param", "parm", "params"):
        text = await a.get(f"/jobs/{job['id']}/export.{form}")
        for name, value in expected.items():
            (line,) = (line for line in text.splitlines() if name in line.replace(",", " ").split())
            numbers = [word for word in line.replace(",", " ").split()[1:] if word[0] in "-0123456789"]
            assert any(float(number) == pytest.approx(value, rel=1e-6) for number in numbers), line
    rows = list(csv.DictReader(io.StringIO(await a.get(f"/jobs/{job['id']}/export.csv"))))
    assert {row["parameter"]: float(row["new"]) for row in rows} == expected
    document = await a.get(f"/jobs/{job['id']}/export.json")
    assert {"left_out": [], **document["plan"]} == job["plan"]  # stored only where there is one
    assert document["verification"] == job["verification"]
    assert document["segments"][0]["sha256"]
    page = await a.get(f"/jobs/{job['id']}/export.html")
    assert all(name in page for name in expected)
    assert "proved" in page
    picture = await a.get(f"/jobs/{job['id']}/picture.svg?columns=2")
    assert picture.strip() in page, "the export shows the picture of the review"
    review = await a.get(f"/jobs/{job['id']}/review")
    assert review["headline"] in page
    assert all(c["text"] in page for c in review["criteria"] if not c["id"].startswith("loss-"))
    for form in ("xml", "PARAM", "", "json.csv"):
        problem = await a.get(f"/jobs/{job['id']}/export.{form}", 404)
        assert problem["status"] == 404


async def events_are_replayed(a: Api, job_id: str) -> None:
    states = ["queued", "running", "fitting", "review", "applying", "verifying", "succeeded"]
    total = len(a.service.store.events(job_id))
    events = await a.events(f"/jobs/{job_id}/events", total)
    for _, _, event in events:
        told = JOB_EVENT.validate_python(event)
        assert JOB_EVENT.dump_python(told, mode="json") == event
    assert {event["kind"] for _, _, event in events} >= {"state", "progress", "prompt", "verification", "write"}
    assert {name for _, name, _ in events} == {"job"}
    told = [e["data"]["state"] for _, _, e in events if e["kind"] == "state"]
    assert [s for s in told if s in states] == states
    ids = [i for i, _, _ in events]
    assert ids == sorted(set(ids))
    middle = ids[total // 2]
    rest = await a.events(f"/jobs/{job_id}/events", total - total // 2 - 1, last_event_id=middle)
    assert rest == events[total // 2 + 1 :]
    everything = await a.events("/events", total + 2, last_event_id=0)
    assert [e for _, name, e in everything if name == "job"][: total - 1] == [e for _, _, e in events][: total - 1]
    await a.call("GET", f"/api/v1/jobs/{job_id}/events", 422, headers={"Last-Event-ID": "minus one"})
    await a.call("GET", "/api/v1/events", 422, headers={"Last-Event-ID": "-1"})


async def test_one_physical_job_a_vehicle_and_a_cancel_within_a_second(tmp_path, sim):
    async with bench(tmp_path, sim) as (a, vehicle):
        path = f"/vehicles/{vehicle['id']}/jobs"
        job = await a.post(path, {"kind": "accel"}, 202)
        problem = await a.post(path, GYRO, 409)
        assert job["id"] in problem["detail"]
        assert problem["type"].endswith("physical-job-running")
        async with asyncio.timeout(scaled(20)):
            while not (prompt := (await a.get(f"/jobs/{job['id']}"))["prompt"]):  # noqa: ASYNC110
                await asyncio.sleep(0.05)
        assert prompt["remaining"]
        refused = await a.post(f"/jobs/{job['id']}/answers", {"value": "certainly"}, 409)
        assert refused["type"].endswith("answer-refused")
        await a.post(f"/jobs/{job['id']}/answers", {}, 422)
        await a.get(f"/jobs/{job['id']}/plan", 404)
        await a.get(f"/jobs/{job['id']}/export.param", 404)
        await a.post(f"/jobs/{job['id']}/plan", {}, 409)
        async with asyncio.timeout(scaled(1.0)):
            await a.delete(f"/jobs/{job['id']}", 200)
        assert (await a.get(f"/jobs/{job['id']}"))["state"] == "cancelled"
        await a.delete(f"/jobs/{job['id']}", 409)
        assert [j["id"] for j in await a.get(f"/jobs?vehicle_id={vehicle['id']}")] == [job["id"]]
        assert await a.get("/jobs?vehicle_id=other") == []
        again = await a.post(path, GYRO, 202)  # the vehicle is free again
        await a.delete(f"/jobs/{again['id']}", 200)


NONSENSE: tuple[Any, ...] = (
    {"kind": "compassmot"},
    {"kind": 3},
    {},
    [],
    {"kind": "gyro", "options": {"colour": 1}},
    {"kind": "gyro", "options": {"uncertainty": -1}},
    {"kind": "gyro", "options": {"uncertainty": "small"}},
    {"kind": "gyro", "options": {"uncertainty": float("nan")}},
    {"kind": "gyro", "options": {"uncertainty": float("inf")}},
    {"kind": "gyro", "options": {"uncertainty": 10**400}},
    {"kind": "gyro", "options": [1]},
    {"kind": "gyro", "force": True},
)


async def test_a_job_that_makes_no_sense_is_422_and_an_answer_reaches_the_procedure(tmp_path, sim):
    async with bench(tmp_path, sim) as (a, vehicle):
        for body in NONSENSE:
            problem = await a.post_text(f"/vehicles/{vehicle['id']}/jobs", body, 422)
            assert "extract fields" not in problem["detail"] or not isinstance(body, dict)
        await a.call("POST", "/api/v1/vehicles/nobody/jobs", 404, json=GYRO)
        assert await a.get("/jobs") == []

        sim.call("warm_up", start=30.0, end=50.0, tau_s=60.0)
        job = await a.post(f"/vehicles/{vehicle['id']}/jobs", {"kind": "thermal"}, 202)
        async with asyncio.timeout(scaled(30)):
            while not ((await a.get(f"/jobs/{job['id']}"))["prompt"] or {"answers": ()})["answers"]:  # noqa: ASYNC110
                await asyncio.sleep(0.05)
        answered = await a.post(f"/jobs/{job['id']}/answers", {"value": "finish"}, 200)
        assert answered["id"] == job["id"]
        ended = await a.until(job["id"], "review")
        (span,) = {r["model"]["polynomial"]["t_max"] - r["model"]["polynomial"]["t_min"] for r in ended["results"][:1]}
        assert span < 20.0  # not the whole range that was asked for: the answer ended it


async def test_a_change_by_somebody_else_is_plan_again_and_then_it_works(tmp_path, sim):
    async with bench(tmp_path, sim) as (a, vehicle):
        job = await reviewed(a, vehicle)
        sim.call("fault", kind="foreign_write", name="INS_ACCOFFS_X", value=0.25)
        problem = await a.post(f"/jobs/{job['id']}/apply", {"plan_sha256": job["plan"]["sha256"]}, 409)
        assert problem["title"] == "Plan again"
        assert "INS_ACCOFFS_X" in problem["detail"]
        again = await a.post(f"/jobs/{job['id']}/plan", {}, 200)
        assert again == await a.get(f"/jobs/{job['id']}/plan")
        assert again["sha256"] != job["plan"]["sha256"]
        await a.post(f"/jobs/{job['id']}/apply", {"plan_sha256": job["plan"]["sha256"]}, 409)
        await a.post(f"/jobs/{job['id']}/apply", {"plan_sha256": again["sha256"], "prove_s": 0}, 202)
        await a.until(job["id"], "succeeded")


async def test_an_armed_vehicle_is_409_and_a_read_only_service_403(tmp_path, sim):
    async with bench(tmp_path, sim, read_only=True) as (a, vehicle):
        job = await reviewed(a, vehicle)
        problem = await a.post(f"/jobs/{job['id']}/apply", {"plan_sha256": job["plan"]["sha256"]}, 403)
        assert "--read-only" in problem["detail"]
        sim.call("arm")
        async with asyncio.timeout(scaled(10)):
            while not (await a.get(f"/vehicles/{vehicle['id']}"))["armed"]:  # noqa: ASYNC110
                await asyncio.sleep(0.05)
        problem = await a.post(f"/vehicles/{vehicle['id']}/jobs", GYRO, 409)
        assert problem["type"].endswith("vehicle-armed")


async def test_a_write_that_fails_before_it_begins_says_so_in_review_and_can_be_tried_again(tmp_path, sim):
    async with bench(tmp_path, sim) as (a, vehicle):
        job = await reviewed(a, vehicle)
        assert job["outcome"] is None
        before = stored(sim)
        body = {"plan_sha256": job["plan"]["sha256"], "prove_s": 0}
        await a.post(f"/jobs/{job['id']}/apply", body, 202)
        sim.call("arm")  # while the service still looks at the stream under the old values
        async with asyncio.timeout(scaled(20)):
            while (told := await a.get(f"/jobs/{job['id']}"))["last_write"]["result"] == "running":  # noqa: ASYNC110
                await asyncio.sleep(0.05)
        assert (told["state"], told["last_write"]["result"], told["last_write"]["sent"]) == ("review", "failed", 0)
        assert told["outcome"]["kind"] == "write_failed"
        assert "armed" in told["outcome"]["cause"]
        assert told["outcome"]["remedy"] == "Nothing was written."
        events = [row.data for row in a.service.store.events(job["id"]) if row.kind == "state"]
        assert (events[-1]["state"], events[-1]["outcome"]["kind"]) == ("review", "write_failed")
        assert stored(sim) == before
        sim.call("disarm")
        await a.vehicle()
        await a.post(f"/jobs/{job['id']}/apply", body, 202)
        assert (await a.until(job["id"], "succeeded"))["outcome"]["kind"] == "result"
