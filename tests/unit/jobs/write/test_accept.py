from __future__ import annotations

import pytest

from mavcal.service.errors import IdempotencyConflict, IllegalTransition
from mavcal.service.jobs.core.model import Job
from mavcal.service.jobs.core.states import JobState
from mavcal.service.jobs.write.accept import Acceptance
from mavcal.service.store import SqliteStore
from tests.clock import ManualClock

DIGEST = "a" * 64


@pytest.fixture
def store():
    made = SqliteStore(None)
    yield made
    made.close()


@pytest.fixture
def acceptance(store):
    return Acceptance(store, ManualClock(7.0))


def test_one_write_of_a_job_begins_at_a_time(acceptance):
    with acceptance.claimed("j"):
        with pytest.raises(IllegalTransition, match="job j is being accepted"), acceptance.claimed("j"):
            pass
        with acceptance.claimed("k"):
            pass
        with pytest.raises(IllegalTransition), acceptance.claimed("j"):  # the refusal has freed nothing
            pass
    with acceptance.claimed("j"):
        pass


def test_an_accept_that_fails_frees_its_job(acceptance):
    with pytest.raises(ZeroDivisionError), acceptance.claimed("j"):
        raise ZeroDivisionError
    with acceptance.claimed("j"):
        pass


def job(name, state=JobState.APPLYING):
    return lambda: Job(name, "v", "gyro", {}, state, 0.0, 0.0)


async def test_the_same_request_under_the_same_key_was_taken_before(acceptance):
    assert not await acceptance.known("key", DIGEST, job("j"))
    await acceptance.use("key", DIGEST, "j")
    assert await acceptance.known("key", DIGEST, job("j"))
    for digest, name in (("b" * 64, "j"), (DIGEST, "k")):
        with pytest.raises(IdempotencyConflict):
            await acceptance.known("key", digest, job(name))
    assert not await acceptance.known("another", DIGEST, job("j"))


async def test_a_write_that_is_back_in_review_has_freed_its_key(acceptance, store):
    await acceptance.use("key", DIGEST, "j")
    with acceptance.claimed("j"):  # its accept is on the way to the disk: the state is that of before
        assert await acceptance.known("key", DIGEST, job("j", JobState.REVIEW))
    with pytest.raises(IdempotencyConflict):  # another job in review frees nothing
        await acceptance.known("key", DIGEST, job("k", JobState.REVIEW))
    assert not await acceptance.known("key", DIGEST, job("j", JobState.REVIEW))
    assert store.idempotency_key("key") is None
    await acceptance.use("key", "b" * 64, "j")


async def test_a_request_without_a_key_is_always_new(acceptance):
    await acceptance.use(None, DIGEST, "j")
    assert not await acceptance.known(None, DIGEST, job("j"))


async def test_who_asked_is_kept_before_anything_is_done(acceptance, store):
    await acceptance.note("me", "apply", "j", {"plan": "ab"})
    [row] = store.audit()
    assert (row.at, row.actor, row.action, row.subject, row.detail) == (7.0, "me", "apply", "j", {"plan": "ab"})
