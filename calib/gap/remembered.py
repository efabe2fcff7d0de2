"""Results that one diagnosis asks for again and again, remembered as long as it lasts.

A diagnosis asks for the same transforms, columns and fits many times. They are kept in a store that begins and ends
with it. Nothing of one recording outlives its report, and no two diagnoses share anything.

The store is a context variable: a thread that is started inside a diagnosis has none, and computes. A process that is
forked inside has a copy of its own.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from functools import wraps
from typing import Any, Final, ParamSpec, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

P = ParamSpec("P")
R = TypeVar("R")

_ABSENT: Final = object()


class SameArray:
    """An array as a key: equal to itself alone, whatever numbers it holds.

    It holds the array, so that no later array can have its id while the key exists.
    """

    __slots__ = ("array",)

    def __init__(self, array: NDArray[Any]) -> None:
        self.array = array

    def __hash__(self) -> int:
        return id(self.array)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, SameArray) and other.array is self.array


class ResultStore:
    """Results by function and arguments; of each function the ones that were asked for last."""

    def __init__(self) -> None:
        self._by_function: dict[Callable[..., Any], dict[Hashable, Any]] = {}

    def __len__(self) -> int:
        return sum(map(len, self._by_function.values()))

    def result(self, function: Callable[..., R], key: Hashable, most: int, compute: Callable[[], R]) -> R:
        """What `compute` returns, or returned for this `key` before, if it is among the last `most` of `function`."""
        own = self._by_function.setdefault(function, {})
        found = own.pop(key, _ABSENT)
        if found is _ABSENT:
            found = compute()
        own[key] = found  # the last one asked for is the last one to go
        if len(own) > most:
            own.pop(next(iter(own)), None)
        return cast("R", found)


_STORE: ContextVar[ResultStore | None] = ContextVar("mavcal_gap_store", default=None)


@contextmanager
def one_diagnosis() -> Iterator[ResultStore]:
    """A store for what is computed inside, also as a decorator; inside another one the outer store serves."""
    outer = _STORE.get()
    if outer is not None:
        yield outer
        return
    store = ResultStore()
    token = _STORE.set(store)
    try:
        yield store
    finally:
        _STORE.reset(token)


def remembered(most: int) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """A pure function whose last `most` results are kept by the store of the diagnosis; without one it computes.

    Arrays among the arguments are told apart by identity, all others by equality. Neither the arguments nor the
    result may be changed in place.
    """

    def decorated(function: Callable[P, R]) -> Callable[P, R]:
        @wraps(function)
        def asked(*args: P.args, **kwargs: P.kwargs) -> R:
            store = _STORE.get()
            if store is None:
                return function(*args, **kwargs)
            key = (*map(_key, args), *((name, _key(value)) for name, value in sorted(kwargs.items())))
            return store.result(function, key, most, lambda: function(*args, **kwargs))

        return asked

    return decorated


def _key(value: Any) -> Hashable:
    return SameArray(value) if isinstance(value, np.ndarray) else cast("Hashable", value)
