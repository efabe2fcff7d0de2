"""A vehicle of the registry as jobs see it: nothing is added, nothing is lost on the way."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.calib.firmware.plan import ParameterKind
from mavcal.service.errors import CommandTimeout, DiskFull
from mavcal.service.vehicle.job_vehicle import JobVehicle, ParameterReading, TlogPosition, VehicleSource
from tests.unit.vehicle.fake import FakeVehicle, ack, heartbeat, landed, param_value, real


class Tlog:
    def __init__(self) -> None:
        self.path, self.position, self.error, self.synced = Path("a.tlog"), 123, None, 0

    async def sync(self) -> None:
        self.synced += 1


@pytest.fixture
async def fake() -> FakeVehicle:
    found = FakeVehicle()
    found.link.peers = {}  # type: ignore[attr-defined]
    found.link.tlog = Tlog()  # type: ignore[attr-defined]
    return found


@pytest.fixture
async def seen(fake: FakeVehicle) -> JobVehicle:
    return JobVehicle(fake.vehicle)


async def test_identity_is_what_the_vehicle_said(fake: FakeVehicle, seen: JobVehicle) -> None:
    identity = seen.identity
    assert (identity.autopilot, identity.firmware, identity.system, identity.component) == (
        "ardupilot",
        (4, 7, 0),
        1,
        1,
    )
    assert identity.uid == fake.vehicle.identity.uid2
    assert identity.vehicle_type == 2
    assert seen.id == fake.vehicle.id


async def test_condition_of_a_vehicle_at_rest_and_of_one_that_is_armed(fake: FakeVehicle, seen: JobVehicle) -> None:
    at_rest = seen.condition()
    assert (at_rest.armed, at_rest.silent, at_rest.reboots, at_rest.calibrating) == (False, False, 0, False)
    assert (at_rest.obstacles, at_rest.conflict, at_rest.peer) == ((), None, "")
    fake.hear(heartbeat(armed=True))
    assert seen.condition().armed
    assert seen.condition().obstacles == fake.vehicle.writable().reasons != ()
    fake.hear(heartbeat(status=2), landed())
    assert seen.condition().calibrating
    fake.alive = False
    fake.advance(60.0)
    late = seen.condition()
    assert late.silent
    assert not late.calibrating


async def test_the_peer_is_the_address_it_speaks_from(fake: FakeVehicle, seen: JobVehicle) -> None:
    fake.link.peers = {(1, 1): ("127.0.0.1", 5760), (2, 1): ("127.0.0.1", 5770)}  # type: ignore[attr-defined]
    assert seen.condition().peer == "127.0.0.1:5760"


async def test_a_parameter_is_read_and_set_with_its_own_type(fake: FakeVehicle, seen: JobVehicle) -> None:
    def respond(message: Any) -> list[Any]:
        if message.get_type() == "PARAM_REQUEST_READ":
            return [param_value("X", real(1.5))]
        if message.get_type() == "PARAM_SET":
            return [param_value("X", message.bits, kind=message.param_type)]
        return []

    fake.link.respond = respond
    heard: list[ParameterReading] = []
    forget = seen.on_parameter(heard.append)
    assert await fake.run(seen.read_parameter("X")) == ParameterReading("X", 1.5, ParameterKind.REAL32)
    assert await fake.run(seen.set_parameter("X", 2.5, ParameterKind.REAL32)) == ParameterReading(
        "X", 2.5, ParameterKind.REAL32
    )
    assert [reading.value for reading in heard] == [1.5, 2.5]
    forget()
    await fake.run(seen.read_parameter("X"))
    assert len(heard) == 2


async def test_a_stream_whose_rate_cannot_be_put_back_is_named(fake: FakeVehicle, seen: JobVehicle) -> None:
    fake.link.respond = lambda m: [ack(511, 0 if int(m.param1) == 27 else 2)] if m.get_type() == "COMMAND_LONG" else []
    await fake.run(seen.set_intervals({27: 20_000}))
    with pytest.raises(CommandTimeout, match=r"not confirmed for messages 30, 33$"):
        await fake.run(seen.set_intervals({27: 20_000, 30: -1, 33: 100_000, 105: 0}))  # its default is refused: no such


async def test_an_interval_that_the_vehicle_does_not_say_is_its_default(fake: FakeVehicle, seen: JobVehicle) -> None:
    def respond(message: Any) -> list[Any]:
        if message.get_type() != "COMMAND_LONG" or message.command != 510:
            return [ack(message.command, 3)] if message.get_type() == "COMMAND_LONG" else []
        number = int(message.param1)
        return (
            [ack(510, 0), dialect.MAVLink_message_interval_message(number, 40_000)] if number == 27 else [ack(510, 3)]
        )

    fake.link.respond = respond
    assert await fake.run(seen.intervals([27, 30])) == {27: 40_000, 30: 0}


@pytest.mark.parametrize(("slowdown", "said"), [(1.0, ()), (1.2, ()), (2.5, ("2.5",))])
async def test_a_slow_link_is_said_from_a_fifth_on(
    fake: FakeVehicle, seen: JobVehicle, monkeypatch: pytest.MonkeyPatch, slowdown: float, said: tuple[str, ...]
) -> None:
    async def request(*_: object, **__: object) -> SimpleNamespace:
        return SimpleNamespace(slowdown=slowdown)

    monkeypatch.setattr("mavcal.service.vehicle.job_vehicle.request_streams", request)
    told = await seen.request_streams({27: 50.0}, measure_s=1.0, before={})
    assert tuple(word in text for word, text in zip(said, told, strict=True)) == (True,) * len(said)


async def test_a_full_disk_is_no_kept_recording(fake: FakeVehicle, seen: JobVehicle) -> None:
    tlog = fake.link.tlog  # type: ignore[attr-defined]
    assert seen.tlog_position() == TlogPosition(Path("a.tlog"), 123)
    await seen.sync_tlog()
    assert tlog.synced == 1
    tlog.error = "no space left"
    with pytest.raises(DiskFull, match="no space left"):
        await seen.sync_tlog()
    assert tlog.synced == 1


def test_a_vehicle_is_found_by_its_id() -> None:
    registry = SimpleNamespace(get=lambda vehicle_id: SimpleNamespace(unit=SimpleNamespace(id=vehicle_id)))
    assert VehicleSource(registry).vehicle("v7").id == "v7"  # type: ignore[arg-type]


async def test_a_vehicle_that_is_not_ours_stands_in_conflict(fake: FakeVehicle) -> None:
    registry = SimpleNamespace(get=lambda _: fake.vehicle)
    ours = VehicleSource(registry, lambda vehicle_id: f"not {vehicle_id}")  # type: ignore[arg-type]
    assert ours.vehicle("v7").condition().conflict == f"not {fake.vehicle.id}"
