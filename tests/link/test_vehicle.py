"""Vehicles over real sockets, with the simulated flight controllers on the other side."""

from __future__ import annotations

import asyncio
import struct
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from mavcal.calib.wire.parameters import ParamType
from mavcal.calib.wire.tlog import iter_tlog
from mavcal.service.errors import CommandRefused, EndpointError, LinkDown, ParameterMissing, VehicleArmed
from mavcal.service.link.link import Link
from mavcal.service.link.types import LinkState
from mavcal.service.simvehicle import SimulatedVehicle
from mavcal.service.vehicle.events import VehicleEvent, VehicleEventKind
from mavcal.service.vehicle.identity import Autopilot
from mavcal.service.vehicle.job_vehicle import JobVehicle
from mavcal.service.vehicle.registry import VehicleRegistry
from mavcal.service.vehicle.state import Landed
from mavcal.service.vehicle.streams import request_streams
from mavcal.service.vehicle.vehicle import Vehicle
from tests.patience import scaled
from tests.vehicles import first_vehicle

Finder = Callable[..., Awaitable[Vehicle]]


class Ground:
    """A registry with the links of one test."""

    def __init__(self, folder: Path) -> None:
        self.registry = VehicleRegistry()
        self.links: list[Link] = []
        self.events: list[VehicleEvent] = []
        self._folder = folder
        self.registry.subscribe(self.events.append)

    async def link(self, url: str) -> Link:
        link = Link(f"l{len(self.links)}", url, tlog_dir=self._folder)
        self.registry.attach(link)
        self.links.append(link)
        await link.open()
        return link

    async def vehicle(self, url: str) -> Vehicle:
        link = await self.link(url)
        async with asyncio.timeout(scaled(15)):
            return await first_vehicle(self.registry, link)

    async def until(self, condition: Callable[[], Any], seconds: float = 10.0) -> None:
        async with asyncio.timeout(scaled(seconds)):
            while not condition():  # noqa: ASYNC110 - any condition, on a vehicle in another process
                await asyncio.sleep(0.02)

    def kinds(self) -> list[VehicleEventKind]:
        return [event.kind for event in self.events]


@pytest.fixture
async def ground(tmp_path: Path) -> AsyncIterator[Ground]:
    made = Ground(tmp_path)
    yield made
    for link in made.links:
        await link.close()
        made.registry.detach(link)


def simulated(autopilot: str = "ardupilot", **options: Any) -> SimulatedVehicle:
    return SimulatedVehicle(autopilot, **{"speed": 5.0, **options})


async def test_ardupilot_from_first_heartbeat_to_a_confirmed_write(ground: Ground) -> None:
    with simulated() as sim:
        vehicle = await ground.vehicle(sim.url)
        assert vehicle.identity.autopilot is Autopilot.ARDUPILOT
        assert vehicle.id == f"uid-{vehicle.identity.uid2}"
        assert ground.registry.get(vehicle.id) is ground.registry.get("l0-1-1") is vehicle
        listed = await vehicle.list_parameters()
        assert listed["INS_ACCOFFS_X"].kind is ParamType.REAL32
        await ground.until(lambda: vehicle.writable().ok)
        assert vehicle.state.landed is Landed.ON_GROUND
        for axis, value in (("X", 0.11), ("Y", 0.22), ("Z", 0.33)):
            echo = await vehicle.parameters.set(f"INS_ACCOFFS_{axis}", value, ParamType.REAL32)
            assert echo.parameter.bits == struct.pack("<f", value)
        _, stored = sim.parameters()
        assert [stored[f"INS_ACCOFFS_{a}"] for a in "XYZ"] == pytest.approx([0.11, 0.22, 0.33], abs=1e-6)
        with pytest.raises(ParameterMissing):
            await vehicle.parameters.read("NO_SUCH_NAME")
        assert vehicle.link.statistics(1, 1).lost == 0


async def test_px4_with_its_integers_hash_and_unlisted_names(ground: Ground) -> None:
    with simulated("px4") as sim:
        vehicle = await ground.vehicle(sim.url)
        assert vehicle.identity.autopilot is Autopilot.PX4
        listed = await vehicle.list_parameters()
        assert listed.hash is not None
        assert "_HASH_CHECK" not in listed
        assert isinstance(listed["CAL_ACC0_ID"].value, int)
        await ground.until(lambda: vehicle.writable().ok)
        for value in (-8388000, -1, 0):
            echo = await vehicle.parameters.set("CAL_ACC3_ID", value, ParamType.INT32)
            assert echo.parameter.bits == struct.pack("<i", value)
        report = await request_streams(vehicle, {26: 50.0, 27: 50.0}, measure_s=scaled(0.6))
        assert report.rates[26].measured_hz == pytest.approx(50.0, rel=0.1)
        assert report.rates[27].result == 4
        assert report.missing == (27,)
        assert await report.restore() == ()


async def test_a_message_that_the_vehicle_does_not_have_is_not_owed_for_ever(ground: Ground) -> None:
    """ArduPilot 4.5 refuses every interval of HIGHRES_IMU, its default too; a journal that named it was never done."""
    with simulated(config={"highres": False}) as sim:
        vehicle = await ground.vehicle(sim.url)
        job_vehicle = JobVehicle(vehicle)
        before = await job_vehicle.intervals([27, 105])
        assert before == {27: -1, 105: 0}
        await job_vehicle.request_streams({27: 50.0, 105: 50.0}, measure_s=0.0, before=before)
        await job_vehicle.set_intervals(before)
        assert await job_vehicle.intervals([27, 105]) == before


async def test_streams_are_measured_in_vehicle_time_and_restored(ground: Ground) -> None:
    with simulated() as sim:
        vehicle = await ground.vehicle(sim.url)
        asked, at_five_times = {27: 50.0, 116: 50.0}, pytest.approx(250.0, rel=0.3)
        report = again = await request_streams(vehicle, asked, measure_s=0.6)
        for _ in range(9):  # the vehicle is slower whenever the machine is too busy
            if again.rates[116].wall_hz == at_five_times:
                break
            again = await request_streams(vehicle, asked, measure_s=0.6, before=report.previous)
        assert again.rates[116].wall_hz == at_five_times
        assert again.rates[116].measured_hz == pytest.approx(50.0, rel=0.1)
        heard: list[int] = []
        forget = vehicle.subscribe(frozenset({116}), lambda frames, _batch: heard.append(len(frames)))
        await ground.until(lambda: sum(heard) > 20)
        assert await report.restore() == ()
        quiet = 0
        async with asyncio.timeout(scaled(10)):
            while quiet < 10:  # for 0.2 s: what was on its way may come late
                count = sum(heard)
                await asyncio.sleep(0.02)
                quiet = quiet + 1 if sum(heard) == count else 0
        forget()


async def test_a_list_over_a_lossy_link_is_complete(ground: Ground) -> None:
    with simulated() as sim:
        vehicle = await ground.vehicle(sim.url)
        await sim.acall("fault", kind="loss", probability=0.1)
        listed = await vehicle.list_parameters()
        _, stored = sim.parameters()
        assert set(listed.parameters) <= set(stored)
        assert len(listed) == vehicle.parameters.count


async def test_arming_is_seen_and_stops_every_write(ground: Ground) -> None:
    with simulated() as sim:
        vehicle = await ground.vehicle(sim.url)
        await ground.until(lambda: vehicle.writable().ok)
        await sim.acall("arm")
        await ground.until(lambda: vehicle.state.armed)
        with pytest.raises(VehicleArmed) as caught:
            await vehicle.parameters.set("INS_ACCOFFS_X", 0.5, ParamType.REAL32)
        assert caught.value.sent == 0
        with pytest.raises(CommandRefused):
            await vehicle.command(241, (1,), retries=0)
        await sim.acall("disarm")
        await ground.until(lambda: vehicle.writable().ok)


async def test_a_restart_is_noticed_and_the_vehicle_is_asked_again(ground: Ground) -> None:
    with simulated() as sim:
        vehicle = await ground.vehicle(sim.url)
        await vehicle.parameters.read("INS_ACCOFFS_X")
        await ground.until(lambda: (vehicle.state.boot_time or 0.0) > 8.0)
        await sim.acall("reboot")
        await ground.until(lambda: VehicleEventKind.REBOOTED in ground.kinds())
        assert vehicle.state.rebooted == 1
        assert "INS_ACCOFFS_X" not in vehicle.parameters


async def test_two_vehicles_on_one_link_are_kept_apart(ground: Ground) -> None:
    link = await ground.link("udpin:127.0.0.1:0")
    where = f"udpout:127.0.0.1:{link.local_port}"
    with simulated(link=where, system_id=1) as one, simulated("px4", link=where, system_id=2, seed=2):
        await ground.until(lambda: sum(v.identity.known for v in ground.registry.all()) == 2)
        first, second = ground.registry.get("l0-1-1"), ground.registry.get("l0-2-1")
        assert (first.identity.autopilot, second.identity.autopilot) == (Autopilot.ARDUPILOT, Autopilot.PX4)
        await asyncio.gather(first.list_parameters(), second.list_parameters())
        assert "INS_ACCOFFS_X" in first.parameters
        assert "INS_ACCOFFS_X" not in second.parameters
        assert "CAL_ACC0_ID" in second.parameters
        await ground.until(lambda: first.writable().ok)
        await first.parameters.set("INS_ACCOFFS_X", 0.5, ParamType.REAL32)
        assert one.parameters()[1]["INS_ACCOFFS_X"] == 0.5


async def test_two_vehicles_with_one_system_id_are_never_written_to(ground: Ground) -> None:
    with simulated() as sim:
        vehicle = await ground.vehicle(sim.url)
        await ground.until(lambda: vehicle.writable().ok)
        await sim.acall("fault", kind="twin")
        await ground.until(lambda: vehicle.conflicts)
        assert not vehicle.writable().ok
        assert "system id 1" in vehicle.conflicts[0]
        await ground.until(lambda: VehicleEventKind.CONFLICT in ground.kinds())


@pytest.mark.long
async def test_a_vehicle_that_falls_silent_is_told_and_comes_back(ground: Ground) -> None:
    with simulated(speed=1.0) as sim:
        vehicle = await ground.vehicle(sim.url)
        await sim.acall("fault", kind="silence", duration_s=8.0)  # 3 s are silence, and a late loop has to see them
        await ground.until(lambda: VehicleEventKind.SILENT in ground.kinds())
        assert any("no heartbeat" in reason for reason in vehicle.writable().reasons)
        await ground.until(lambda: VehicleEventKind.HEARD_AGAIN in ground.kinds())


async def test_tcp_to_a_simulated_vehicle(ground: Ground) -> None:
    with simulated(link="tcp") as sim:
        vehicle = await ground.vehicle(sim.url)
        assert len(await vehicle.list_parameters()) > 100
        assert vehicle.link.statistics(1, 1).lost == 0


async def test_a_simulated_link_lives_and_ends_with_its_vehicle(ground: Ground) -> None:
    vehicle = await ground.vehicle("sim:ardupilot?seed=5&speed=5")
    link = vehicle.link
    assert link.sim_control is not None
    host, _, port = link.sim_control.rpartition(":")
    reader, writer = await asyncio.open_connection(host, int(port))
    await link.close()
    assert link.state is LinkState.CLOSED
    with suppress(ConnectionResetError):
        assert await asyncio.wait_for(reader.read(), scaled(5)) == b""
    writer.close()
    with pytest.raises(EndpointError, match="did not start"):
        await ground.link("sim:ardupilot?script=no_such_script")


async def test_a_recorded_subscription_hears_exactly_what_the_recording_holds_from_its_place_on(ground: Ground) -> None:
    """Frames that waited, recorded but not handed on, when it began are neither heard nor behind its place."""
    with simulated(speed=20.0) as sim:
        vehicle = await ground.vehicle(sim.url)
        ids = frozenset({27, 116})
        await request_streams(vehicle, {27: 100.0, 116: 100.0}, measure_s=0.0)
        for _ in range(6):
            always = vehicle.subscribe(ids, lambda frames, _batch: None)  # keeps the frames that wait
            await asyncio.sleep(0.05)
            time.sleep(0.15)  # noqa: ASYNC251 - a busy loop: frames gather
            heard: list[bytes] = []
            place, forget = await vehicle.record(
                ids, lambda frames, _batch, heard=heard: heard.extend(frame.raw for frame in frames)
            )
            time.sleep(0.05)  # noqa: ASYNC251 - as above
            await ground.until(lambda heard=heard: len(heard) > 50)
            forget()
            always()
            data = vehicle.link.tlog.path.read_bytes()[place:]
            recorded = [frame.raw for _, frame in iter_tlog(data) if frame.message_id in ids]
            assert recorded[: len(heard)] == heard


async def test_a_recorded_subscription_on_a_link_that_is_down_is_refused(ground: Ground) -> None:
    with simulated() as sim:
        vehicle = await ground.vehicle(sim.url)
        await vehicle.link.close()
        with pytest.raises(LinkDown):
            await vehicle.record(frozenset({27}), lambda _frames, _batch: None)
