"""What a job rests on is read by name, and how far that is gets told."""

from __future__ import annotations

from mavcal.calib.firmware.in_force.needed import needed
from mavcal.calib.recording import Sensor
from mavcal.service.jobs.needs import read_needed
from mavcal.service.testing import FakeVehicle

IDS = ("INS_ACC_ID", "INS_ACC2_ID", "INS_GYR_ID", "INS_GYR2_ID")


async def test_the_count_grows_by_one_and_its_total_by_what_turns_out_to_be_needed() -> None:
    vehicle = FakeVehicle.with_floats({**dict.fromkeys(IDS, 5.0), "INS_GYROFFS_X": 0.25, "INS_GYR2OFFS_X": 0.5})
    told: list[tuple[int, int]] = []
    sensors = (Sensor.ACCEL, Sensor.GYRO)
    found = await read_needed(vehicle, sensors, drift=False, told=lambda done, total: told.append((done, total)))
    assert found["INS_GYR2OFFS_X"].value == 0.5
    assert [done for done, _ in told] == list(range(1, len(told) + 1))
    totals = [total for _, total in told]
    assert totals == sorted(totals)
    assert all(done <= total for done, total in told)
    known = {name: reading.value for name, reading in found.items()}
    assert told[-1] == (
        len(told),
        len(needed("ardupilot", sensors, known, drift=False) | needed("ardupilot", sensors, {}, drift=False)),
    )
    assert len(set(totals)) > 1


async def test_nobody_needs_to_be_told() -> None:
    vehicle = FakeVehicle.with_floats({"INS_GYR_ID": 5.0})
    assert set(await read_needed(vehicle, (Sensor.GYRO,), drift=False)) == {"INS_GYR_ID"}
