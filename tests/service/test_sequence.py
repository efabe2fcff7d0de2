"""What a person does one after the other: each calibration on top of what the one before has written."""

from __future__ import annotations

import pytest

from bench.sequence import KINDS, sequence, table
from mavcal.service.jobs.core.states import JobState


@pytest.mark.long
@pytest.mark.timeout(600)
@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
async def test_every_calibration_in_a_row_is_proved_or_tells_its_reason(autopilot: str) -> None:
    rows = await sequence(autopilot, seed=61)
    assert [row.kind for row in rows] == list(KINDS), table(rows)
    assert {row.state for row in rows} == {JobState.SUCCEEDED}, table(rows)
    for row in rows:
        assert row.good, table(rows)
        assert row.right == row.judged, table(rows)
    by_kind = {row.kind: row for row in rows}
    assert 0 < by_kind["level"].acting == by_kind["level"].proved, table(rows)  # with an accelerometer's in force
    shown = [row for row in rows if row.acting]  # PX4 streams its compasses raw
    assert all(2 * row.proved > row.acting for row in shown), table(rows)
    assert {kind for kind, row in by_kind.items() if row.judged} >= {"gyro", "accel", "level", "thermal"}
