"""An event loop that is late, as on a starved machine: the vehicle is judged by what the reader thread has received."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Iterator
from pathlib import Path

import pytest

from mavcal.calib.wire.parameters import ParamType
from mavcal.service.errors import VehicleArmed, WriteStopped
from mavcal.service.jobs.write.guard import WriteGuard
from mavcal.service.link.link import Link
from mavcal.service.simvehicle import SimulatedVehicle
from mavcal.service.vehicle.events import VehicleEventKind
from mavcal.service.vehicle.job_vehicle import JobVehicle
from mavcal.service.vehicle.registry import VehicleRegistry
from mavcal.service.vehicle.state import SILENT_S
from mavcal.service.vehicle.vehicle import Vehicle
from tests.patience import scaled
from tests.vehicles import first_vehicle

NAME = "INS_ACCOFFS_X"
LATE_S = SILENT_S + 1.5
"""So long the loop does nothing at all."""


@pytest.fixture
def sim() -> Iterator[SimulatedVehicle]:
    with SimulatedVehicle("ardupilot", speed=2.0, config={"boot_s": 1.0}) as started:
        yield started


@pytest.fixture
async def told() -> list[VehicleEventKind]:
    return []


@pytest.fixture
async def vehicle(sim: SimulatedVehicle, told: list[VehicleEventKind], tmp_path: Path) -> AsyncIterator[Vehicle]:
    registry, link = VehicleRegistry(), Link("late", sim.url, tlog_dir=tmp_path)
    registry.subscribe(lambda event: told.append(event.kind))
    registry.attach(link)
    await link.open()
    async with asyncio.timeout(scaled(20)):
        found = await first_vehicle(registry, link)
        while not found.writable().ok:  # noqa: ASYNC110 - the condition is about another process
            await asyncio.sleep(0.05)
    yield found
    registry.detach(link)
    await link.close()
    registry.close()


@pytest.mark.long
async def test_a_healthy_vehicle_is_written_to_although_the_loop_is_late(
    sim: SimulatedVehicle, vehicle: Vehicle, told: list[VehicleEventKind]
) -> None:
    guard = WriteGuard(JobVehicle(vehicle), 0.05)

    async def write() -> None:
        for step in range(3):
            await vehicle.parameters.set(NAME, 0.01 * (1 + step), ParamType.REAL32)
            await asyncio.sleep(0.1)
            asyncio.get_running_loop().call_soon(time.sleep, LATE_S)
            await asyncio.sleep(0.05)
            assert vehicle.writable().ok

    await guard.run(write)
    await vehicle.parameters.set(NAME, 0.05, ParamType.REAL32)
    assert sim.parameters()[1][NAME] == pytest.approx(0.05)
    assert VehicleEventKind.SILENT not in told


async def test_nothing_is_sent_to_a_vehicle_that_armed_while_the_loop_was_late(
    sim: SimulatedVehicle, vehicle: Vehicle
) -> None:
    sim.call("arm")
    sim.wait(3.0)  # the loop is to be late; the reader hears its heartbeat meanwhile
    with pytest.raises(VehicleArmed) as refused:
        await vehicle.parameters.set(NAME, 0.1, ParamType.REAL32)
    assert refused.value.sent == 0
    assert not sim.state()["param_set_list"]


@pytest.mark.parametrize(("what", "said"), [("arm", "was armed meanwhile"), ("silence", "was silent meanwhile")])
async def test_what_came_and_went_while_the_loop_was_late_stops_a_write(
    sim: SimulatedVehicle, vehicle: Vehicle, what: str, said: str
) -> None:
    guard = WriteGuard(JobVehicle(vehicle), 0.05)
    if what == "arm":
        sim.call("arm")
        sim.wait(4.0)
        sim.call("disarm")
    else:
        sim.call("fault", kind="silence", duration_s=2.0 * LATE_S)
        sim.wait(2.0 * LATE_S)
    sim.wait(8.0)  # disarmed and heard for more than 2 s again, at twice the speed
    with pytest.raises(WriteStopped, match=said):
        await guard.run(asyncio.Event().wait)


@pytest.mark.long
async def test_a_restart_while_the_loop_was_late_stops_a_write(sim: SimulatedVehicle, vehicle: Vehicle) -> None:
    async with asyncio.timeout(scaled(30)):
        while (vehicle.state.boot_time or 0.0) < 12.0:  # noqa: ASYNC110 - up for longer than the loop is late
            await asyncio.sleep(0.05)
    guard = WriteGuard(JobVehicle(vehicle), 0.05)
    sim.call("reboot")
    time.sleep(2.0)  # noqa: ASYNC251
    with pytest.raises(WriteStopped, match="restarted by itself"):
        async with asyncio.timeout(scaled(10)):
            await guard.run(asyncio.Event().wait)
    assert not sim.state()["param_set_list"]


async def test_a_vehicle_that_fell_silent_is_silent_however_late_the_loop(
    sim: SimulatedVehicle, vehicle: Vehicle
) -> None:
    sim.call("fault", kind="silence", duration_s=100.0)
    time.sleep(LATE_S)  # noqa: ASYNC251
    await vehicle.caught_up()
    assert vehicle.silent
    assert not vehicle.writable().ok
