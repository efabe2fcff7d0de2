"""A slice of ``bench.slowlink``: vehicle and wire four times as fast, so that it takes seconds."""

from __future__ import annotations

import pytest

from bench.slowlink import LIMIT_S, WIRES, timed
from service.jobs.states import JobState

pytestmark = pytest.mark.timeout(240)


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
async def test_a_gyro_job_on_a_slow_wire_is_done_in_time_and_says_what_it_does(autopilot: str) -> None:
    run = await timed(WIRES[0], autopilot, speed=4.0)
    assert run.state == JobState.SUCCEEDED, run.outcome
    assert run.total_s <= LIMIT_S
    assert 10 < run.parameters < 100
    assert any(text.startswith("reading the calibration in force: ") for text in run.told)
    assert any(text.startswith("writing: ") for text in run.told)


async def test_a_gyro_job_on_a_slow_and_lossy_wire_succeeds() -> None:
    run = await timed(WIRES[1], "ardupilot", speed=4.0)
    assert run.state == JobState.SUCCEEDED, run.outcome
