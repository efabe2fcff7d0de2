from __future__ import annotations

import asyncio
from types import SimpleNamespace

import pytest

from mavcal.service.jobs.core.states import WRITING, JobState
from mavcal.service.jobs.core.tasks import JobTasks


def handle(name, state):
    return SimpleNamespace(id=name, job=SimpleNamespace(state=state))


class Taking:
    """Notes which job is taken up how; a write runs until it is told to end."""

    def __init__(self, *, alone_s=60.0, broken=(), idle=()):
        self.taken, self.broken, self.idle = [], set(broken), set(idle)
        self.ends, self.alone_s = asyncio.Event(), alone_s
        self.tasks = JobTasks(0.0, None, None)

    def begin(self, handles):
        self.tasks.resume(handles, self.recover, self.resume, alone_s=self.alone_s)

    def _take(self, how, one):
        self.taken.append((how, one.id))
        if one.id in self.broken:
            raise ZeroDivisionError

    def recover(self, one):
        self._take("recover", one)
        if one.id not in self.idle:
            self.tasks.running[one.id] = asyncio.ensure_future(self.ends.wait())

    def resume(self, one):
        self._take("resume", one)

    async def settle(self):
        for _ in range(5):
            await asyncio.sleep(0)


WRITE, OTHER_WRITE = handle("w", JobState.IN_DOUBT), handle("x", JobState.APPLYING)
CAPTURE, REVIEW = handle("c", JobState.RUNNING), handle("r", JobState.REVIEW)


async def test_writes_are_taken_up_first_and_the_others_when_these_have_ended():
    taking = Taking()
    taking.begin([CAPTURE, WRITE, REVIEW, OTHER_WRITE])
    await taking.settle()
    assert taking.taken == [("recover", "w"), ("recover", "x")]
    assert len(taking.tasks.resuming) == 1
    taking.ends.set()
    await taking.settle()
    assert taking.taken[2:] == [("resume", "c"), ("resume", "r")]
    assert not taking.tasks.resuming


async def test_without_writes_nobody_waits():
    taking = Taking()
    taking.begin([CAPTURE, REVIEW])
    assert taking.taken == [("resume", "c"), ("resume", "r")]
    assert not taking.tasks.resuming


async def test_a_write_that_does_not_end_keeps_the_others_waiting_for_a_while_only():
    taking = Taking(alone_s=0.0)
    taking.begin([WRITE, CAPTURE])
    await asyncio.gather(*taking.tasks.resuming)
    assert taking.taken == [("recover", "w"), ("resume", "c")]
    taking.ends.set()
    await taking.settle()


async def test_a_write_that_has_nothing_to_do_holds_nobody_up():
    taking = Taking(idle={"w"})
    taking.begin([WRITE, CAPTURE])
    assert taking.taken == [("recover", "w"), ("resume", "c")]


async def test_a_job_that_cannot_be_taken_up_strands_no_other():
    taking = Taking(broken={"w", "c"}, idle={"x"})
    taking.begin([WRITE, OTHER_WRITE, CAPTURE, REVIEW])
    assert taking.taken == [("recover", "w"), ("recover", "x"), ("resume", "c"), ("resume", "r")]


@pytest.mark.parametrize("state", JobState)
async def test_every_state_that_may_have_written_is_recovered(state):
    taking = Taking(idle={"j"})
    taking.begin([handle("j", state)])
    assert taking.taken == [("recover" if state in WRITING else "resume", "j")]
