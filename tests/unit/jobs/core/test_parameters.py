"""What a job rests on is read by name, and how far that is gets told."""

from __future__ import annotations

import numpy as np
import pytest

from mavcal.calib.firmware.in_force.needed import needed
from mavcal.calib.fit import FitResult, FitStatus, parameter_names
from mavcal.calib.recording import Sensor
from mavcal.calib.triad import ThermalPolynomial, TriadModel
from mavcal.service.jobs.core.model import Job
from mavcal.service.jobs.core.parameters import read_needed, require_absent
from mavcal.service.jobs.core.states import JobState
from mavcal.service.vehicle.job_vehicle import ParameterReading
from tests.unit.jobs.fakes import FakeVehicle

IDS = ("INS_ACC_ID", "INS_ACC2_ID", "INS_GYR_ID", "INS_GYR2_ID")


async def test_the_count_grows_by_one_and_its_total_by_what_turns_out_to_be_needed() -> None:
    vehicle = FakeVehicle.with_floats({**dict.fromkeys(IDS, 5.0), "INS_GYROFFS_X": 0.25, "INS_GYR2OFFS_X": 0.5})
    told: list[tuple[int, int]] = []
    sensors = (Sensor.ACCEL, Sensor.GYRO)
    found = await read_needed(vehicle, sensors, drift=False, progress=lambda done, total: told.append((done, total)))
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


def fit(*, drifts: bool) -> FitResult:
    model = TriadModel(polynomial=ThermalPolynomial(25.0, 0.0, 50.0, np.zeros((3, 3))) if drifts else None)
    size = len(parameter_names(3 if drifts else 0))
    covariance = np.zeros((size, size))
    return FitResult("test", Sensor.GYRO, 0, FitStatus.OK, "", model, covariance, "rad/s", 1, 1, 0.0, 1.0)


@pytest.mark.parametrize(
    ("kind", "drifts", "asked"),
    [("thermal", True, True), ("thermal", False, False), ("gyro", True, False), ("gyro", False, False)],
)
async def test_coefficients_are_asked_for_again_only_where_they_are_written(
    kind: str, drifts: bool, asked: bool
) -> None:
    """A thermal job writes them where a drift was found; what the vehicle did not have is asked for once more."""
    there = {**dict.fromkeys(IDS, 5.0), "INS_TCAL1_ENABLE": 0.0, "INS_TCAL2_ENABLE": 0.0}
    vehicle = FakeVehicle.with_floats(there)
    names: list[str] = []
    read = vehicle.read_parameter

    async def noted(name: str) -> ParameterReading:
        names.append(name)
        return await read(name)

    vehicle.read_parameter = noted  # type: ignore[method-assign]
    job = Job("one", vehicle.id, kind, {}, JobState.REVIEW, 0.0, 0.0, results=(fit(drifts=drifts),))
    told: list[tuple[int, int]] = []
    await require_absent(vehicle, job, there, lambda done, total: told.append((done, total)))
    counts, (total,) = [done for done, _ in told], {total for _, total in told}
    assert counts == list(range(total + 1))  # none yet, then one after the other: a slow link shows that it goes on
    assert total == len(names)
    await require_absent(vehicle, job, there)  # nobody needs to be told
    assert any(name.startswith("INS_TCAL1_GYR") for name in names) is asked
    assert "INS_GYROFFS_X" in names
