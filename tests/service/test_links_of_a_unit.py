"""One simulated vehicle on UDP, TCP and a serial line at once: one vehicle, one claim, no write that is stranded."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from mavcal.service.simvehicle import SimulatedVehicle
from tests.patience import scaled

from .api_bench import Api, Json, api
from .jobs_bench import GYRO, SPEED, stored, zero_gyro_offsets

JOB = {"kind": "gyro", "options": {"uncertainty": 0.03}}
PROVE = {"prove_s": 0.0}
CONFIG = {"thermal": False, "parameters": {"INS_GYR_CAL": 0}}


@pytest.fixture
def sim() -> Iterator[SimulatedVehicle]:
    with SimulatedVehicle(
        "ardupilot", link=["udpout", "tcp", "serial"], speed=SPEED, seed=31, config=CONFIG
    ) as vehicle:
        zero_gyro_offsets(vehicle)
        yield vehicle


async def eventually(condition: Callable[[], Any], seconds: float = 20.0) -> None:
    async with asyncio.timeout(scaled(seconds)):
        while not await condition():  # noqa: ASYNC110 - the condition is about another process
            await asyncio.sleep(0.02)


@asynccontextmanager
async def connected(folder: Path, *urls: str) -> AsyncIterator[tuple[Api, Json]]:
    """The service with these links, which all lead to one vehicle that may be written to."""
    async with api(folder, connect=urls) as a:

        async def together() -> bool:
            found = await a.get("/vehicles")
            return len(found) == 1 and len(found[0]["links"]) == len(urls) and found[0]["writable"]

        await eventually(together)
        yield a, (await a.get("/vehicles"))[0]


async def reviewed(a: Api, vehicle: Json) -> Json:
    job = await a.post(f"/vehicles/{vehicle['id']}/jobs", JOB, 202)
    return await a.until(job["id"], "review", seconds=60)


async def applying(a: Api, job: Json) -> None:
    accept = {"plan_sha256": job["plan"]["sha256"], **PROVE}

    async def taken() -> bool:
        answer = await a.client.post(f"/api/v1/jobs/{job['id']}/apply", json=accept)
        assert answer.status_code in (200, 202, 409), answer.text
        return answer.status_code != 409

    await eventually(taken)


async def written(sim: SimulatedVehicle, at_least: int) -> None:
    async def so_far() -> bool:
        return bool((await sim.acall("state"))["param_sets"] >= at_least)

    await eventually(so_far)


async def ended(a: Api, job: Json) -> Json:
    return await a.until(job["id"], "succeeded", "reverted", seconds=90)


async def test_three_links_are_one_vehicle_with_one_claim(tmp_path: Path, sim: SimulatedVehicle) -> None:
    async with connected(tmp_path, *sim.urls) as (a, vehicle):
        links = await a.get("/links")
        assert {link["id"] for link in links} == set(vehicle["links"])
        assert all(link["vehicles"] == [vehicle["id"]] for link in links)
        job = await a.post(f"/vehicles/{vehicle['id']}/jobs", JOB, 202)
        for link in links:  # whatever name it is called by
            refused = await a.post(f"/vehicles/{link['id']}-1-1/jobs", JOB, 409)
            assert job["id"] in refused["detail"]
        await a.until(job["id"], "review", seconds=60)
        await a.delete(f"/links/{vehicle['link']}", 204)  # nothing is written: the others are left
        (left,) = await a.get("/vehicles")
        assert (left["id"], len(left["links"])) == (vehicle["id"], 2)


async def test_a_write_goes_on_when_its_link_dies_or_is_closed(tmp_path: Path, sim: SimulatedVehicle) -> None:
    before = stored(sim)
    async with connected(tmp_path, *sim.urls[:2]) as (a, vehicle):
        job = await reviewed(a, vehicle)
        (other,) = set(vehicle["links"]) - {vehicle["link"]}
        by_udp = vehicle["link"].startswith("udp")  # whichever was heard first is in use
        sim.call("fault", kind="cut", link=0 if by_udp else 1, trigger={"nth_set": 4})
        await applying(a, job)
        done = await ended(a, job)
        assert done["state"] == "succeeded", done["outcome"]
        held = stored(sim)
        assert {c["name"]: held[c["name"]] for c in done["plan"]["changes"]} == {
            c["name"]: pytest.approx(c["new"]) for c in done["plan"]["changes"]
        }
        assert any(held[name] != before[name] for name in GYRO if name in held)
        (now,) = await a.get("/vehicles")
        assert now["link"] == other
        await a.delete(f"/links/{vehicle['link']}", 204)


@pytest.mark.long
async def test_the_only_link_of_a_write_is_not_closed(tmp_path: Path, sim: SimulatedVehicle) -> None:
    async with connected(tmp_path, sim.urls[1]) as (a, vehicle):
        job = await reviewed(a, vehicle)
        sim.call("fault", kind="lost_echo", count=2)
        await applying(a, job)
        await written(sim, 2)
        refused = await a.delete(f"/links/{vehicle['link']}", 409)
        assert refused["code"] == "link-busy"
        assert job["id"] in refused["detail"]
        assert (await ended(a, job))["state"] == "succeeded"
        await a.delete(f"/links/{vehicle['link']}", 204)


@pytest.mark.long
@pytest.mark.parametrize("unique_id", [True, False])
async def test_a_stranded_write_is_taken_up_on_whatever_link_the_vehicle_is_heard(
    tmp_path: Path, *, unique_id: bool
) -> None:
    config = CONFIG | {"unique_id": unique_id}
    with SimulatedVehicle("ardupilot", link=["udpout", "tcp"], speed=SPEED, seed=32, config=config) as sim:
        zero_gyro_offsets(sim)
        before = stored(sim)
        async with connected(tmp_path, sim.urls[0]) as (a, vehicle):
            job = await reviewed(a, vehicle)
            sim.call("fault", kind="cut", link=0, trigger={"nth_set": 4})
            await applying(a, job)
            async with asyncio.timeout(scaled(60)):
                while (await a.get(f"/jobs/{job['id']}"))["state"] != "in_doubt":  # noqa: ASYNC110
                    await asyncio.sleep(0.05)
            refused = await a.delete(f"/links/{vehicle['link']}", 409)
            assert "in doubt" in refused["detail"]
            await a.post("/links", {"url": sim.urls[1]}, 201)
            done = await ended_at_last(a, job)
            if done["state"] == "reverted":
                assert {name: stored(sim)[name] for name in before} == before
            (now,) = [v for v in await a.get("/vehicles") if not v["silent"]]
            await a.post(f"/vehicles/{now['id']}/jobs", JOB, 202)


async def ended_at_last(a: Api, job: Json) -> Json:
    """Also from in doubt, where the job ends otherwise for the bench."""
    async with asyncio.timeout(scaled(90)):
        ends = ("succeeded", "reverted", "review")
        while (found := await a.get(f"/jobs/{job['id']}"))["state"] not in ends:  # noqa: ASYNC110
            await asyncio.sleep(0.05)
    return dict(found)
