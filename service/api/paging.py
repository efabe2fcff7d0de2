"""Pages of a list that grows."""

from __future__ import annotations

from collections.abc import Sequence

from mavcal.service.errors import JobUnknown
from mavcal.service.jobs.model import Job


def page_of(jobs: Sequence[Job], after: str | None, limit: int) -> tuple[Sequence[Job], bool]:
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
