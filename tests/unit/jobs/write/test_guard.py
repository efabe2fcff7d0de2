from __future__ import annotations

import asyncio
from typing import Any

import pytest

from mavcal.calib.recording import Identity
from mavcal.service.errors import WriteStopped
from mavcal.service.jobs.write.guard import RESTARTED, WriteGuard
from tests.unit.jobs.fakes import FakeVehicle


@pytest.fixture
def vehicle() -> FakeVehicle:
    found = FakeVehicle({})
    found.change_state(peer="127.0.0.1:14550")
    return found


@pytest.mark.parametrize(
    ("trouble", "reason", "doubt"),
    [
        ({}, None, None),
        ({"peer": "127.0.0.1:14551"}, "another address (127.0.0.1:14550, now 127.0.0.1:14551)", "by another vehicle"),
        ({"reboots": 1}, "restarted by itself", "before the vehicle restarted"),
        ({"silent": True}, "fell silent", "before the vehicle fell silent"),
        ({"armed": True}, "is armed", None),
        ({"conflict": "two vehicles answer"}, "two vehicles answer", "by another vehicle"),
        ({"calibrating": True}, "calibration of its own", None),
        ({"armings": 1}, "was armed meanwhile", None),
        ({"silences": 1}, "was silent meanwhile", "before the vehicle fell silent"),
        ({"calibrations": 1}, "calibration of its own meanwhile", None),
        ({"obstacles": ("it flies", "it is hot")}, "it flies; it is hot", None),
    ],
)
def test_what_stops_a_write_and_what_it_puts_in_doubt(
    vehicle: FakeVehicle, trouble: dict[str, Any], reason: str | None, doubt: str | None
) -> None:
    guard = WriteGuard(vehicle, 0.001)
    vehicle.change_state(**trouble)
    if reason is None:
        guard.check()
        assert guard.doubt() is None
        return
    with pytest.raises(WriteStopped) as stopped:
        guard.check()
    assert reason in str(stopped.value)
    assert (doubt or "") in (guard.doubt() or "")
    assert (doubt is None) == (guard.doubt() is None)


def test_another_unit_under_the_same_address_stops_a_write(vehicle: FakeVehicle) -> None:
    guard = WriteGuard(vehicle, 0.001)
    vehicle.identity = Identity("ardupilot", 2, (4, 7, 0), "ffff", 1, 1)
    with pytest.raises(WriteStopped, match="another vehicle answers"):
        guard.check()
    assert guard.doubt() == "possibly said by another vehicle"


def test_a_restart_is_the_reason_and_not_what_it_brings_about(vehicle: FakeVehicle) -> None:
    guard = WriteGuard(vehicle, 0.001)
    vehicle.change_state(reboots=1, silent=True, calibrating=True, peer="127.0.0.1:9", obstacles=("unknown ground",))
    assert guard.reason() == RESTARTED


def test_an_awaited_restart_brings_its_own_address(vehicle: FakeVehicle) -> None:
    guard = WriteGuard(vehicle, 0.001)
    vehicle.change_state(reboots=1, peer="127.0.0.1:14560")
    guard.expect_restart()
    guard.check()
    vehicle.change_state(peer="127.0.0.1:14550")
    with pytest.raises(WriteStopped, match="another address"):
        guard.check()


async def test_what_waits_for_an_answer_is_abandoned_as_soon_as_the_peer_moves(vehicle: FakeVehicle) -> None:
    guard = WriteGuard(vehicle, 30.0)  # only the news of a frame may wake it
    abandoned = asyncio.Event()

    async def forever() -> None:
        try:
            await asyncio.sleep(30)
        finally:
            abandoned.set()

    running = asyncio.create_task(guard.run(forever))
    await asyncio.sleep(0)
    vehicle.change_state(peer="127.0.0.1:14551")
    async with asyncio.timeout(10):
        with pytest.raises(WriteStopped, match="another address"):
            await running
    assert abandoned.is_set()


def test_another_link_of_the_same_vehicle_is_no_other_address(vehicle: FakeVehicle) -> None:
    guard = WriteGuard(vehicle, 0.05)
    vehicle.change_state(way="other", peer="10.0.0.2:5760")
    assert guard.reason() is None
    vehicle.change_state(peer="10.0.0.3:5760")
    assert guard.reason() == "the vehicle speaks from another address (10.0.0.2:5760, now 10.0.0.3:5760)"
