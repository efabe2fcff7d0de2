"""The simulated vehicle that obeys: a person who only watches sees a whole calibration."""

from __future__ import annotations

import asyncio

import pytest

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
        assert review["headline"].startswith("Specific force is wrong by up to")
        assert len(review["sensors"]) == len({fit["instance"] for fit in done["results"]})
        picture = await api.call("GET", f"/{review['picture']}?columns=1", 200)
        assert picture.startswith("<svg")


async def test_a_hand_that_is_off_leaves_the_vehicle_where_it_is(tmp_path):
    async with served(tmp_path) as api:
        await api.post("/links", {"url": "sim:px4?seed=3&speed=10&hand=off"}, 201)
        vehicle = await api.vehicle()
        job = await api.post(f"/vehicles/{vehicle['id']}/jobs", {"kind": "accel"}, 202)
        await asyncio.sleep(8.0)
        progress = (await api.get(f"/jobs/{job['id']}"))["progress"]
        assert progress is None or progress["current"] <= 1
        await api.delete(f"/jobs/{job['id']}", 200)
