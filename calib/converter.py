"""Dataclasses as JSON and back, by the types of their fields: one converter (cattrs) for all that is stored or sent.

Out: arrays, tuples and sets become lists, enums their values, numbers that are not finite null. In: null in place of a
number becomes NaN, integers stay integers, and a missing field gets its default. Nothing is guessed: text is not a
number, and an unknown field is an error.

A module whose types have a JSON form of their own makes or copies a converter and registers that form.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from enum import Enum
from types import NoneType, UnionType
from typing import Any, Literal, NoReturn, TypeVar, Union, get_args, get_origin

import numpy as np
from cattrs import Converter
from cattrs.errors import ForbiddenExtraKeysError, StructureHandlerNotFoundError
from cattrs.gen import make_dict_structure_fn

from mavcal.calib.errors import InvalidInputError

T = TypeVar("T")

_OF_CATTRS = (ForbiddenExtraKeysError, StructureHandlerNotFoundError)
_LISTED = (list, tuple, set, frozenset)


def make_converter() -> Converter:
    """A converter for dataclasses of numbers, texts, enums, arrays and each other."""
    made = Converter(
        detailed_validation=False, forbid_extra_keys=True, unstructure_fallback_factory=lambda _: _without_form
    )
    _write_with(made)
    _read_with(made)
    return made


def read(converter: Converter, data: Any, kind: type[T]) -> T:
    """`data`, out of JSON, as a `kind`.

    Raises
    ------
    InvalidInputError
        If it is not the JSON of one.
    """
    with _reading(kind):
        return converter.structure(data, kind)


def lenient(converter: Converter, kind: type[T]) -> Callable[[Any, type[T]], T]:
    """A reader of `kind` that ignores keys that are not fields: they repeat what the fields say."""
    return make_dict_structure_fn(kind, converter, _cattrs_forbid_extra_keys=False)


@contextmanager
def _reading(kind: type) -> Iterator[None]:
    """Turn any error while reading stored JSON into one typed error."""
    try:
        yield
    except InvalidInputError:
        raise
    except (KeyError, TypeError, ValueError, AttributeError, *_OF_CATTRS) as error:
        words = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", kind.__name__).lower()
        raise InvalidInputError(f"this is not the JSON of a {words}: {type(error).__name__} {error}") from error


def _write_with(made: Converter) -> None:
    def listed(values: Any) -> list[Any]:
        return [made.unstructure(value) for value in values]

    def array(values: np.ndarray | np.generic) -> Any:
        plain = values.tolist()
        whole = values.dtype.kind in "biu" or (values.dtype.kind == "f" and bool(np.isfinite(values).all()))
        return plain if whole else made.unstructure(plain)

    def mapping(values: Mapping[Any, Any]) -> dict[str, Any]:
        return {str(key): made.unstructure(value) for key, value in values.items()}

    # A hook of a class is that of its subclasses too: of enums that are texts, of numpy's numbers.
    made.register_unstructure_hook(str, lambda value: value.value if isinstance(value, Enum) else str(value))
    made.register_unstructure_hook(int, lambda value: value.value if isinstance(value, Enum) else int(value))
    made.register_unstructure_hook(float, lambda value: float(value) if math.isfinite(value) else None)
    made.register_unstructure_hook(bytes, _without_form)
    for kind in (bool, NoneType):
        made.register_unstructure_hook(kind, lambda value: value)
    made.register_unstructure_hook_func(_is_literal, made.unstructure)
    made.register_unstructure_hook_func(_is(Enum), lambda value: value.value)
    made.register_unstructure_hook_func(_is(*_LISTED), listed)
    made.register_unstructure_hook_func(_is(Mapping), mapping)
    made.register_unstructure_hook_func(_is(np.ndarray, np.generic), array)


def _read_with(made: Converter) -> None:
    for kind in (str, bool, int):
        made.register_structure_hook(kind, _of_kind)
    made.register_structure_hook(float, lambda value, _: math.nan if value is None else _number(value))
    made.register_structure_hook_func(_is_number, lambda value, _: None if value is None else _number(value))
    made.register_structure_hook_func(_is(Mapping), lambda value, kind: _mapping(made, value, kind))
    made.register_structure_hook_func(_is(np.ndarray), lambda value, _: np.array(value, dtype=np.float64))


def _without_form(value: Any) -> NoReturn:
    raise InvalidInputError(f"{type(value).__name__} has no form in JSON")


def _is(*kinds: type) -> Callable[[Any], bool]:
    """Whether a type, or what is subscripted in an annotation, is one of `kinds`."""

    def found(kind: Any) -> bool:
        own = get_origin(kind) or kind
        return isinstance(own, type) and issubclass(own, kinds)

    return found


def _is_literal(kind: Any) -> bool:
    origin: Any = get_origin(kind)
    return origin is Literal


def _is_number(kind: Any) -> bool:
    """Whether a type is ``float | int``, None allowed or not: which of the two, the JSON says."""
    among = set(get_args(kind)) if get_origin(kind) in {Union, UnionType} else set()
    return {float, int} <= among <= {float, int, NoneType}


def _of_kind(value: Any, kind: type[T]) -> T:
    if issubclass(kind, Enum):
        return kind(value)
    if type(value) is not kind:
        raise TypeError(f"{value!r} is no {kind.__name__}")
    return value


def _number(value: Any) -> float | int:
    if isinstance(value, bool) or not isinstance(value, float | int):
        raise TypeError(f"{value!r} is no number")
    return value


def _mapping(made: Converter, value: Any, kind: Any) -> dict[Any, Any]:
    if not isinstance(value, Mapping):
        raise TypeError(f"{value!r} is no object")
    keys, values = get_args(kind) or (Any, Any)
    return {made.structure(k, keys): made.structure(v, values) for k, v in value.items()}
