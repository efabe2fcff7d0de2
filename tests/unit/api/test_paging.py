from __future__ import annotations

import pytest

from mavcal.service.api.paging import page_of
from mavcal.service.errors import JobUnknown
from mavcal.service.jobs.core.model import Job
from mavcal.service.jobs.core.states import JobState

JOBS = [Job(f"j{i}", "v", "gyro", {}, JobState.FAILED, float(i), float(i)) for i in range(7)]


@pytest.mark.parametrize("limit", [1, 2, 3, 7, 100])
def test_pages_are_the_list_without_a_gap(limit):
    seen, after, more = [], None, True
    while more:
        page, more = page_of(JOBS, after, limit)
        assert 1 <= len(page) <= limit
        seen += page
        after = page[-1].id
    assert seen == JOBS


def test_a_place_that_is_not_there_is_an_error():
    with pytest.raises(JobUnknown):
        page_of(JOBS, "j9", 2)
    assert page_of([], None, 2) == ([], False)
