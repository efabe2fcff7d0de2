"""Numbers with one value for each variant of a table: a process forks only where the values lead to different steps.

A search that reads a price compares what it computed with it. As long as every variant of the price decides alike, one
process stands for all of them. At the first comparison that differs, the process forks: the child goes on as that
variant, and hands its answer back. Code that needs a plain number (an index, an array, a logarithm of ``math``) gets
one, and every variant whose number differs is forked there. The answers are those of separate runs.
"""

from __future__ import annotations

import json
import math
import operator
import os
import traceback
from collections.abc import Callable, Iterable, Mapping
from typing import Any, SupportsIndex

import numpy as np

Variant = tuple[str, int]
"""The name of an entry, and which other value it has."""


class VariantProcess:
    """The variants that the process stands for; in a child, the one that it is."""

    def __init__(self, variants: Iterable[Variant]) -> None:
        self.open = set(variants)
        self.own: Variant | None = None
        """The variant that a child follows; None in the parent."""
        self.answers: dict[Variant, Any] = {}
        self._pipe: int | None = None

    def close(self, variant: Variant, answer: object) -> None:
        """From here on `variant` is not followed: its answer is known."""
        self.open.discard(variant)
        self.answers[variant] = answer

    def divide(self, variants: Iterable[Variant]) -> None:
        """Fork a child for each of `variants` that is open, and wait for its answer."""
        for variant in sorted(self.open.intersection(variants)):
            reading, writing = os.pipe()
            child = os.fork()
            if child == 0:
                os.close(reading)
                self.open, self.own, self._pipe = set(), variant, writing
                return
            os.close(writing)
            with os.fdopen(reading) as pipe:
                text = pipe.read()
            if os.waitpid(child, 0)[1] != 0:
                raise RuntimeError(f"the run with another {variant[0]} failed: its traceback stands above")
            self.close(variant, json.loads(text))

    def end_child(self, answer: object) -> None:
        """A child hands its answer on and ends; the parent goes on."""
        if self._pipe is not None:
            os.write(self._pipe, json.dumps(answer).encode())
            os._exit(0)

    def fail_child(self) -> None:
        """The same for a child that failed."""
        if self._pipe is not None:
            traceback.print_exc()
            os._exit(1)


class VariantNumber:
    """A number, and what it is in the variants in which it differs.

    Sums and products carry all values along; a comparison returns a plain bool, after a fork where variants disagree.
    """

    __slots__ = ("others", "plain", "process")

    def __init__(self, plain: Any, others: Mapping[Variant, Any], process: VariantProcess) -> None:
        self.plain, self.others, self.process = plain, others, process

    def settled(self) -> Any:
        """The plain number of this process, after a fork of every variant that has another."""
        self.process.divide(v for v, other in self.others.items() if other != self.plain)
        return value_in(self.process.own, self)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> Any:
        return np.array(self.settled(), dtype)

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **options: Any) -> Any:
        return _computed(self.process, lambda *own: getattr(ufunc, method)(*own, **options), inputs)

    def __float__(self) -> float:
        return float(self.settled())

    def __int__(self) -> int:
        return int(self.settled())

    def __index__(self) -> int:
        return operator.index(self.settled())

    def __bool__(self) -> bool:
        return bool(_computed(self.process, bool, (self,)))

    def __hash__(self) -> int:
        return hash(self.settled())

    def __format__(self, spec: str) -> str:
        return format(self.settled(), spec)

    def __repr__(self) -> str:
        return repr(self.settled())

    def __round__(self, digits: SupportsIndex | None = None) -> Any:
        return round(self.settled(), digits)

    def __neg__(self) -> Any:
        return _computed(self.process, operator.neg, (self,))

    def __abs__(self) -> Any:
        return _computed(self.process, abs, (self,))

    def __eq__(self, other: object) -> bool:
        return bool(_computed(self.process, operator.eq, (self, other)))

    def __lt__(self, other: Any) -> Any:
        return _computed(self.process, operator.lt, (self, other))

    def __le__(self, other: Any) -> Any:
        return _computed(self.process, operator.le, (self, other))

    def __gt__(self, other: Any) -> Any:
        return _computed(self.process, operator.gt, (self, other))

    def __ge__(self, other: Any) -> Any:
        return _computed(self.process, operator.ge, (self, other))

    def __add__(self, other: Any) -> Any:
        return _computed(self.process, operator.add, (self, other))

    def __radd__(self, other: Any) -> Any:
        return _computed(self.process, operator.add, (other, self))

    def __sub__(self, other: Any) -> Any:
        return _computed(self.process, operator.sub, (self, other))

    def __rsub__(self, other: Any) -> Any:
        return _computed(self.process, operator.sub, (other, self))

    def __mul__(self, other: Any) -> Any:
        return _computed(self.process, operator.mul, (self, other))

    def __rmul__(self, other: Any) -> Any:
        return _computed(self.process, operator.mul, (other, self))

    def __truediv__(self, other: Any) -> Any:
        return _computed(self.process, operator.truediv, (self, other))

    def __rtruediv__(self, other: Any) -> Any:
        return _computed(self.process, operator.truediv, (other, self))

    def __pow__(self, other: Any) -> Any:
        return _computed(self.process, operator.pow, (self, other))


def value_in(variant: Variant | None, value: Any) -> Any:
    """What `value` is in `variant`; None: in none."""
    if not isinstance(value, VariantNumber):
        return value
    return value.plain if variant is None else value.others.get(variant, value.plain)


def _computed(process: VariantProcess, function: Callable[..., Any], inputs: tuple[Any, ...]) -> Any:
    """A function of `inputs` in every variant: one number for all, or what they agree on after a fork."""
    if process.own is not None:
        return function(*(value_in(process.own, one) for one in inputs))
    plain = function(*(value_in(None, one) for one in inputs))
    concerned = process.open.intersection(*[set().union(*(one.others for one in inputs if _varies(one)))])
    others = {v: function(*(value_in(v, one) for one in inputs)) for v in concerned}
    others = {v: other for v, other in others.items() if not _same(other, plain)}
    if not others:
        return plain
    if isinstance(plain, int | float | np.number) and not isinstance(plain, bool):
        return VariantNumber(plain, others, process)
    process.divide(others)
    return plain if process.own is None else others[process.own]


def _varies(value: object) -> bool:
    return isinstance(value, VariantNumber)


def _same(one: Any, other: Any) -> bool:
    if isinstance(one, np.ndarray):
        return np.array_equal(one, other, equal_nan=one.dtype.kind == "f")
    return bool(one == other) or (isinstance(one, float) and math.isnan(one) and math.isnan(other))
