"""What a job says of itself while it runs."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from mavcal.service.jobs import handle as handle_module
from mavcal.service.jobs.handle import JobHandle, counting
from mavcal.service.jobs.model import Job
from mavcal.service.jobs.states import JobState
from mavcal.service.store import SqliteStore


@pytest.fixture
def handle() -> Iterator[JobHandle]:
    store = SqliteStore(None)
    found = JobHandle(Job("j1", "v", "gyro", {}, JobState.RUNNING, 0.0, 0.0), store, lambda _: None)
    found.change("state", {})
    yield found
    store.close()


def test_what_is_counted_estimates_the_rest_from_the_pace_so_far(
    handle: JobHandle, monkeypatch: pytest.MonkeyPatch
) -> None:
    now = [100.0]
    monkeypatch.setattr(handle_module.time, "monotonic", lambda: now[0])
    told = counting(handle, "reading")
    told(0, 40)
    assert handle.job.progress is not None
    assert handle.job.progress.eta is None
    now[0] = 103.0
    told(10, 40)
    progress = handle.job.progress
    assert (progress.current, progress.target, progress.eta) == (10.0, 40.0, 9.0)
    assert progress.text == "reading: 10 of 40"


def test_a_warning_is_kept_once_and_a_prompt_replaces_another(handle: JobHandle) -> None:
    handle.warn("slow")
    handle.warn("slow")
    handle.warn("slower")
    assert handle.job.warnings == ("slow", "slower")
    handle.prompt(None)
    assert handle.job.prompt is None
