"""Vehicles and links are looked at once for all event streams."""

from __future__ import annotations

import asyncio
from contextlib import aclosing

import pytest

from mavcal.service.api import jobs
from mavcal.service.api.jobs import ChangeWatch, State
from mavcal.service.api.models.vehicles import LinkModel

STREAMS = 40


def link(state: str) -> LinkModel:
    return LinkModel(id="l", url="tcp:v:1", state=state, reason="", vehicles=[], crc_errors=0, signing_key=None)


async def test_one_look_serves_every_stream_and_the_last_one_ends_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(jobs, "LOOK_S", 0.001)
    looks, heard = 0, 0
    changed = asyncio.Event()

    def look() -> list[tuple[str, State]]:
        nonlocal looks
        looks += changed.is_set()
        return [("link", link("down" if changed.is_set() else "up"))]

    watch = ChangeWatch(look)

    async def stream() -> list[str]:
        nonlocal heard
        found: list[str] = []
        async with aclosing(watch.changes()) as states:  # type: ignore[type-var]
            async for _, state in states:
                assert isinstance(state, LinkModel)
                found.append(state.state)
                heard += 1
                if heard == STREAMS:  # everybody has the first state
                    changed.set()
                if len(found) == 2:
                    return found
        raise AssertionError("it ended")

    async with asyncio.timeout(60):
        told = await asyncio.gather(*(stream() for _ in range(STREAMS)))
    assert told == [["up", "down"]] * STREAMS
    assert looks < STREAMS  # one at a time for all of them; each stream for itself made one at least
    after = looks
    for _ in range(20):
        await asyncio.sleep(0)
    assert looks == after
    assert [task for task in asyncio.all_tasks() if task is not asyncio.current_task()] == []


async def test_a_state_that_cannot_be_told_once_does_not_end_the_streams(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(jobs, "LOOK_S", 0.001)
    looks = 0

    def look() -> list[tuple[str, State]]:
        nonlocal looks
        looks += 1
        if looks == 2:
            raise RuntimeError("a defect")
        return [("link", link("up" if looks < 3 else "down"))]

    async with asyncio.timeout(60), aclosing(ChangeWatch(look).changes()) as states:  # type: ignore[type-var]
        assert [(await anext(states))[1].state, (await anext(states))[1].state] == ["up", "down"]  # type: ignore[union-attr]
