"""Dataclasses through JSON: the same bits come back, and nothing is guessed."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from mavcal.calib.converter import lenient, make_converter, read
from mavcal.calib.errors import InvalidInputError

CONVERTER = make_converter()


class Colour(StrEnum):
    RED = "red"


@dataclass(frozen=True)
class Part:
    name: str
    value: float | int
    colour: Colour | None = None


@dataclass(frozen=True)
class WholeThing:
    count: int
    size: float
    sure: bool
    path: Path
    parts: tuple[Part, ...] = ()
    pair: tuple[str, int] | None = None
    best: float | int | None = None
    detail: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Kept:
    where: Literal["settings", "file"]


@dataclass(frozen=True, eq=False)
class Drawn:
    values: NDArray[np.float64]


WHOLE = WholeThing(
    3, 0.5, sure=True, path=Path("a/b"), parts=(Part("p", 1, Colour.RED), Part("q", 1.0)), pair=("x", 2), best=7,
    detail={"a": [1, 2.5, None, {"b": "c"}]},
)  # fmt: skip


def told(value: Any) -> Any:
    return json.loads(json.dumps(CONVERTER.unstructure(value), allow_nan=False))


def test_a_whole_comes_back_with_its_parts_and_its_types():
    back = read(CONVERTER, told(WHOLE), WholeThing)
    assert back == WHOLE
    assert [type(part.value) for part in back.parts] == [int, float]
    assert type(back.best) is int


@given(
    st.integers(), st.floats(allow_nan=False, allow_infinity=False), st.booleans(), st.text(), st.none() | st.integers()
)
def test_every_value_comes_back_exactly(count, size, sure, name, best):
    whole = WholeThing(count, size, sure, Path("a"), (Part(name, size), Part(name, count)), best=best)
    assert read(CONVERTER, told(whole), WholeThing) == whole


def test_what_was_never_written_has_its_default():
    data = {"count": 1, "size": 2.0, "sure": False, "path": "a"}
    assert read(CONVERTER, data, WholeThing) == WholeThing(1, 2.0, sure=False, path=Path("a"))


def test_a_number_that_is_not_finite_is_null_and_comes_back_as_nan():
    assert told(Part("p", math.inf)) == {"name": "p", "value": None, "colour": None}
    data = {**told(WHOLE), "size": None}
    assert math.isnan(read(CONVERTER, data, WholeThing).size)
    assert told(Drawn(np.array([[1.0, np.nan], [np.inf, 2.0]]))) == {"values": [[1.0, None], [None, 2.0]]}


@pytest.mark.parametrize(
    ("value", "form"),
    [
        (np.float64(0.5), 0.5),
        (np.float32("nan"), None),
        (np.int16(3), 3),
        (np.array([True, False]), [True, False]),
        (np.array(["a", "b"]), ["a", "b"]),
        ((1, {2.5}), [1, [2.5]]),
        ({Colour.RED: Colour.RED, 1: (None,)}, {"red": "red", "1": [None]}),
        (Path("a/b"), "a/b"),
        (True, True),
    ],
)
def test_every_value_has_its_form(value, form):
    found = told(value)
    assert found == form
    assert type(found) is type(form)
    assert type(CONVERTER.unstructure(value)) is type(form)  # plain types, without JSON's help


def test_an_array_comes_back_bit_by_bit():
    values = np.random.default_rng(3).normal(size=(4, 3))
    assert (read(CONVERTER, told(Drawn(values)), Drawn).values == values).all()


@pytest.mark.parametrize(
    "change",
    [
        {"count": "3"},
        {"count": 3.0},
        {"count": True},
        {"size": "0.5"},
        {"size": True},
        {"sure": 1},
        {"path": None},
        {"parts": [{"name": "p"}]},
        {"parts": [{"name": "p", "value": 1, "colour": "blue"}]},
        {"parts": 5},
        {"pair": ["x"]},
        {"best": "7"},
        {"detail": [1]},
        {"nobody": 1},
    ],
    ids=str,
)
def test_nothing_is_guessed(change):
    with pytest.raises(InvalidInputError, match="not the JSON of a whole thing"):
        read(CONVERTER, {**told(WHOLE), **change}, WholeThing)


@pytest.mark.parametrize("data", [None, 3, "text", [], {}])
def test_something_else_is_an_input_error(data):
    with pytest.raises(InvalidInputError, match="not the JSON of a whole thing"):
        read(CONVERTER, data, WholeThing)


@pytest.mark.parametrize("value", [1j, object(), {"a": 1j}, [b"bytes"]])
def test_a_type_without_a_form_is_refused(value):
    with pytest.raises(InvalidInputError, match="no form in JSON"):
        CONVERTER.unstructure(value)


def test_a_lenient_reader_passes_over_what_is_no_field():
    data = {**told(WHOLE), "summary": "of all"}
    assert lenient(make_converter(), WholeThing)(data, WholeThing) == WHOLE


def test_a_word_out_of_a_list_stays_in_it() -> None:
    assert told(Kept("file")) == {"where": "file"}
    assert read(CONVERTER, {"where": "settings"}, Kept) == Kept("settings")
