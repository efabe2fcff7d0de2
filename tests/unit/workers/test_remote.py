from __future__ import annotations

import asyncio
from pathlib import Path
from types import SimpleNamespace

import pytest

from mavcal.calib.errors import UnreadableError
from mavcal.service.children.limits import Limits
from mavcal.service.errors import ChildEnded, StoreError
from mavcal.service.workers import remote
from mavcal.service.workers.orders import HowFar
from mavcal.service.workers.remote import RemoteChildren

LIMITS = Limits(1 << 30, 10.0, 20.0)
UPLOADS = Path("/uploads")
DONE = HowFar(None, {"done": {"fits": []}})


class Orders:
    """The database's orders: each look is the next of `looks`; an error is raised."""

    def __init__(self, *looks):
        self.looks, self.put_in, self.forgotten = list(looks), [], []
        self.away = False

    def put(self, order_id, task, body):
        self.put_in.append((order_id, task, body))

    def look(self, order_id):
        assert order_id == self.put_in[-1][0]
        found = self.looks.pop(0) if len(self.looks) > 1 else self.looks[0]
        if isinstance(found, Exception):
            raise found
        return found

    def forget(self, order_id):
        if self.away:
            raise StoreError("it is away")
        self.forgotten.append(order_id)


class Queue:
    """The queue of workers: what was deferred and cancelled."""

    def __init__(self):
        self.deferred, self.cancelled, self.broken = [], [], False
        self.job_manager = self

    def configure_task(self, name, *, queue, lock):
        async def defer(computation):
            self.deferred.append((computation, lock))
            return 17

        return SimpleNamespace(defer_async=defer)

    async def cancel_job_by_id_async(self, number, *, abort):
        if self.broken:
            raise RuntimeError("the queue is away")
        self.cancelled.append((number, abort))


@pytest.fixture
def children(monkeypatch):
    """Remote children whose orders are found so, and their queue."""
    monkeypatch.setattr(remote, "LOOK_S", 0.0)
    queue = Queue()
    monkeypatch.setattr(remote, "app_of", lambda _url: queue)

    def make(*looks):
        orders = Orders(*looks)
        monkeypatch.setattr(remote, "Orders", lambda _url, _wanted_s: orders)
        return RemoteChildren("postgresql://h/n", UPLOADS, 30.0), orders, queue

    return make


async def test_a_computation_is_ordered_waited_for_and_forgotten(children):
    made, orders, queue = children(HowFar(None, None), DONE)
    order = {"path": "/uploads/a.bin", "vehicle": "00ab"}
    assert await made.run("fit", order, LIMITS) == {"fits": []}
    [(order_id, task, body)] = orders.put_in
    assert task == "fit"
    assert body["order"] == {"path": "uploads:a.bin", "vehicle": "00ab"}
    assert body["limits"] == {"memory_bytes": 1 << 30, "cpu_s": 10.0, "wall_s": 20.0}
    assert [computation for computation, _ in queue.deferred] == [order_id]
    assert orders.forgotten == [order_id]
    assert queue.cancelled == [(17, True)]
    assert order["path"] == "/uploads/a.bin"


async def test_computations_of_one_vehicle_share_a_lock_and_others_have_their_own(children):
    made, _, queue = children(DONE)
    for vehicle in ("00ab", "00ab", "00cd", None, None):
        await made.run("fit", {"path": "x", "vehicle": vehicle}, LIMITS)
    locks = [lock for _, lock in queue.deferred]
    assert locks[0] == locks[1] != locks[2]
    assert len(set(locks)) == 4


async def test_every_step_is_told_once(children):
    steps = [HowFar(said, None) for said in (None, "a", "a", "b", None, "b")]
    made, _, _ = children(*steps, HowFar("b", DONE.result))
    said = []
    await made.run("fit", {}, LIMITS, progress=said.append)
    assert said == ["a", "b", "b"]


async def test_a_database_that_is_away_is_waited_for(children):
    made, _, _ = children(StoreError("it is away"), StoreError("it is away"), DONE)
    assert await made.run("fit", {}, LIMITS) == {"fits": []}


@pytest.mark.parametrize(
    ("result", "error", "said"),
    [
        ({"refused": {"kind": "UnreadableError", "text": "it has no header"}}, UnreadableError, "it has no header"),
        ({"ended": "it took too long"}, ChildEnded, "it took too long"),
        ({"lost": "its order is gone"}, ChildEnded, "its order is gone"),
    ],
)
async def test_what_a_worker_could_not_do_is_an_error_here(children, result, error, said):
    made, orders, queue = children(HowFar(None, result))
    with pytest.raises(error, match=said):
        await made.run("fit", {}, LIMITS)
    assert len(orders.forgotten) == len(queue.cancelled) == 1


async def test_a_computation_that_nobody_waits_for_is_ended(children):
    made, orders, queue = children(HowFar(None, None))
    running = asyncio.ensure_future(made.run("fit", {}, LIMITS))
    while not queue.deferred:  # noqa: ASYNC110 - a thread puts the order in
        await asyncio.sleep(0)
    running.cancel()
    with pytest.raises(asyncio.CancelledError):
        await running
    while not queue.cancelled:  # noqa: ASYNC110 - it is shielded, and ends by itself
        await asyncio.sleep(0)
    assert len(orders.forgotten) == 1


async def test_what_cannot_be_cleared_away_spoils_no_result(children):
    made, orders, queue = children(DONE)
    orders.away = queue.broken = True
    assert await made.run("fit", {}, LIMITS) == {"fits": []}
