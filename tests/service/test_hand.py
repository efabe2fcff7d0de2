"""The simulated vehicle that obeys: a person who only watches sees a whole calibration."""

from __future__ import annotations

import asyncio
import math

import pytest

from mavcal.service.simvehicle import ControlChannel, SimulatedVehicle
from tests.patience import scaled
from tests.service.api_bench import served


@pytest.mark.long
async def test_a_simulated_vehicle_follows_the_prompts_and_the_stream_shows_it(tmp_path):
    async with served(tmp_path) as api:
        await api.post("/links", {"url": "sim:ardupilot?seed=3&speed=10"}, 201)
        vehicle = await api.vehicle()
        (states,) = [await api.get(f"/vehicles/{vehicle['id']}/sensors")]
        assert {state["verdict"] for state in states["sensors"]} == {"unknown"}
        job = await api.post(f"/vehicles/{vehicle['id']}/jobs", {"kind": "accel"}, 202)
        async with asyncio.timeout(scaled(60)):
            while True:
                ((_, name, data),) = await api.events(f"/vehicles/{vehicle['id']}/samples", 1)
                if data["attitude"] and data["channels"]:
                    break
        assert name == "samples"
        assert sum(part**2 for part in data["attitude"]) > 0.99
        assert {"accel", "gyro"} <= {channel["sensor"] for channel in data["channels"]}
        done = await api.until(job["id"], "review", seconds=90.0)
        review = await api.get(f"/jobs/{job['id']}/review")
        assert review["headline"].startswith("Acceleration is wrong by up to")
        assert len(review["sensors"]) == len({fit["instance"] for fit in done["results"]})
        picture = await api.call("GET", f"/{review['picture']}?columns=1", 200)
        assert picture.startswith("<svg")


@pytest.mark.long
async def test_a_hand_that_is_off_leaves_the_vehicle_where_it_is(tmp_path):
    async with served(tmp_path) as api:
        await api.post("/links", {"url": "sim:px4?seed=3&speed=10&hand=off"}, 201)
        vehicle = await api.vehicle()
        job = await api.post(f"/vehicles/{vehicle['id']}/jobs", {"kind": "accel"}, 202)
        await asyncio.sleep(8.0)
        progress = (await api.get(f"/jobs/{job['id']}"))["progress"]
        assert progress is None or progress["current"] <= 1
        await api.delete(f"/jobs/{job['id']}", 200)


async def test_a_person_turns_a_simulated_vehicle_and_gives_it_back(tmp_path):
    async with served(tmp_path) as api:
        await api.post("/links", {"url": "sim:ardupilot?seed=3&hand=mouse"}, 201)
        vehicle = await api.vehicle()
        assert vehicle["hand"] == "mouse"
        turned = f"/vehicles/{vehicle['id']}/turns"
        link = api.service.vehicles.get(vehicle["id"]).link
        control = ControlChannel(link.sim_control or "")
        nose_down = [math.sqrt(0.5), 0.0, -math.sqrt(0.5), 0.0]
        await api.post(turned, {"attitude": nose_down}, 200)
        async with asyncio.timeout(scaled(30)):
            while (await asyncio.to_thread(control.call, "state"))["euler_deg"][1] > -88.0:  # noqa: ASYNC110
                await asyncio.sleep(0.1)
        for wrong in ([0.0, 0.0, 0.0, 0.0], [2.0, 0.0, 0.0, 0.0], [1.0, 0.0, 0.0], "level"):
            await api.post(turned, {"attitude": wrong}, 422)
        changed = await api.post(f"/vehicles/{vehicle['id']}/hand", {"hand": "auto"}, 200)
        assert changed["hand"] == "auto"
        refused = await api.post(turned, {"attitude": nose_down}, 409)
        assert refused["type"].endswith("hand-busy")
        control.close()


@pytest.mark.long
async def test_a_real_vehicle_is_turned_by_nobody(tmp_path):
    with SimulatedVehicle("px4", seed=3) as real:
        async with served(tmp_path) as api:
            await api.post("/links", {"url": real.url}, 201)  # for the service it is one like any other
            vehicle = await api.vehicle()
            assert vehicle["hand"] is None
            refused = await api.post(f"/vehicles/{vehicle['id']}/turns", {"attitude": [1, 0, 0, 0]}, 409)
            assert refused["type"].endswith("not-simulated")
            await api.post(f"/vehicles/{vehicle['id']}/hand", {"hand": "mouse"}, 409)


async def test_a_hand_that_nobody_knows_is_no_endpoint(tmp_path):
    async with served(tmp_path) as api:
        refused = await api.post("/links", {"url": "sim:px4?hand=foot"}, 422)
        assert "auto, mouse, off" in refused["detail"]


@pytest.mark.long
async def test_after_a_job_that_turned_it_the_vehicle_comes_to_rest(tmp_path):
    async with served(tmp_path) as api:
        await api.post("/links", {"url": "sim:ardupilot?seed=3&speed=8"}, 201)
        vehicle = await api.vehicle()
        control = ControlChannel(api.service.vehicles.get(vehicle["id"]).link.sim_control or "")
        job = await api.post(f"/vehicles/{vehicle['id']}/jobs", {"kind": "mag"}, 202)

        async def still(*, wanted: bool) -> None:
            async with asyncio.timeout(scaled(60)):
                while True:
                    before = (await asyncio.to_thread(control.call, "state"))["euler_deg"]
                    await asyncio.sleep(0.3)
                    after = (await asyncio.to_thread(control.call, "state"))["euler_deg"]
                    rests = max(abs(a - b) for a, b in zip(before, after, strict=True)) < 0.5
                    if rests == wanted and (not wanted or max(map(abs, after[:2])) < 1.0):
                        return

        await still(wanted=False)
        await api.delete(f"/jobs/{job['id']}", 200)
        await still(wanted=True)
        control.close()
