"""Cache of results that one diagnosis needs repeatedly.

A diagnosis computes the same transforms, columns and fits many times. Its cache begins and ends with it, so nothing
outlives the report and no two diagnoses share a result. The cache is a context variable: a thread started inside a
diagnosis has none and computes; a forked process has a copy.
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

ABSENT: Final = object()
"""Stands for a missing result, since None may be a result."""


class SameArray:
    """An array as a key: equal only to itself, whatever its values.

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
    """Results by function and arguments; of each function the latest ones."""

    def __init__(self) -> None:
        self._by_function: dict[Callable[..., Any], dict[Hashable, Any]] = {}

    def __len__(self) -> int:
        return sum(map(len, self._by_function.values()))

    def taken(self, function: Callable[..., Any], key: Hashable) -> Any:
        """The result of `function` for `key`, removed until it is kept again; `ABSENT` if there is none."""
        return self._by_function.setdefault(function, {}).pop(key, ABSENT)

    def keep(self, function: Callable[..., Any], key: Hashable, result: Any, most: int) -> None:
        """Keep a result as the latest of `function`; of more than `most` the oldest is dropped."""
        own = self._by_function.setdefault(function, {})
        own[key] = result
        if len(own) > most:
            own.pop(next(iter(own)), None)


_STORE: ContextVar[ResultStore | None] = ContextVar("mavcal_gap_store", default=None)


@contextmanager
def one_diagnosis() -> Iterator[ResultStore]:
    """A store for everything inside, also as a decorator; nested calls use the outer store."""
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
    """Decorator: keep the last `most` results of a pure function during a diagnosis; outside one it just computes.

    Arrays among the arguments are compared by identity, all others by equality. Neither arguments nor results may be
    changed in place.
    """

    def decorated(function: Callable[P, R]) -> Callable[P, R]:
        @wraps(function)
        def asked(*args: P.args, **kwargs: P.kwargs) -> R:
            store = _STORE.get()
            if store is None:
                return function(*args, **kwargs)
            key = (*map(_key, args), *((name, _key(value)) for name, value in sorted(kwargs.items())))
            found = store.taken(function, key)
            if found is ABSENT:
                found = function(*args, **kwargs)
            store.keep(function, key, found, most)
            return cast("R", found)

        return asked

    return decorated


def _key(value: Any) -> Hashable:
    return SameArray(value) if isinstance(value, np.ndarray) else cast("Hashable", value)
