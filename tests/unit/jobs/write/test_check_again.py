"""A check that saw nothing looks again: a simulated vehicle in this process is touched, then left alone."""

from __future__ import annotations

import asyncio
import dataclasses
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mavcal.calib.firmware.plan import SensorVerdict, Verification
from mavcal.calib.fit import FitResult, FitStatus
from mavcal.calib.recording import Sensor
from mavcal.calib.triad import TriadModel
from mavcal.calib.wire.frames import FrameParser
from mavcal.service.errors import WriteStopped
from mavcal.service.jobs.write.guard import WriteGuard
from mavcal.service.jobs.write.stream_check import HOLD_STILL, StreamCheck
from mavcal.service.simvehicle.config import load_config
from mavcal.service.simvehicle.server import make_vehicle
from mavcal.service.simvehicle.vehicle import MavlinkChannel
from mavcal.service.simvehicle.wire import Packer
from tests.patience import scaled
from tests.unit.jobs.conftest import QUICK, Bench, MakeBench
from tests.unit.jobs.fakes import FakeVehicle

NAMES = tuple(f"INS_GYROFFS_{axis}" for axis in "XYZ")
RAW_IMU, HIGHRES_IMU, SCALED_IMU2 = 27, 105, 116


class Rig:
    """A vehicle whose gyroscope is calibrated, its frames handed to a job without a link."""

    def __init__(self, bench: Bench, folder: Path, *, error: float = 0.0) -> None:
        bench.vehicle.tlog = folder / "rig.tlog"
        bench.vehicle.tlog.touch()
        config: Any = {"thermal": False, "imu_count": 1, "mag_count": 0, "parameters": {"INS_GYR_CAL": 0}}
        self.vehicle = make_vehicle(load_config(config))
        self.vehicle.preset_parameters({"INS_GYR_CAL": 0})
        self.offset = self.vehicle.world.truth.gyros[0].offset
        self.values = {n: float(v) + error for n, v in zip(NAMES, self.offset, strict=True)}
        self.vehicle.preset_parameters(self.values)
        self.bench, self.said, self.parser = bench, [], FrameParser()
        self.vehicle.channels.append(MavlinkChannel(Packer(1), self.said.append))
        self.vehicle.start()
        for message in (RAW_IMU, HIGHRES_IMU):
            self.vehicle.messages.set_interval(self.vehicle.channels[0], message, 20000)  # type: ignore[attr-defined]
        self.vehicle.advance(5.0)
        self.said.clear()
        bench.handle.progress_s = 0.002  # the vehicle's seconds pass in milliseconds here
        self.disturb: Callable[[], None] = lambda: None
        self.began = 0.0

    def plan(self) -> Any:
        changes = tuple(
            dataclasses.replace(c, old=0.0, new=self.values[c.name], sensor=Sensor.GYRO)
            for c in self.bench.plan.changes
            if c.name in NAMES
        )
        return dataclasses.replace(self.bench.plan, changes=changes)

    def fit(self) -> FitResult:
        covariance = np.zeros((12, 12))
        covariance[:3, :3] = 1e-10 * np.eye(3)
        model = TriadModel(offset=np.array(list(self.values.values())))
        return FitResult(
            "gyro-rest", Sensor.GYRO, 0, FitStatus.OK, "", model, covariance, "rad/s", 500, 500, 1e-3, 1.0,
            temperature=35.0,
        )  # fmt: skip

    async def pump(self) -> None:
        """Let time pass, a tenth of a second at a turn."""
        while True:
            self.vehicle.advance(self.vehicle.time + 0.1)
            frames = [frame for data in self.said for frame in self.parser.feed(data)]
            self.said.clear()
            self.bench.vehicle.deliver(frames)
            await asyncio.sleep(0.001)

    async def checked(self, **settings: float) -> Verification:
        self.bench.handle.change("results", {}, results=(self.fit(),))
        known = {p.name: p.value for p in self.vehicle.table}
        rules = dataclasses.replace(QUICK, **settings)  # type: ignore[arg-type]
        check = StreamCheck(self.bench.handle, self.bench.vehicle, self.plan(), 0.0, rules)
        pumping = asyncio.create_task(self.pump())
        try:
            self.vehicle.preset_parameters(dict.fromkeys(NAMES, 0.0))
            await check.before(WriteGuard(self.bench.vehicle, 0.01))
            self.vehicle.preset_parameters(self.values)
            self.disturb()
            self.began = self.vehicle.time
            return await check.after(WriteGuard(self.bench.vehicle, 0.01), known)
        finally:
            pumping.cancel()

    async def told(self) -> list[str]:
        await self.bench.handle.kept()
        return [str(e) for e in self.bench.store.events(self.bench.handle.id)]


async def test_a_vehicle_that_is_touched_for_a_moment_is_looked_at_again(make_bench: MakeBench, tmp_path: Path) -> None:
    rig = Rig(make_bench(), tmp_path)
    motion = rig.vehicle.world.motion

    def touch() -> None:
        motion.tumble(rig.vehicle.time)
        rig.vehicle.at(4.0, lambda: motion.still(rig.vehicle.time))

    rig.disturb = touch
    result = await rig.checked(check_s=3.0, observe_s=20.0)
    assert result.proved
    assert result.unseen == ()
    (check,) = result.sensors
    assert check.verdict == SensorVerdict.RIGHT


async def test_it_gives_up_after_the_stated_time(make_bench: MakeBench, tmp_path: Path) -> None:
    rig = Rig(make_bench(), tmp_path)
    rig.disturb = lambda: rig.vehicle.world.motion.tumble(rig.vehicle.time)
    result = await rig.checked(check_s=3.0, observe_s=6.0)
    assert set(result.unseen) == set(NAMES)
    assert not result.proved
    assert 9.0 <= rig.vehicle.time - rig.began < 14.0
    assert HOLD_STILL.text in str(await rig.told())


async def test_a_sensor_is_called_wrong_only_after_a_second_look(make_bench: MakeBench, tmp_path: Path) -> None:
    rig = Rig(make_bench(), tmp_path, error=0.01)
    result = await rig.checked(check_s=3.0, observe_s=6.0)
    assert [c.id for c in result.refuted] == ["gyro_zero"]
    assert rig.vehicle.time - rig.began >= 9.0
    assert "looking again" in str(await rig.told())


class Deaf(FakeVehicle):
    """Never answers a request for a message rate: the link loses every one."""

    async def request_streams(
        self, rates: Mapping[int, float], *, measure_s: float, before: Mapping[int, int]
    ) -> tuple[str, ...]:
        await asyncio.Event().wait()
        raise AssertionError


@pytest.mark.parametrize("when", ["before", "after"])
async def test_a_vehicle_that_arms_while_its_streams_are_asked_for_stops_the_write_at_once(
    make_bench: MakeBench, when: str
) -> None:
    bench = make_bench()
    vehicle = Deaf(bench.vehicle.parameters)
    check = StreamCheck(bench.handle, vehicle, bench.plan, 0.0, QUICK)
    guard = WriteGuard(vehicle, 0.01)
    looking = asyncio.create_task(check.before(guard) if when == "before" else check.after(guard, {}))
    await asyncio.sleep(0.03)
    assert not looking.done()
    vehicle.change_state(armed=True)
    async with asyncio.timeout(scaled(5.0)):
        with pytest.raises(WriteStopped, match="armed"):
            await looking
