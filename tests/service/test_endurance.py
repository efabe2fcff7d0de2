"""A slice of ``python -m bench.endurance``: what comes and goes leaves nothing behind in the process."""

from __future__ import annotations

import pytest

from bench.endurance import growth, run


@pytest.mark.long
@pytest.mark.timeout(300)
def test_three_busy_hours_leave_no_descriptor_thread_child_link_or_vehicle() -> None:
    section = run(3, seed=7)  # memory needs more hours to be judged
    rows = {row.what: row for row in section.rows if row.met is not None and row.what != "resident memory"}
    assert rows.keys() == {"open descriptors", "threads", "children", "links and vehicles known at the end"}
    assert [row for row in rows.values() if not row.met] == []
    assert "3 calibrations came to a review" in section.notes[0]


def test_growth_is_that_after_the_first_third() -> None:
    assert growth([10.0, 90.0, 100.0, 100.0, 100.0, 100.0]) == pytest.approx(0.0)
    assert growth([0.0, 50.0, 100.0, 110.0, 120.0, 130.0]) == pytest.approx(50.0)
