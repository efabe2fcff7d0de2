"""Pages of a list that grows."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

from mavcal.service.errors import JobUnknown
from mavcal.service.jobs.core.model import Job
from mavcal.service.store.rows import JobRow

Listed = TypeVar("Listed", Job, JobRow)


def page_of(jobs: Sequence[Listed], after: str | None, limit: int) -> tuple[Sequence[Listed], bool]:
    """The jobs behind the one with the id `after`, at most `limit`, and whether there are more.

    Raises
    ------
    JobUnknown
        If there is no job of that id in the list.
    """
    begin = 0
    if after is not None:
        begin = next((i for i, job in enumerate(jobs, 1) if job.id == after), 0)
        if begin == 0:
            raise JobUnknown(f"there is no job {after} to go on from: begin with the first page")
    return jobs[begin : begin + limit], begin + limit < len(jobs)
