"""Who watches a simulated vehicle has it send its samples; whatever happens then, its own rates come back."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator, Sequence
from contextlib import aclosing, asynccontextmanager
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.calib.firmware.stream.rates import live_streams
from mavcal.calib.wire.codec import decode
from mavcal.calib.wire.frames import Frame
from mavcal.service.link.types import Batch
from mavcal.service.simvehicle import ControlChannel
from mavcal.service.vehicle.intervals import DEFAULT_INTERVAL, get_interval, set_interval
from mavcal.service.vehicle.vehicle import Vehicle
from tests.patience import scaled
from tests.service.api_bench import Api, Json, served

SIM = "sim:{}?seed=3&hand=off"
INERTIAL = {"ardupilot": dialect.MAVLINK_MSG_ID_RAW_IMU, "px4": dialect.MAVLINK_MSG_ID_SCALED_IMU}
OWN_HZ = 4.0
"""What another program had asked for before."""

both = pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])


@asynccontextmanager
async def flying(
    folder: Path, autopilot: str, options: str = "", **settings: object
) -> AsyncIterator[tuple[Api, Vehicle]]:
    async with served(folder, **settings) as api:
        await api.post("/links", {"url": SIM.format(autopilot) + options}, 201)
        known = await api.vehicle()
        yield api, api.service.vehicles.get(known["id"])


async def intervals(vehicle: Vehicle) -> dict[int, int]:
    ids = live_streams(vehicle.identity.autopilot.value, 50.0)
    return {i: await get_interval(vehicle, i) or DEFAULT_INTERVAL for i in ids}


async def watched(api: Api, vehicle: Vehicle, rate_hz: float = 50.0) -> str:
    begun = await api.post(f"/vehicles/{vehicle.id}/watches", {"rate_hz": rate_hz}, 201)
    return f"/vehicles/{vehicle.id}/samples?watch={begun['id']}"


async def messages(api: Api, path: str) -> AsyncIterator[Json]:
    async with api.client.stream("GET", f"/api/v1{path}") as response:
        assert response.status_code == 200, await response.aread()
        async for line in response.aiter_lines():
            if line.startswith("data: "):
                yield json.loads(line.removeprefix("data: "))


async def until_state(stream: AsyncIterator[Json], state: str, text: str = "", rate_hz: float = 0.0) -> Json:
    async with asyncio.timeout(scaled(30)):
        async for data in stream:
            now = data["watch"]
            if now["state"] == state and text in now["text"] and now["rate_hz"] >= rate_hz:
                return data
    raise AssertionError("the stream has ended")


async def until_restored(vehicle: Vehicle, before: dict[int, int]) -> None:
    async with asyncio.timeout(scaled(120)):
        while await intervals(vehicle) != before:  # noqa: ASYNC110 - only the vehicle knows
            await asyncio.sleep(0.2)


def boot_s(frame: Frame) -> float:
    """The vehicle's time in an inertial message, s."""
    told = decode(frame).to_dict()
    return float(told["time_boot_ms"] / 1e3 if "time_boot_ms" in told else told["time_usec"] / 1e6)


async def hz(vehicle: Vehicle, message_id: int) -> float:
    """By the vehicle's own clock, over 1.5 s of it, however long that takes."""
    stamps: list[float] = []

    def note(frames: Sequence[Frame], _batch: Batch) -> None:
        stamps.extend(boot_s(frame) for frame in frames)

    forget = vehicle.subscribe(frozenset({message_id}), note)
    try:
        async with asyncio.timeout(scaled(30)):
            while not stamps or stamps[-1] - stamps[0] < 1.5:  # noqa: ASYNC110 - the vehicle's frames wake nobody
                await asyncio.sleep(0.05)
    finally:
        forget()
    return (len(stamps) - 1) / (stamps[-1] - stamps[0])


@pytest.mark.long
@both
async def test_rates_rise_while_two_watch_and_are_back_when_the_last_one_was_killed(tmp_path, autopilot):
    async with flying(tmp_path, autopilot) as (api, vehicle):
        message = INERTIAL[autopilot]
        await set_interval(vehicle, message, 1e6 / OWN_HZ)
        before = await intervals(vehicle)
        first = messages(api, await watched(api, vehicle))
        second = asyncio.create_task(drain(messages(api, await watched(api, vehicle, 100.0))))
        granted = await until_state(first, "granted", rate_hz=100.0)
        assert granted["loss"] == pytest.approx(0.0, abs=0.01)
        assert await hz(vehicle, message) == pytest.approx(100.0, rel=0.2)
        await first.aclose()  # a connection that ends without a word
        await asyncio.sleep(3.5)
        assert await hz(vehicle, message) > 50.0  # the other one still watches
        second.cancel()
        await until_restored(vehicle, before)
        assert await hz(vehicle, message) == pytest.approx(OWN_HZ, rel=0.3)


async def drain(stream: AsyncIterator[Json]) -> None:
    async with aclosing(stream):  # type: ignore[type-var]
        async for _ in stream:
            pass


@pytest.mark.long  # a minute passes until nothing fits into the buffers of the connection
async def test_a_client_that_takes_nothing_any_more_is_no_watcher(tmp_path):
    async with flying(tmp_path, "px4") as (api, vehicle):
        before = await intervals(vehicle)
        path = await watched(api, vehicle, 200.0)
        port = api.client.base_url.port
        reader, writer = await asyncio.open_connection("127.0.0.1", port, limit=1024)
        writer.write(f"GET /api/v1{path} HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\n\r\n".encode())
        assert (await reader.readline()).startswith(b"HTTP/1.1 200")
        async with asyncio.timeout(scaled(30)):
            while await intervals(vehicle) == before:  # noqa: ASYNC110 - only the vehicle knows
                await asyncio.sleep(0.2)
        # the socket stays open and full: what a laptop leaves that was closed while it watched
        await until_restored(vehicle, before)
        writer.close()


@pytest.mark.long
@both
async def test_a_job_begins_meanwhile_goes_its_way_and_leaves_the_rates_as_they_were_before_both(tmp_path, autopilot):
    async with flying(tmp_path, autopilot, "&speed=10") as (api, vehicle):
        message = INERTIAL[autopilot]
        await set_interval(vehicle, message, 1e6 / OWN_HZ)
        before = await intervals(vehicle)
        stream = messages(api, await watched(api, vehicle, 200.0))
        await until_state(stream, "granted")
        job = await api.post(f"/vehicles/{vehicle.id}/jobs", {"kind": "gyro"}, 202)
        waits = await until_state(stream, "waiting", "gyro")
        assert waits["watch"]["rate_hz"] == 200.0
        done = await api.until(job["id"], "review", "succeeded", seconds=90)
        journal = api.service.store.journal(job["id"])
        owed = next(row.data["intervals"] for row in journal if row.step == "streams")
        assert {int(key): interval for key, interval in owed.items()}.items() <= before.items()
        assert done["results"]
        if done["state"] == "review":  # the vehicle's own calibration at boot may leave nothing to write
            await api.delete(f"/jobs/{job['id']}", 200)
        await until_state(stream, "granted")
        assert await hz(vehicle, message) > 100.0
        await stream.aclose()
        await until_restored(vehicle, before)


@pytest.mark.long
async def test_a_preflight_has_its_own_rates_and_gives_them_back(tmp_path):
    async with flying(tmp_path, "px4") as (api, vehicle):
        before = await intervals(vehicle)
        stream = messages(api, await watched(api, vehicle, 100.0))
        await until_state(stream, "granted")
        looking = asyncio.create_task(api.post(f"/vehicles/{vehicle.id}/preflight", {}, 200))
        await until_state(stream, "waiting", "preflight")
        notes = (await looking)["notes"]
        assert not [note for note in notes if "rates" in note], notes
        await until_state(stream, "granted")
        await stream.aclose()
        await until_restored(vehicle, before)


@pytest.mark.long
@both
async def test_an_armed_vehicle_has_its_own_rates_at_once(tmp_path, autopilot):
    async with flying(tmp_path, autopilot) as (api, vehicle):
        before = await intervals(vehicle)
        stream = messages(api, await watched(api, vehicle))
        await until_state(stream, "granted")
        control = ControlChannel(vehicle.link.sim_control or "")
        await asyncio.to_thread(control.call, "arm")
        await until_state(stream, "waiting", "armed")
        await until_restored(vehicle, before)
        await asyncio.to_thread(control.call, "disarm")
        await until_state(stream, "granted")
        control.close()
        await stream.aclose()
        await until_restored(vehicle, before)


@pytest.mark.long
async def test_the_end_of_the_service_puts_the_rates_back(tmp_path):
    async with served(tmp_path) as api:
        await api.post("/links", {"url": SIM.format("ardupilot")}, 201)
        vehicle = api.service.vehicles.get((await api.vehicle())["id"])
        stream = messages(api, await watched(api, vehicle))
        await until_state(stream, "granted")
        assert json.loads((tmp_path / "live-rates.json").read_text())[vehicle.id]
        await stream.aclose()
        await api.service.live.stop()
        assert json.loads((tmp_path / "live-rates.json").read_text()) == {}
        assert set((await intervals(vehicle)).values()) <= {-1, 0}


async def test_who_may_not_or_asks_for_what_cannot_be_is_told(tmp_path):
    async with flying(tmp_path, "ardupilot", read_only=True) as (api, vehicle):
        before = await intervals(vehicle)
        refused = await api.post(f"/vehicles/{vehicle.id}/watches", {"rate_hz": 50.0}, 403)
        assert "--read-only" in refused["detail"]
        for body in ({"rate_hz": 0}, {"rate_hz": 201}, {"rate_hz": "fast"}, {"rate": 50}):
            await api.post(f"/vehicles/{vehicle.id}/watches", body, 422)
        await api.post("/vehicles/nobody/watches", {}, 404)
        gone = await api.get(f"/vehicles/{vehicle.id}/samples?watch=0123456789ab", 404)
        assert gone["type"].endswith("watch-unknown")
        assert await intervals(vehicle) == before
