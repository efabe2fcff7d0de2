"""Computations in the database: asked for, begun by one worker at a time, and forgotten when nobody waits."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest

from mavcal.service.workers.orders import Computation, HowFar, Orders
from mavcal.service.workers.queue import lock_of

WANTED_S = 60.0
BODY = {"order": {"file": "uploads:r1", "third": 1 / 3}, "limits": {"cpu_s": 1.0}}


@pytest.fixture
def orders(database_url: str) -> Iterator[Orders]:
    made = Orders(database_url, WANTED_S)
    yield made
    made.close()


@pytest.fixture
def passes(orders: Orders) -> Callable[[float], None]:
    """Lets so many seconds pass by the database's clock: nobody has looked for so long."""

    def pass_by(seconds: float) -> None:
        orders._run("UPDATE computations SET wanted = wanted - make_interval(secs => ?)", (seconds,))

    return pass_by


def test_a_computation_goes_from_who_asks_to_who_computes_and_back(orders: Orders) -> None:
    orders.put("o1", "fit", BODY)
    assert orders.look("o1") == HowFar(None, None)
    assert orders.take("o1", "w1") == Computation("o1", "fit", BODY, 1)
    orders.report_progress("o1", "w1", "half")
    assert orders.look("o1") == HowFar("half", None)
    assert orders.wanted("o1", "w1")
    orders.finish("o1", "w1", {"done": {"x": 1 / 3}})
    assert orders.look("o1") == HowFar("half", {"done": {"x": 1 / 3}})
    assert orders.take("o1", "w2") is None  # it has ended
    orders.forget("o1")
    orders.forget("o1")
    assert orders.look("o1").result == {"lost": "its order is gone from the database"}
    assert orders.take("o1", "w1") is None


def test_a_worker_that_was_given_up_neither_tells_nor_ends_what_another_has_begun(orders: Orders) -> None:
    orders.put("o1", "fit", BODY)
    orders.take("o1", "w1")
    again = orders.take("o1", "w2")
    assert again is not None
    assert again.starts == 2
    assert (orders.wanted("o1", "w1"), orders.wanted("o1", "w2")) == (False, True)
    orders.report_progress("o1", "w1", "late")
    orders.finish("o1", "w1", {"done": "late"})
    assert orders.look("o1") == HowFar(None, None)
    orders.finish("o1", "w2", {"done": "in time"})
    assert orders.look("o1").result == {"done": "in time"}


def test_what_nobody_looks_for_is_neither_begun_nor_gone_on_with(
    orders: Orders, passes: Callable[[float], None]
) -> None:
    orders.put("o1", "fit", BODY)
    orders.take("o1", "w1")
    passes(0.9 * WANTED_S)
    assert orders.wanted("o1", "w1")
    orders.look("o1")  # which says that somebody waits still
    passes(0.9 * WANTED_S)
    assert orders.wanted("o1", "w1")
    passes(0.2 * WANTED_S)
    assert not orders.wanted("o1", "w1")
    assert orders.take("o1", "w2") is None
    orders.look("o1")
    assert orders.take("o1", "w2") is not None  # whoever asked is back


def test_only_what_was_not_looked_for_in_long_is_swept(orders: Orders, passes: Callable[[float], None]) -> None:
    orders.put("old", "fit", BODY)
    passes(WANTED_S + 3601.0)
    orders.put("new", "fit", BODY)
    orders.sweep(3600.0)
    assert orders.look("old").result is not None
    assert orders.look("new") == HowFar(None, None)


def test_a_number_that_is_not_finite_is_kept_on_neither_side(orders: Orders) -> None:
    orders.put("o1", "fit", BODY)
    orders.take("o1", "w1")
    with pytest.raises(ValueError, match="JSON"):
        orders.put("o2", "fit", {"x": float("nan")})
    with pytest.raises(ValueError, match="JSON"):
        orders.finish("o1", "w1", {"x": float("inf")})
    assert orders.look("o1") == HowFar(None, None)
    assert "lost" in (orders.look("o2").result or {})


def test_recordings_of_one_vehicle_are_computed_one_after_the_other() -> None:
    assert lock_of("o1", "v1") == lock_of("o2", "v1") != lock_of("o1", "v2")
    assert lock_of("o1", None) != lock_of("o2", None)
    assert lock_of("v1", None) != lock_of("o1", "v1")  # an order and a vehicle may share a name
    assert lock_of("o1", "") == lock_of("o1", None)
