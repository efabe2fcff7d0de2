"""Preflights of both simulated autopilots over real sockets: healthy, with each fault, and where they are refused."""

from __future__ import annotations

import asyncio
import dataclasses
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from mavcal.calib.firmware.in_force.fingerprint import calibration_snapshot, fingerprint
from mavcal.calib.firmware.plan import Agreement, WritePlan, snapshot_sha256
from mavcal.calib.preflight.check import CheckId, Report, Verdict
from mavcal.calib.recording import Sensor
from mavcal.calib.report import to_json
from mavcal.service.errors import PhysicalJobRunning, PreflightRunning, VehicleArmed
from mavcal.service.jobs.core.codec import row_from_job
from mavcal.service.jobs.core.model import Job, Result
from mavcal.service.jobs.core.states import JobState
from mavcal.service.simvehicle import SimulatedVehicle
from mavcal.service.store.rows import SnapshotPurpose

from .jobs_bench import QUICK, Session, eventually, session

SETTINGS = dataclasses.replace(QUICK, preflight_s=2.5)
THERMAL = {"TC_A_ENABLE": 1.0, "TC_G_ENABLE": 1.0, "IMU_GYRO_CAL_EN": 0.0}  # else it mends a gyro by itself
IDS = (1310988, 1310996, 1311004)
for slot, device in enumerate(IDS):
    THERMAL |= {f"TC_A{slot}_ID": float(device), f"TC_A{slot}_TMIN": 15.0, f"TC_A{slot}_TMAX": 55.0}


def vehicle(autopilot: str, **options: Any) -> SimulatedVehicle:
    config: dict[str, Any] = {"calibration": "fresh"}
    if autopilot == "px4":
        config["parameters"] = THERMAL
    return SimulatedVehicle(autopilot, seed=5, speed=2.0, config=config, **options)


@asynccontextmanager
async def looked_at(folder: Path, sim: SimulatedVehicle) -> AsyncIterator[Session]:
    async with session(folder, sim.url, settings=SETTINGS) as life:
        await life.vehicle.identify()
        yield life


async def remember(life: Session) -> None:
    """Keep the present calibration as if a job had just found every sensor in agreement with it."""
    await life.vehicle.list_parameters()
    identity = life.engine._vehicles.vehicle(life.vehicle.id).identity
    parameters = calibration_snapshot({name: p.value for name, p in life.vehicle.parameters.items()})
    agreements = tuple(Agreement(sensor, 0, 0.1, "") for sensor in (Sensor.ACCEL, Sensor.GYRO, Sensor.MAG))
    digest = snapshot_sha256(parameters)
    plan = WritePlan(fingerprint(identity, parameters), digest, (), agreements=agreements)
    now = time.time()
    job = Job("verified", life.vehicle.id, "imu-multi", {}, JobState.SUCCEEDED, now, now, plan=plan,
              outcome=Result("in force"), context={"identity": to_json(identity)})  # fmt: skip
    await life.store.do(lambda: life.store.save_job(row_from_job(job)))
    await life.store.do(lambda: life.store.add_snapshot(job.id, now, SnapshotPurpose.COMPOSED_ON, digest, parameters))
    life.engine.book.load()


async def act(life: Session, sim: SimulatedVehicle, verb: dict[str, Any]) -> None:
    """Do something to the vehicle, and wait until it is heard from later than that."""
    sim.call(**verb)
    done = float(sim.call("state")["time"])
    await eventually(lambda: (life.vehicle.state.boot_time or 0.0) > done + 0.5)


def failed(report: Report) -> list[CheckId]:
    return [check.id for check in report.checks if check.verdict == Verdict.FAIL]


def reset(sim: SimulatedVehicle) -> None:
    """What a firmware update may do."""
    for name, value in sim.parameters()[1].items():
        if name.startswith(("INS_ACC", "COMPASS_OFS", "CAL_ACC", "CAL_MAG")) and "OFF" in name and value:
            sim.call("fault", kind="foreign_write", name=name, value=0.0)


FAULTS: tuple[tuple[CheckId, dict[str, Any], dict[str, Any]], ...] = (
    (
        CheckId.COMPASS_FIELD,
        {"do": "add", "sensor": "mag", "instance": 0, "by": [200.0, 100.0, 100.0]},
        {"do": "add", "sensor": "mag", "instance": 0, "by": [0.0, 0.0, 0.0]},
    ),
    (
        CheckId.COMPASS_DIRECTION,
        {"do": "bend", "instance": 1, "axis": [0.0, 0.0, 1.0], "deg": 30.0},
        {"do": "bend", "instance": 1, "axis": [0.0, 0.0, 1.0], "deg": 0.0},
    ),
    (
        CheckId.ACCEL_FORCE,
        {"do": "add", "sensor": "accel", "instance": 1, "by": [0.3, 0.0, 0.0]},
        {"do": "add", "sensor": "accel", "instance": 1, "by": [0.0, 0.0, 0.0]},
    ),
    (
        CheckId.GYRO_REST,
        {"do": "add", "sensor": "gyro", "instance": 1, "by": [0.0, 0.03, 0.0]},
        {"do": "add", "sensor": "gyro", "instance": 1, "by": [0.0, 0.0, 0.0]},
    ),
    (CheckId.TEMPERATURE, {"do": "temperature", "value": 75.0}, {"do": "temperature", "value": 35.0}),
    (CheckId.VIBRATION, {"do": "shake", "level": 12.0}, {"do": "shake", "level": 0.1}),
)


@pytest.mark.long
@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
async def test_healthy_and_with_each_fault(autopilot: str, tmp_path: Path) -> None:
    with vehicle(autopilot) as sim:
        async with looked_at(tmp_path, sim) as life:
            await remember(life)
            await eventually(lambda: (life.vehicle.state.boot_time or 0.0) > 8.0)
            before = sim.parameters()[1]
            healthy = await life.engine.preflight(life.vehicle.id)
            assert healthy.report.verdict == Verdict.PASS, to_json(healthy.report)
            for right, fault, mended in FAULTS:
                await act(life, sim, fault)
                report = (await life.engine.preflight(life.vehicle.id)).report
                assert failed(report) == [right], to_json(report)
                await act(life, sim, mended)
            assert {n: v for n, v in sim.parameters()[1].items() if not n.startswith("STAT")} == {
                n: v for n, v in before.items() if not n.startswith("STAT")
            }
            reset(sim)
            report = (await life.engine.preflight(life.vehicle.id)).report
            assert failed(report) == [CheckId.PARAMETERS_CHANGED], to_json(report)


@pytest.mark.parametrize("autopilot", ["ardupilot", pytest.param("px4", marks=pytest.mark.long)])
async def test_a_dead_compass_fails_by_name(autopilot: str, tmp_path: Path) -> None:
    with vehicle(autopilot) as sim:
        async with looked_at(tmp_path, sim) as life:
            await eventually(lambda: (life.vehicle.state.boot_time or 0.0) > 8.0)  # a PX4 is not ready before
            await act(life, sim, {"do": "fault", "kind": "absent", "sensor": "mag", "instance": 1})
            report = (await life.engine.preflight(life.vehicle.id)).report
            assert failed(report) == [CheckId.SENSORS_HEARD], to_json(report)
            assert report.check(CheckId.SENSORS_HEARD).suspects == ("compass 2",)
            assert "1 of 2 compasses" in report.check(CheckId.COMPASS_FIELD).reason


@pytest.mark.long
async def test_a_slow_link_is_waited_for_and_no_sensor_is_blamed(tmp_path: Path) -> None:
    with vehicle("ardupilot") as sim:
        async with looked_at(tmp_path, sim) as life:
            sim.call("fault", kind="throttle", bytes_per_s=1500.0, direction="out")
            found = await life.engine.preflight(life.vehicle.id)
            assert failed(found.report) == [], to_json(found.report)
            told = [check.reason + check.remedy for check in found.report.checks if check.verdict != Verdict.PASS]
            assert not any("ook at the compass" in said for said in told)


@pytest.mark.long
async def test_a_vehicle_that_has_just_started_is_asked_again_before_it_is_called_unfit(tmp_path: Path) -> None:
    just_started = {"calibration": "fresh", "agreement_s": 10.0}
    with SimulatedVehicle("ardupilot", seed=5, speed=2.0, config=just_started) as sim:
        async with looked_at(tmp_path, sim) as life:
            found = await life.engine.preflight(life.vehicle.id)
            assert failed(found.report) == [], to_json(found.report)
            assert any("ran its checks again" in note for note in found.notes)


@pytest.mark.long
async def test_units_that_never_agree_are_told_in_the_vehicles_words(tmp_path: Path) -> None:
    never = {"calibration": "fresh", "agreement_s": 1000.0}
    with SimulatedVehicle("ardupilot", seed=5, speed=2.0, config=never) as sim:
        async with looked_at(tmp_path, sim) as life:
            report = (await life.engine.preflight(life.vehicle.id)).report
            assert failed(report) == [CheckId.VEHICLE_PREARM]
            assert "Accels inconsistent" in report.check(CheckId.VEHICLE_PREARM).reason


@pytest.mark.long
async def test_a_swapped_board_is_known_by_its_unique_id(tmp_path: Path) -> None:
    with vehicle("ardupilot") as sim:
        async with looked_at(tmp_path, sim) as life:
            await remember(life)
    with SimulatedVehicle("ardupilot", seed=6, speed=2.0, config={"calibration": "fresh"}) as other:
        async with looked_at(tmp_path, other) as life:
            report = (await life.engine.preflight(life.vehicle.id)).report
            assert failed(report) == [CheckId.SENSOR_IDS], to_json(report)


@pytest.mark.long
async def test_it_is_refused_where_it_cannot_be_made(tmp_path: Path) -> None:
    with vehicle("ardupilot") as sim:
        async with looked_at(tmp_path, sim) as life:
            running = asyncio.create_task(life.engine.preflight(life.vehicle.id))
            await asyncio.sleep(0)  # its first step claims the vehicle
            with pytest.raises(PreflightRunning):
                await life.engine.preflight(life.vehicle.id)
            with pytest.raises(PreflightRunning):
                await life.engine.submit(life.vehicle.id, "gyro")
            found = await running
            assert found.report.check(CheckId.CALIBRATION_AGE).verdict == Verdict.UNKNOWN
            job = await life.engine.submit(life.vehicle.id, "gyro")
            with pytest.raises(PhysicalJobRunning):
                await life.engine.preflight(life.vehicle.id)
            await life.engine.cancel(job.id)
            sim.call("arm")
            await eventually(lambda: bool(life.vehicle.state.armed))
            with pytest.raises(VehicleArmed):
                await life.engine.preflight(life.vehicle.id)


@pytest.mark.long
async def test_message_rates_are_as_before(tmp_path: Path) -> None:
    with vehicle("ardupilot") as sim:
        async with looked_at(tmp_path, sim) as life:
            port = life.engine._vehicles.vehicle(life.vehicle.id)
            before = await port.intervals([27, 105, 116, 241, 1])
            await life.engine.preflight(life.vehicle.id)
            assert await port.intervals([27, 105, 116, 241, 1]) == before
