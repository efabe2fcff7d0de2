from __future__ import annotations

import asyncio
import threading

import pytest

from mavcal.service.store.sqlrows import WriteLine


@pytest.fixture
def line():
    made = WriteLine()
    yield made
    made.close()


async def test_work_is_done_one_after_the_other_in_the_order_of_asking(line):
    gate, done = threading.Event(), []
    line.soon(lambda: (gate.wait(), done.append("first")))
    line.soon(lambda: done.append("second"))
    third = asyncio.ensure_future(line.do(lambda: done.append("third") or 7))
    await asyncio.sleep(0)
    assert done == []
    gate.set()
    assert await third == 7
    assert done == ["first", "second", "third"]


async def test_an_error_is_that_of_whoever_asked(line):
    with pytest.raises(ZeroDivisionError):
        await line.do(lambda: 1 // 0)
    assert await line.do(lambda: 7) == 7


async def test_a_caller_that_is_cancelled_leaves_when_its_work_is_done(line):
    gate, done = threading.Event(), []
    caller = asyncio.ensure_future(line.do(lambda: (gate.wait(), done.append("written"))))
    await asyncio.sleep(0)
    for _ in range(2):  # however often
        caller.cancel()
        await asyncio.sleep(0)
    assert not caller.done()
    gate.set()
    with pytest.raises(asyncio.CancelledError):
        await caller
    assert done == ["written"]


async def test_an_error_that_nobody_waits_for_any_more_is_dropped(line):
    gate = threading.Event()
    caller = asyncio.ensure_future(line.do(lambda: (gate.wait(), 1 // 0)))
    await asyncio.sleep(0)
    caller.cancel()
    await asyncio.sleep(0)
    gate.set()
    with pytest.raises(asyncio.CancelledError):
        await caller


def test_whoever_catches_up_finds_everything_done(line):
    done = []
    line.caught_up()  # nothing was asked for yet
    for number in range(50):
        line.soon(lambda number=number: done.append(number))
    line.caught_up()
    assert done == list(range(50))


def test_the_line_itself_does_not_wait_for_itself(line):
    future = line.soon(lambda: line.caught_up() or "through")
    assert future.result(5.0) == "through"


def test_what_is_left_is_done_at_the_end():
    made, gate, done = WriteLine(), threading.Event(), []
    made.soon(gate.wait)
    made.soon(lambda: done.append("left"))
    gate.set()
    made.close()
    assert done == ["left"]
