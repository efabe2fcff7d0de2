"""Which connections have to go that never ask for anything."""

from __future__ import annotations

import asyncio

from mavcal.service.http import Waiting
from mavcal.service.settings import LimitSettings


class Transport:
    """A connection, and whether it was cut off."""

    def __init__(self):
        self.cut = False

    def abort(self):
        self.cut = True


async def test_of_too_many_connections_without_a_head_the_oldest_goes():
    waiting = Waiting(LimitSettings(head_s=60.0, heads=2))
    first, second, third, fourth = (Transport() for _ in range(4))
    for transport in (first, second, first, third):  # to begin again makes nobody younger
        waiting.begins(transport)
    assert [t.cut for t in (first, second, third)] == [True, False, False]
    waiting.ends(second)
    waiting.begins(fourth)
    assert [t.cut for t in (second, third, fourth)] == [False, False, False]
    for transport in (third, fourth, fourth):
        waiting.ends(transport)
    assert not waiting._timers


async def test_a_connection_has_so_long_for_its_head():
    waiting = Waiting(LimitSettings(head_s=1e-9))
    slow, quick = Transport(), Transport()
    waiting.begins(slow)
    waiting.begins(quick)
    waiting.ends(quick)
    for _ in range(3):
        await asyncio.sleep(0)
    assert (slow.cut, quick.cut) == (True, False)
