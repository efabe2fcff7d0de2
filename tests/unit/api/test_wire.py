"""A dataclass goes over HTTP as it is, and the document describes it in the words of its docstrings."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from typing import Annotated

import pytest
from pydantic import BaseModel, TypeAdapter

from mavcal.service.api.models.wire import Wire, _description


@dataclass(frozen=True)
class Reading:
    """A reading; None where it has none."""

    value: float | int
    """In `unit`; None: nothing
    was heard."""
    sd: float
    axis: tuple[float, float, float] = (0.0, 0.0, 1.0)
    unit: str = "m/s2"
    notes: tuple[str, ...] = ()
    """MAVLink's own words."""


ReadingModel = Annotated[Reading, Wire("ReadingModel", lacking=("notes",), not_finite=("sd",))]


class Page(BaseModel):
    first: ReadingModel
    more: list[ReadingModel]
    last: ReadingModel | None


SCHEMA = TypeAdapter(Page).json_schema(mode="serialization")["$defs"]["Reading"]


def test_it_has_its_name_and_its_docstring() -> None:
    assert SCHEMA["title"] == "ReadingModel"
    assert SCHEMA["description"] == "A reading; null where it has none."


def test_fields_are_described_by_the_docstrings_of_attributes() -> None:
    said = {name: part.get("description") for name, part in SCHEMA["properties"].items()}
    assert said == {
        "value": "in `unit`; null: nothing was heard",
        "sd": None,
        "axis": None,
        "unit": None,
        "notes": "MAVLink's own words",
    }


def test_an_answer_has_every_field_unless_an_earlier_service_lacks_it() -> None:
    assert SCHEMA["required"] == ["value", "sd", "axis", "unit"]
    assert [name for name, part in SCHEMA["properties"].items() if "default" in part] == ["notes"]


def test_numbers_are_numbers_and_equal_items_a_list() -> None:
    properties = SCHEMA["properties"]
    assert properties["value"]["type"] == "number"
    assert properties["sd"]["anyOf"] == [{"type": "number"}, {"type": "null"}]
    axis = {"items": {"type": "number"}, "type": "array", "minItems": 3, "maxItems": 3, "title": "Axis"}
    assert properties["axis"] == axis


def test_it_is_written_as_the_domain_writes_it() -> None:
    reading = Reading(3, math.inf, notes=("still",))
    page = Page(first=reading, more=[reading], last=None)
    told = {"value": 3, "sd": None, "axis": [0.0, 0.0, 1.0], "unit": "m/s2", "notes": ["still"]}
    assert page.first is reading
    assert page.model_dump_json() == json.dumps({"first": told, "more": [told], "last": None}, separators=(",", ":"))


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("Which sensor.", "which sensor"),
        ("MAV_CMD.", "MAV_CMD"),
        ("s", "s"),
        ("None: any.", "null: any"),
        ("What is off. Several: all.", "what is off. Several: all"),
        ("", ""),
    ],
)
def test_a_docstring_becomes_a_phrase(text: str, told: str) -> None:
    assert _description(text) == told
