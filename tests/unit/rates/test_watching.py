from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Iterable, Mapping
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.calib.errors import FirmwareError, InvalidInputError
from mavcal.calib.firmware.stream.rates import live_streams
from mavcal.calib.recording import Identity
from mavcal.service.errors import CommandTimeout, Forbidden, LinkDown, VehicleUnknown, WatchUnknown
from mavcal.service.rates.ledger import RateLedgers
from mavcal.service.rates.owed import OwedRates
from mavcal.service.rates.watching import ARMED, SILENT, LiveRates, LiveState, LiveTimes, WatchOwed
from mavcal.service.vehicle.rate_ledger import RateLedger
from tests.unit.jobs.conftest import until
from tests.unit.jobs.fakes import FakeRegistry, FakeVehicle

RAW_IMU = dialect.MAVLINK_MSG_ID_RAW_IMU
BEFORE = {RAW_IMU: 250_000, dialect.MAVLINK_MSG_ID_SCALED_IMU2: -1}
QUICK = LiveTimes(look_s=0.001, again_s=0.001, stop_s=1.0, measure_s=0.0)


@dataclass
class StreamingVehicle(FakeVehicle):
    """Says what was asked of it, and may refuse or be slow to grant it."""

    requests: list[Mapping[int, float]] = field(default_factory=list)
    puts: list[Mapping[int, int]] = field(default_factory=list)
    broken: bool = False
    granting: asyncio.Event = field(default_factory=asyncio.Event)

    async def intervals(self, message_ids: Iterable[int]) -> dict[int, int]:
        if self.broken:
            raise LinkDown
        return await super().intervals(message_ids)

    async def request_streams(
        self, rates: Mapping[int, float], *, measure_s: float, before: Mapping[int, int]
    ) -> tuple[str, ...]:
        self.requests.append(dict(rates))
        try:
            await self.granting.wait()
        except asyncio.CancelledError:
            self.message_intervals |= before
            raise
        return await super().request_streams(rates, measure_s=measure_s, before=before)

    async def set_intervals(self, intervals: Mapping[int, int]) -> None:
        if self.broken:
            raise CommandTimeout("not confirmed")
        self.puts.append(dict(intervals))
        await super().set_intervals(intervals)


@dataclass
class World:
    vehicle: StreamingVehicle
    registry: FakeRegistry
    path: Path
    now: float = 0.0
    claim: str | None = None

    def made(self, **changes: bool) -> LiveRates:
        return LiveRates(
            RateLedgers(self.registry, OwedRates(self.path)), times=QUICK, clock=lambda: self.now, **changes
        )

    @asynccontextmanager
    async def running(self) -> AsyncIterator[LiveRates]:
        live = self.made()
        live.start(lambda _: self.claim)
        yield live
        await live.stop()

    @property
    def restored(self) -> bool:
        return {key: self.vehicle.message_intervals.get(key) for key in BEFORE} == BEFORE

    @property
    def rate_hz(self) -> float:
        interval = self.vehicle.message_intervals[RAW_IMU]
        return 1e6 / interval


@pytest.fixture
def world(tmp_path: Path) -> World:
    vehicle = StreamingVehicle({}, message_intervals=dict(BEFORE))
    vehicle.granting.set()
    return World(vehicle, FakeRegistry({vehicle.id: vehicle}), tmp_path / "owed.json")


async def test_rates_rise_for_who_watches_and_are_back_when_the_last_one_has_left(world: World) -> None:
    async with world.running() as live:
        first, second = live.begin("vehicle-1", 50.0), live.begin("vehicle-1", 20.0)
        await until(lambda: live.taken(first).state == LiveState.GRANTED)
        assert world.rate_hz == pytest.approx(50.0)
        assert world.vehicle.requests == [live_streams("ardupilot", 50.0)]
        assert OwedRates(world.path).all()["vehicle-1"].items() >= BEFORE.items()
        live.left(first)
        world.now = QUICK.leave_s + 0.1
        live.taken(second)
        await until(lambda: world.rate_hz == pytest.approx(20.0))  # those who stay wished for less
        assert world.vehicle.puts == []
        live.left(second)
        world.now += QUICK.leave_s + 0.1
        await until(lambda: world.restored and OwedRates(world.path).all() == {})


async def test_a_watch_that_is_not_taken_up_or_hangs_lapses_and_one_that_goes_on_lives_again(world: World) -> None:
    async with world.running() as live:
        watch = live.begin("vehicle-1", 50.0)
        await until(lambda: bool(world.vehicle.requests))
        world.now = QUICK.lapse_s + 0.1
        await until(lambda: world.restored and OwedRates(world.path).all() == {})
        with pytest.raises(WatchUnknown):
            live.watch(watch.id, "vehicle-1")
        await until(lambda: live.taken(watch).state == LiveState.GRANTED)  # its stream was only stuck
        assert live.watch(watch.id, "vehicle-1") is watch


async def test_a_job_finds_the_rates_as_they_were_and_nothing_is_asked_until_it_is_over(world: World) -> None:
    async with world.running() as live:
        watch = live.begin("vehicle-1", 50.0)
        await until(lambda: live.taken(watch).state == LiveState.GRANTED)
        world.claim = "A job has them."
        assert await live.release("vehicle-1", tuple(BEFORE)) == {}
        assert world.restored
        asked = len(world.vehicle.requests)
        world.vehicle.message_intervals[RAW_IMU] = 40_000  # the job's
        await until(lambda: live.taken(watch).text == "A job has them.")
        world.now = 2 * QUICK.lapse_s
        live.taken(watch)
        await asyncio.sleep(0.02)
        assert len(world.vehicle.requests) == asked
        assert world.vehicle.message_intervals[RAW_IMU] == 40_000
        world.vehicle.message_intervals |= BEFORE
        world.claim = None
        await until(lambda: live.taken(watch).state == LiveState.GRANTED)


async def test_a_job_that_begins_while_rates_are_asked_for_finds_them_as_they_were(world: World) -> None:
    world.vehicle.granting.clear()
    async with world.running() as live:
        live.begin("vehicle-1", 50.0)
        await until(lambda: bool(world.vehicle.requests))
        world.claim = "A job has them."
        assert await live.release("vehicle-1", tuple(BEFORE)) == {}
        assert world.restored


async def test_what_cannot_be_put_back_becomes_the_jobs_own_to_put_back(world: World) -> None:
    async with world.running() as live:
        watch = live.begin("vehicle-1", 50.0)
        await until(lambda: live.taken(watch).state == LiveState.GRANTED)
        world.vehicle.broken, world.claim = True, "A job has them."
        assert await live.release("vehicle-1", [RAW_IMU]) == {RAW_IMU: BEFORE[RAW_IMU]}
        assert RAW_IMU not in OwedRates(world.path).all()["vehicle-1"]
        world.vehicle.broken = False
        world.now = 2 * QUICK.lapse_s  # nobody watches any more
        await asyncio.sleep(0.02)
        assert world.vehicle.puts == []  # the job measures
        world.claim = None
        await until(lambda: bool(world.vehicle.puts))
        assert RAW_IMU not in world.vehicle.puts[0]


async def test_an_armed_vehicle_is_asked_for_nothing_and_gets_its_link_back_at_once(world: World) -> None:
    async with world.running() as live:
        watch = live.begin("vehicle-1", 50.0)
        await until(lambda: live.taken(watch).state == LiveState.GRANTED)
        world.vehicle.change_state(armed=True)
        await until(lambda: live.taken(watch).text == ARMED)
        await until(lambda: world.restored)
        asked = len(world.vehicle.requests)
        await asyncio.sleep(0.02)
        assert len(world.vehicle.requests) == asked
        world.vehicle.change_state(armed=False)
        await until(lambda: live.taken(watch).state == LiveState.GRANTED)


async def test_a_silent_vehicle_is_waited_for_and_one_that_has_restarted_is_asked_again(world: World) -> None:
    world.vehicle.change_state(silent=True)
    async with world.running() as live:
        watch = live.begin("vehicle-1", 50.0)
        await until(lambda: live.taken(watch).text == SILENT)
        assert world.vehicle.requests == []
        world.vehicle.change_state(silent=False)
        await until(lambda: live.taken(watch).state == LiveState.GRANTED)
        world.vehicle.message_intervals = {RAW_IMU: 1_000_000}
        world.vehicle.change_state(reboots=1)
        await until(lambda: len(world.vehicle.requests) == 2)
        live.left(watch)
        world.now = QUICK.leave_s + 0.1
        await until(lambda: bool(world.vehicle.puts))
        assert world.vehicle.puts[-1][RAW_IMU] == 1_000_000  # as it was after the restart
        await until(lambda: OwedRates(world.path).all() == {})  # else they are put back once more at the end
    assert len(world.vehicle.puts) == 1


async def test_nothing_is_sent_where_it_is_not_certain_who_listens(world: World) -> None:
    async with world.running() as live:
        watch = live.begin("vehicle-1", 50.0)
        await until(lambda: live.taken(watch).state == LiveState.GRANTED)
        world.vehicle.change_state(conflict="Two vehicles answer.")
        world.now = 2 * QUICK.lapse_s
        await asyncio.sleep(0.02)
        assert world.vehicle.puts == []
        world.vehicle.change_state(conflict=None)
        await until(lambda: world.restored)


async def test_the_end_of_the_service_puts_back_and_a_killed_one_leaves_it_to_the_next(world: World) -> None:
    async with world.running() as live:
        live.begin("vehicle-1", 50.0)
        await until(lambda: bool(world.vehicle.requests) and not world.restored)
    assert world.restored
    killed = world.made()
    killed.start(lambda _: None)
    killed.begin("vehicle-1", 50.0)
    await until(lambda: len(world.vehicle.requests) == 2 and not world.restored)
    for attended in killed._attendants.values():
        attended.task.cancel()
    await asyncio.sleep(0)
    assert not world.restored
    world.vehicle.rates = RateLedger()  # what was in memory is gone
    async with world.running():
        await until(lambda: world.restored and OwedRates(world.path).all() == {})


async def test_a_link_that_is_down_is_said_and_tried_again(world: World) -> None:
    world.vehicle.broken = True
    async with world.running() as live:
        watch = live.begin("vehicle-1", 50.0)
        await until(lambda: "link" in live.taken(watch).text)
        world.vehicle.broken = False
        await until(lambda: live.taken(watch).state == LiveState.GRANTED)


async def test_what_can_never_be_is_refused_at_once(world: World) -> None:
    async with world.running() as live:
        for rate in (0.0, -1.0, 201.0, float("nan")):
            with pytest.raises(InvalidInputError, match="rate_hz"):
                live.begin("vehicle-1", rate)
        with pytest.raises(VehicleUnknown):
            live.begin("vehicle-2", 50.0)
        world.vehicle.identity = Identity("slugs", 2, None, None, 1, 1)
        with pytest.raises(FirmwareError):
            live.begin("vehicle-1", 50.0)
    with pytest.raises(Forbidden, match="--read-only"):
        world.made(read_only=True).begin("vehicle-1", 50.0)
    assert world.vehicle.requests == []


async def test_a_watch_is_of_one_vehicle(world: World) -> None:
    other = StreamingVehicle({}, id="vehicle-2")
    world.registry.vehicles[other.id] = other
    async with world.running() as live:
        watch = live.begin("vehicle-1", 50.0)
        with pytest.raises(WatchUnknown):
            live.watch(watch.id, "vehicle-2")
        await until(lambda: live.taken(watch).state == LiveState.GRANTED)
    assert other.requests == []


@pytest.mark.parametrize("turns", range(8))
async def test_memory_and_disk_agree_however_late_a_change_is_cancelled(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, turns: int
) -> None:
    async def at_once(work: Callable[..., None], *what: object) -> None:
        work(*what)

    kept = OwedRates(tmp_path / "owed.json")
    owed = WatchOwed("vehicle-1", kept)
    await owed.owe(BEFORE)
    monkeypatch.setattr(asyncio, "to_thread", at_once)
    changing = asyncio.create_task(owed.returned())
    for _ in range(turns):
        await asyncio.sleep(0)
    changing.cancel()
    await asyncio.gather(changing, return_exceptions=True)
    assert owed.intervals() == kept.all().get("vehicle-1", {})
