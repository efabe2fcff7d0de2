"""A slice of ``bench.slowlink``: vehicle and wire four times as fast, so that it takes seconds."""

from __future__ import annotations

import pytest

from bench.slowlink import LIMIT_S, WIRES, timed
from mavcal.service.jobs.core.states import JobState
from tests.patience import scaled

pytestmark = pytest.mark.timeout(240)
SILENCE_S = 5.0


@pytest.mark.long
@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
async def test_a_gyro_job_on_a_slow_wire_is_done_in_time_and_says_what_it_does(autopilot: str) -> None:
    run = await timed(WIRES[0], autopilot, speed=4.0)
    assert run.state == JobState.SUCCEEDED, run.outcome
    assert run.total_s <= LIMIT_S
    assert 10 < run.parameters < 100
    assert any(text.startswith("reading the calibration in force: ") for text in run.told)
    assert any(text.startswith("writing: ") for text in run.told)
    assert run.longest_silence_s < scaled(SILENCE_S)


@pytest.mark.long
async def test_the_start_and_the_restart_of_a_vehicle_have_phases_of_their_own() -> None:
    run = await timed(WIRES[0], "px4", speed=2.0)  # a job that begins late finds less of the start to wait for
    phases = dict(run.phases)
    assert run.state == JobState.SUCCEEDED, run.outcome
    assert phases["waiting for its start"] > 1.0  # of 5: 10 s of its own clock
    assert phases["restart"] > 0.5
    assert any(text.startswith("waiting for the vehicle to restart") for text in run.told)
    assert any(text.startswith("waiting until the vehicle has saved") for text in run.told)


@pytest.mark.long
async def test_a_gyro_job_on_a_slow_and_lossy_wire_succeeds() -> None:
    run = await timed(WIRES[1], "ardupilot", speed=4.0)
    assert run.state == JobState.SUCCEEDED, run.outcome
